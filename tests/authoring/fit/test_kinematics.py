"""The posed body agrees with the skinning at run time, and its derivatives with differences."""

from __future__ import annotations

import numpy as np

from glsplat.authoring.fit.body import BETAS, open_body
from glsplat.authoring.fit.kinematics import PLACE, Hinges, PosedBody, projected
from glsplat.authoring.fit.view import SIDES, facing
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

HINGES = Hinges(tuple((name, axis) for name in ("left_hip", "spine1", "left_elbow", "head") for axis in range(3)))


def unknowns(rng: np.random.Generator, turn: float = 0.3) -> np.ndarray:
    place = [0.1, -0.2, 3.0, *rng.normal(0, turn, 3)]
    return np.concatenate([rng.normal(0, 1, BETAS), place, rng.normal(0, 0.5, len(HINGES.names))])


def posed(x: np.ndarray, side: str = "front") -> PosedBody:
    place, angles = x[BETAS : BETAS + PLACE], x[BETAS + PLACE :]
    return PosedBody(open_body(), HINGES, facing(SIDES[side]), x[:BETAS], place, angles)


def test_vertices_are_those_of_linear_blend_skinning(rng: np.random.Generator) -> None:
    body, x = open_body(), unknowns(rng, 0.0)
    x[BETAS + 3 : BETAS + 6] = 0
    mine = posed(x).points(body.points(np.arange(len(body.vertices))))
    vertices, joints = body.shaped(x[:BETAS])
    bones = Skeleton.from_joints(JOINT_NAMES, PARENTS, joints).bone_matrices(HINGES.rotations(x[BETAS + PLACE :]))
    blended = np.einsum("vk,vkij->vij", body.skin_weights, bones[body.skin_joints])
    skinned = np.einsum("vij,vj->vi", blended[..., :3], vertices) + blended[..., 3]
    want = (skinned - joints[0]) @ facing(SIDES["front"]).T + x[BETAS : BETAS + 3]
    assert np.abs(mine - want).max() < 1e-9


def test_derivatives_match_differences(rng: np.random.Generator) -> None:
    x = unknowns(rng)
    points = open_body().points(rng.choice(len(open_body().vertices), 40))

    def pixels(x: np.ndarray) -> np.ndarray:
        return projected(posed(x, "back").points(points), 900.0, np.array([50.0, 60.0]))[0]

    where, moves = posed(x, "back").derivatives(points)
    derivative = projected(where, 900.0, np.array([50.0, 60.0]), moves)[1]
    steps = 1e-6 * np.eye(len(x))
    differences = np.stack([(pixels(x + step) - pixels(x - step)) / 2e-6 for step in steps], axis=-1)
    assert np.abs(derivative - differences).max() < 1e-4 * np.abs(derivative).max()


def test_sides_are_rotations_that_show_that_side() -> None:
    toward = {"front": (0, 0, 1), "back": (0, 0, -1), "left": (1, 0, 0), "right": (-1, 0, 0)}
    for side, turn in SIDES.items():
        stands = facing(turn)
        assert np.allclose(stands @ stands.T, np.eye(3)) and np.isclose(np.linalg.det(stands), 1)
        assert np.allclose(stands @ toward[side], (0, 0, -1))  # that side looks at the camera
        assert np.allclose(stands @ (0, 1, 0), (0, -1, 0))


def test_the_embedded_body_stands_as_its_licence_says() -> None:
    body = open_body()
    assert body.vertices.shape == (13718, 3) and body.faces.shape == (27420, 3) and body.uv.shape == (27420, 3, 2)
    assert abs(body.vertices[:, 1].min() + 0.80) < 0.01 and 1.7 < body.stature[0] < 1.9
    assert np.allclose(body.skin_weights.sum(axis=1), 1) and not body.vertices.flags.writeable
    left = body.joints[JOINT_NAMES.index("left_wrist")]
    assert left[0] > 0.5 and np.allclose(left * (-1, 1, 1), body.joints[JOINT_NAMES.index("right_wrist")], atol=0.01)
