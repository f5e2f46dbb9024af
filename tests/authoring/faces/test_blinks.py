"""Blinks that end where lids meet, eyeballs that give way, and lids in the colours of the skin around."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from glsplat.authoring.faces.blinks import BLINKS, blink_that_shuts, with_blink
from glsplat.authoring.faces.eyeballs import eyeballs, with_eyeballs
from glsplat.authoring.faces.open_face import with_expressions
from glsplat.authoring.faces.openings import lid_edges, openings
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.authoring.faces.figures import EYES, person
from tools.data.lids import even_lids, lid_corners

STILL = np.zeros((55, 3))
SKIN, SHADE = (190, 140, 110), (120, 70, 50)


@lru_cache(maxsize=1)
def seeing() -> RiggedMesh:
    """Somebody with expressions and round eyeballs, whose skin is one colour but for darker lids."""
    bare = person()
    same = np.arange(len(bare.vertices))
    mesh = with_eyeballs(bare, "eyes", "brown")
    same = np.concatenate([same, np.full(len(mesh.vertices) - len(same), -1)])
    mesh = with_expressions(mesh, same)
    skin = next(one for one in mesh.parts if one.name == "skin")
    texture = np.full((512, 512, 4), (*SKIN, 255), np.uint8)
    lids = skin.uv[lid_corners(mesh)[skin.faces].all(axis=1)].reshape(-1, 2)
    x, y = (lids * (511, -511) + (0, 511)).round().astype(int).T
    for dx in range(-2, 3):
        for dy in range(-2, 3):
            texture[np.clip(y + dy, 0, 511), np.clip(x + dx, 0, 511), :3] = SHADE
    return replace(mesh, parts=tuple(replace(one, texture=texture) if one is skin else one for one in mesh.parts))


def shut(mesh: RiggedMesh) -> np.ndarray:
    """[V, 3] the offsets of a blink of both eyes."""
    return mesh.morphs.moved(Pose(STILL, expression=dict.fromkeys(BLINKS, 1.0)), len(mesh.vertices))


@pytest.mark.parametrize("wide", [pytest.param(1.0, marks=pytest.mark.check), 0.6])
def test_lids_meet_and_go_no_farther_whatever_the_eye_is_like(wide: float) -> None:
    """``wide``: the upper lid at rest is there already but for so much of its way."""
    mesh = seeing()
    drawn = np.where(lid_corners(mesh)[:, None], (1 - wide) * 0.5 * shut(mesh), 0)
    mesh = replace(mesh, vertices=mesh.vertices + drawn)
    balls = eyeballs(mesh, *EYES)
    share = float(np.mean([blink_that_shuts(mesh, eye) for eye in openings(mesh, balls)]))
    blinking = with_blink(mesh, dict.fromkeys(BLINKS, share))
    moves = shut(blinking)[:, 1]
    for ball in balls:
        edges = lid_edges(mesh, ball, 0.9)
        middle = slice(len(edges.side) // 4, 3 * len(edges.side) // 4)
        upper, lower = (moves[mesh.faces[face[middle]]].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
        left_open = (edges.upper_at - edges.lower_at)[middle, 1] + upper - lower
        assert np.median(left_open) < 0.0005 and left_open.min() > -0.005  # metres
    assert 0.2 < share <= 1


def test_eyeballs_give_way_by_three_millimetres_and_nothing_else_changes() -> None:
    mesh = seeing()
    made = with_blink(mesh, dict.fromkeys(BLINKS, 0.5))
    ball = np.unique(np.concatenate([one.faces for one in mesh.parts if one.name in EYES]))
    skin = np.setdiff1d(np.arange(len(mesh.vertices)), ball)
    before, after = shut(mesh), shut(made)
    assert np.allclose(after[skin], 0.5 * before[skin], atol=1e-7)
    assert np.allclose(after[ball] - before[ball], (0, 0, -0.003), atol=1e-6)
    smile = Pose(STILL, expression={"mouthSmileLeft": 1.0, "jawOpen": 0.5})
    assert mesh.morphs is not None and made.morphs is not None and made.morphs.names == mesh.morphs.names
    moved = [one.moved(smile, len(mesh.vertices)) for one in (mesh.morphs, made.morphs)]
    assert np.array_equal(moved[0], moved[1])


def test_dark_lids_become_skin_and_the_rest_stays() -> None:
    mesh = seeing()
    before = next(one for one in mesh.parts if one.name == "skin")
    after = next(one for one in even_lids(mesh, 0.9, "skin").parts if one.name == "skin")
    lids = lid_corners(mesh)[before.faces].all(axis=1)
    middles = before.uv.mean(axis=1)
    old, new = (255 * one.sample(middles)[:, :3] for one in (before, after))
    darker = np.mean(np.subtract(SKIN, SHADE))
    assert np.mean(SKIN - old[lids]) > 0.9 * darker and np.mean(SKIN - new[lids]) < 0.33 * darker  # soft at the edge
    places = mesh.vertices[before.faces].mean(axis=1) - mesh.vertices[np.unique(before.faces[lids])].mean(0)
    far = np.linalg.norm(places, axis=1) > 0.08
    assert np.array_equal(old[far], new[far])
    same = next(one for one in even_lids(mesh, 0.0, "skin").parts if one.name == "skin")
    assert np.array_equal(same.texture, before.texture)
