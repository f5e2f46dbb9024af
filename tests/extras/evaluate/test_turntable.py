"""The frames of somebody on a turntable: what is true of them holds, and the same seed gives the same bytes."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.evaluate.turntable import Turntable, turntable
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

pytestmark = pytest.mark.gl

Colour = tuple[int, int, int, int]
RED, GREY = (200, 60, 60, 255), (150, 150, 150, 255)
LAMP, COLOUR = (0.6, 0.8, 0.5), (0.6, 0.6, 0.55)


def somebody(left_colour: Colour) -> RiggedMesh:
    """The open body in plain grey, its left half of another colour."""
    body = open_body()
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), body.joints)
    left = (body.vertices[body.faces, 0] > 0).all(axis=1)
    parts = []
    for name, mine, colour in (("left", left, left_colour), ("right", ~left, GREY)):
        texture = np.full((4, 4, 4), colour, np.uint8)
        parts.append(MeshPart(name, body.faces[mine], body.uv[mine], texture))
    return RiggedMesh(body.vertices, skeleton, body.skin_joints, body.skin_weights, tuple(parts))


def frames(turns: float, count: int = 4, seed: int = 5, left: Colour = RED) -> list[Turntable]:
    camera = Camera(look_at([0, 0.3, 4.0], [0, 0.1, 0]), [[220, 0, 64], [0, 220, 96], [0, 0, 1]], 128, 192)
    pose = np.zeros((len(JOINT_NAMES), 3))
    pose[[16, 17], 2] = -0.8, 0.8
    return list(turntable(somebody(left), camera, Pose(pose), LAMP, COLOUR, frames=count, turns=turns, seed=seed))


def redness(frame: Turntable) -> float:
    """Where the red half is: -1 on the left of the picture, 1 on the right."""
    rows, columns = np.nonzero(frame.mask & (frame.rgb[..., 0] > 1.5 * frame.rgb[..., 1]))
    return float(np.sign(columns.mean() - np.nonzero(frame.mask)[1].mean())) if len(rows) > 20 else 0.0


@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_one_turn_shows_all_sides(turns: float) -> None:
    made = frames(turns)
    assert [frame.rgb.shape for frame in made] == [(192, 128, 3)] * 4 and made[0].turn == 0.0
    steps = np.diff([frame.turn for frame in made]) * np.sign(turns)
    assert (steps > 60).all() and (steps < 120).all()
    assert redness(made[0]) == 1 and redness(made[2]) == -1  # their left is on the right of a front
    shares = [(frame.mask & (frame.rgb[..., 0] > 1.5 * frame.rgb[..., 1])).sum() / frame.mask.sum() for frame in made]
    nearer, farther = (shares[1], shares[3]) if turns < 0 else (shares[3], shares[1])
    assert nearer > 2 * farther  # who turns to their right shows their left
    assert all(0.03 < frame.mask.mean() < 0.4 for frame in made)


def test_the_lamp_stands_while_the_person_turns() -> None:
    """What is on the lamp's side of the picture is brighter, in front, from the sides and behind."""
    for frame in frames(1.0, left=GREY):
        grey = frame.rgb.astype(float)[..., 1]
        columns = np.broadcast_to(np.arange(128), frame.mask.shape)
        middle = columns[frame.mask].mean()
        lit, shaded = (grey[frame.mask & side] for side in (columns > middle + 3, columns < middle - 3))
        assert min(len(lit), len(shaded)) > 200
        assert lit.mean() > shaded.mean() + 4, frame.turn


def test_the_same_seed_gives_the_same_bytes() -> None:
    first, second, other = frames(1.0, 2), frames(1.0, 2), frames(1.0, 2, seed=6)
    assert all((a.rgb == b.rgb).all() and a.turn == b.turn for a, b in zip(first, second, strict=True))
    assert any((a.rgb != b.rgb).any() for a, b in zip(first, other, strict=True))
    assert not np.allclose(first[0].pose.rotations[20], first[1].pose.rotations[20])  # they sway
