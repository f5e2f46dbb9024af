"""Blinks that end where lids meet, and eyeballs in them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from glsplat.extras.authoring.body.open_face import with_expressions
from glsplat.extras.authoring.faces.eyes import (
    BLINK_SHAPES,
    closing_weight,
    find_openings,
    fit_eyeballs,
    lid_edges,
    with_blink,
)
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.extras.authoring.faces.figures import person

STILL = np.zeros((55, 3))
LID = 0.12  # of the largest move of a blink; vertices that move farther are lid


def lid_vertices(mesh: RiggedMesh) -> np.ndarray:
    """Return a mask [V] of the vertices of lids."""
    far = sum(np.linalg.norm(mesh.morphs.dense(name, len(mesh.vertices)), axis=1) for name in BLINK_SHAPES)
    return far > LID * np.max(far)


@lru_cache(maxsize=1)
def seeing() -> RiggedMesh:
    """Somebody with expressions."""
    return with_expressions(person())


def shut(mesh: RiggedMesh) -> np.ndarray:
    """[V, 3] the offsets of a blink of both eyes."""
    return mesh.morphs.moved(Pose(STILL, expression=dict.fromkeys(BLINK_SHAPES, 1.0)), len(mesh.vertices))


def test_lids_stop_where_they_meet() -> None:
    mesh, wide = seeing(), 0.6  # the upper lid at rest is there already but for so much of its way
    drawn = np.where(lid_vertices(mesh)[:, None], (1 - wide) * 0.5 * shut(mesh), 0)
    mesh = replace(mesh, vertices=mesh.vertices + drawn)
    balls = fit_eyeballs(mesh)
    share = float(np.mean([closing_weight(mesh, eye) for eye in find_openings(mesh, balls)]))
    blinking = with_blink(mesh, dict.fromkeys(BLINK_SHAPES, share))
    moves = shut(blinking)[:, 1]
    for ball in balls:
        edges = lid_edges(mesh, ball, 0.9)
        middle = slice(len(edges.side) // 4, 3 * len(edges.side) // 4)
        upper, lower = (moves[mesh.faces[face[middle]]].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
        left_open = (edges.upper_at - edges.lower_at)[middle, 1] + upper - lower
        assert np.median(left_open) < 0.0005 and left_open.min() > -0.005  # metres
    assert 0.2 < share <= 1


def test_eyeballs_retreat_by_three_millimetres_and_nothing_else_changes() -> None:
    mesh = seeing()
    made = with_blink(mesh, dict.fromkeys(BLINK_SHAPES, 0.5))
    ball = np.unique(np.concatenate([one.faces for one in mesh.parts if one.name == "eyes"]))
    skin = np.setdiff1d(np.arange(len(mesh.vertices)), ball)
    before, after = shut(mesh), shut(made)
    assert np.allclose(after[skin], 0.5 * before[skin], atol=1e-7)
    assert np.allclose(after[ball] - before[ball], (0, 0, -0.003), atol=1e-6)
    smile = Pose(STILL, expression={"mouthSmileLeft": 1.0, "jawOpen": 0.5})
    assert mesh.morphs is not None and made.morphs is not None and made.morphs.names == mesh.morphs.names
    moved = [one.moved(smile, len(mesh.vertices)) for one in (mesh.morphs, made.morphs)]
    assert np.array_equal(moved[0], moved[1])
