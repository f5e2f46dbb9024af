"""Round eyeballs, and blinks that end where lids meet."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_face import with_expressions
from glsplat.extras.authoring.faces.blinks import BLINK_SHAPES, closing_weight, with_blink
from glsplat.extras.authoring.faces.eyeballs import IRIS_COLOURS, eye_texture, fit_eyeballs, with_eyeballs
from glsplat.extras.authoring.faces.openings import find_openings, lid_edges
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.extras.authoring.faces.figures import EYES, person

STILL = np.zeros((55, 3))
LID = 0.12  # of the largest move of a blink; vertices that move farther are lid
SKIN, SHADE = (190, 140, 110), (120, 70, 50)


def lid_vertices(mesh: RiggedMesh) -> np.ndarray:
    """Return a mask [V] of the vertices of lids."""
    far = sum(np.linalg.norm(mesh.morphs.dense(name, len(mesh.vertices)), axis=1) for name in BLINK_SHAPES)
    return far > LID * np.max(far)


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
    lids = skin.uv[lid_vertices(mesh)[skin.faces].all(axis=1)].reshape(-1, 2)
    x, y = (lids * (511, -511) + (0, 511)).round().astype(int).T
    for dx in range(-2, 3):
        for dy in range(-2, 3):
            texture[np.clip(y + dy, 0, 511), np.clip(x + dx, 0, 511), :3] = SHADE
    return replace(mesh, parts=tuple(replace(one, texture=texture) if one is skin else one for one in mesh.parts))


def shut(mesh: RiggedMesh) -> np.ndarray:
    """[V, 3] the offsets of a blink of both eyes."""
    return mesh.morphs.moved(Pose(STILL, expression=dict.fromkeys(BLINK_SHAPES, 1.0)), len(mesh.vertices))


def test_lids_stop_where_they_meet() -> None:
    mesh, wide = seeing(), 0.6  # the upper lid at rest is there already but for so much of its way
    drawn = np.where(lid_vertices(mesh)[:, None], (1 - wide) * 0.5 * shut(mesh), 0)
    mesh = replace(mesh, vertices=mesh.vertices + drawn)
    balls = fit_eyeballs(mesh, *EYES)
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
    ball = np.unique(np.concatenate([one.faces for one in mesh.parts if one.name in EYES]))
    skin = np.setdiff1d(np.arange(len(mesh.vertices)), ball)
    before, after = shut(mesh), shut(made)
    assert np.allclose(after[skin], 0.5 * before[skin], atol=1e-7)
    assert np.allclose(after[ball] - before[ball], (0, 0, -0.003), atol=1e-6)
    smile = Pose(STILL, expression={"mouthSmileLeft": 1.0, "jawOpen": 0.5})
    assert mesh.morphs is not None and made.morphs is not None and made.morphs.names == mesh.morphs.names
    moved = [one.moved(smile, len(mesh.vertices)) for one in (mesh.morphs, made.morphs)]
    assert np.array_equal(moved[0], moved[1])


@pytest.mark.parametrize("iris", IRIS_COLOURS)
def test_an_iris_has_a_black_pupil_a_dark_rim_and_is_never_red(iris: str) -> None:
    texture = eye_texture(iris, 0.015)[..., :3].astype(int)
    rows = len(texture)
    angle = np.arange(rows) / (rows - 1) * np.radians(115)
    rim = np.arcsin(0.0059 / 0.015)
    assert texture[angle < 0.25 * rim].max() < 20
    zones = (0.9, 0.97), (0.5, 0.75), (1.2, 1.4)
    ring, middle, white = (texture[(angle > low * rim) & (angle < high * rim)].mean() for low, high in zones)
    assert ring < 0.6 * middle < 0.6 * white
    inside = texture[(angle > 0.4 * rim) & (angle < 0.95 * rim)].reshape(-1, 3)
    assert (inside[:, 0] <= 2.2 * inside[:, 1] + 8).all()  # red, of which brown has twice its green at most


def test_the_ball_turns_about_its_middle_and_stays_where_it_is() -> None:
    mesh = person()
    made = with_eyeballs(mesh, "eyes", "blue")
    assert [one.name for one in made.parts] == ["skin", "mouth", *EYES]
    for ball in fit_eyeballs(made, *EYES):
        index = made.skeleton.names.index(ball.joint)
        assert np.abs(made.skeleton.joints[index] - ball.centre).max() < 1e-4
        rotations = np.zeros((55, 3))
        rotations[index] = (0.3, -0.4, 0)
        part = next(one for one in made.parts if one.name == ball.joint)
        posed = made.posed(Pose(rotations))[np.unique(part.faces)]
        assert np.abs(np.linalg.norm(posed - ball.centre, axis=1) - ball.radius).max() < 1e-4


def test_invalid_parts_and_colours_are_refused() -> None:
    with pytest.raises(FormatError, match="an iris is one of brown, dark brown, blue, grey, green, not 'red'"):
        with_eyeballs(person(), "eyes", "red")
    with pytest.raises(FormatError, match="left_eye_smplhf"):
        fit_eyeballs(person(), "skin")
