"""The parts of a fit: kinematics, views, outlines, least squares, offsets."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import BETAS, open_body
from glsplat.extras.authoring.compute.solvers import least_squares
from glsplat.extras.authoring.fit.kinematics import PLACE, Hinges, PosedBody, projected
from glsplat.extras.authoring.fit.landmarks import LANDMARK_COUNT
from glsplat.extras.authoring.fit.offsets import OFFSET_RANGE_M, smooth_offsets
from glsplat.extras.authoring.fit.outline import brimless, edge_distances, lengths_inside, overlap, projected_mask
from glsplat.extras.authoring.fit.view import View, facing
from glsplat.extras.authoring.networks.people import SIDES
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

MASK = np.zeros((200, 150), bool)
MASK[40:160, 50:100] = True
MARKS, SURE = np.zeros((LANDMARK_COUNT, 2)), np.ones(LANDMARK_COUNT)


def test_a_view_says_what_it_misses() -> None:
    with pytest.raises(FormatError, match="at least 64 pixels high, found 0"):
        View(np.zeros((9, 9), bool), MARKS, SURE, 300.0)
    for focal in (0.0, np.inf, np.nan):
        with pytest.raises(FormatError, match="pixels above zero"):
            View(MASK, MARKS, SURE, focal)


def test_a_smaller_view_is_the_same_picture() -> None:
    marks = np.tile([75.0, 100.0], (LANDMARK_COUNT, 1))
    small = View(MASK, marks, SURE, 300.0, face=-12.0).smaller(80.0)
    assert abs(small.figure - 80) <= 1 and abs(small.focal - 200) < 2 and small.face == -12.0
    assert np.allclose(small.landmarks[0], small.centre)  # the middle stays the middle
    assert View(MASK, marks, SURE, 300.0).smaller(500.0).mask is MASK


def test_pixels_belong_to_a_mask_by_their_centres() -> None:
    square = np.array([[10.0, 20], [30.5, 20], [30.5, 40], [10, 40]])
    toward = np.array([[0, 3, 2], [0, 2, 1]], np.int32)  # counter-clockwise with y up
    mask = projected_mask(square, toward, (60, 50))
    want = np.zeros((60, 50), bool)
    want[20:40, 10:31] = True
    assert (mask == want).all()
    assert not projected_mask(square, toward[:, ::-1], (60, 50)).any()  # turned away
    assert projected_mask(square - 20, toward, (60, 50)).sum() == 11 * 20  # cut off by the border


def test_edges_are_found_on_both_sides() -> None:
    start = np.array([[90.0, 100.0], [105.0, 100.0], [75.0, 100.0]])
    gaps = edge_distances(MASK, start, np.tile([1.0, 0.0], (3, 1)), 12.0)
    assert np.allclose(gaps[:2], [10, -5], atol=0.3) and np.isnan(gaps[2])


def test_lengths_inside_end_where_the_mask_does() -> None:
    start = np.array([[90.0, 100.0], [98.0, 100.0], [99.6, 100.0], [105.0, 100.0], [75.0, 100.0]])
    lengths = lengths_inside(MASK, start, np.tile([1.0, 0.0], (5, 1)), 12.0)
    assert np.allclose(lengths[:2], [10, 2], atol=0.3) and np.isnan(lengths[2:]).all()


def test_overlap_of_masks() -> None:
    assert overlap(MASK, MASK) == 1 and overlap(MASK, ~MASK) == 0 and overlap(MASK & False, MASK & False) == 1


def test_least_squares_descends_the_curved_valley() -> None:
    def rosenbrock(x: np.ndarray, derive: bool) -> tuple[np.ndarray, np.ndarray]:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])

    assert np.allclose(least_squares(rosenbrock, np.array([-1.2, 1.0]), 60, 0.0), 1, atol=1e-6)

    def broken(x: np.ndarray, derive: bool) -> tuple[np.ndarray, np.ndarray]:
        return (x if derive else x * np.nan), np.eye(len(x))

    assert (least_squares(broken, np.ones(3), 5) == 1).all()  # never worse than it was given


def test_offsets_meet_what_is_known_and_are_smooth_elsewhere() -> None:
    body = open_body()
    chest = np.flatnonzero(body.skin & (body.vertices[:, 1] > 0.2) & (body.vertices[:, 1] < 0.4))
    offsets = smooth_offsets(body, chest, np.full(len(chest), 0.02))
    assert abs(np.median(offsets[chest]) - 0.02) < 0.002 and np.abs(offsets[body.vertices[:, 1] < -0.7]).max() < 0.005
    assert offsets.min() >= -1e-9 and offsets.max() <= 0.0205
    assert smooth_offsets(body, chest, np.full(len(chest), 9.0)).max() <= OFFSET_RANGE_M[1]


FIGURE, NECK = 480.0, 100  # rows; below it nobody asks


def head() -> np.ndarray:
    """[160, 160] a head with a neck and shoulders."""
    mask = np.zeros((160, 160), np.uint8)
    cv2.ellipse(mask, (80, 60), (24, 32), 0, 0, 360, 1, -1)
    cv2.rectangle(mask, (68, 80), (92, 110), 1, -1)
    cv2.ellipse(mask, (80, 140), (70, 36), 0, 0, 360, 1, -1)
    return mask


@pytest.mark.parametrize(("thick", "aslant"), [(3, -4), (7, 4)])
def test_the_brim_of_a_hat_is_removed(thick: int, aslant: int) -> None:
    plain = head()
    worn = cv2.ellipse(plain.copy(), (80, 42), (52, thick), aslant, 0, 360, 1, -1)
    assert worn.sum() - plain.sum() > 100
    left, plain = brimless(worn > 0, FIGURE)[:NECK], plain[:NECK]
    assert (left & (plain == 0)).sum() < 0.2 * (worn[:NECK].sum() - plain.sum())
    assert (left & (plain > 0)).sum() > 0.98 * plain.sum()


def test_hair_and_ears_stay() -> None:
    mask = head()
    cv2.ellipse(mask, (80, 62), (34, 38), 0, 0, 360, 1, -1)  # a shock of hair
    for x in (46, 114):
        cv2.ellipse(mask, (x, 62), (5, 9), 0, 0, 360, 1, -1)
    lost = (brimless(mask > 0, FIGURE) != (mask > 0))[:NECK]
    assert lost.sum() < 0.02 * mask[:NECK].sum()


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
