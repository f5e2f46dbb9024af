"""The parts of a fit, each alone: views, outlines, least squares, calibration, offsets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.face import face_places
from glsplat.authoring.fit.hands import CARRIERS, hand_places
from glsplat.authoring.fit.landmarks import LANDMARK_COUNT, LANDMARKS, landmarks, twin
from glsplat.authoring.fit.levenberg import least_squares
from glsplat.authoring.fit.offsets import MOST, smooth_offsets
from glsplat.authoring.fit.outline import edge_distances, lengths_inside, overlap, projected_mask
from glsplat.authoring.fit.view import SIDES, View, facing
from glsplat.errors import FormatError
from glsplat.rotations import rotation_matrices
from glsplat.skinning.smplx import JOINT_NAMES
from tools.data.calibrate import (
    KnownFace,
    KnownHand,
    KnownPicture,
    calibrate,
    calibrate_face,
    calibrate_hands,
    write_face_table,
    write_hand_table,
    write_table,
)

MASK = np.zeros((200, 150), bool)
MASK[40:160, 50:100] = True
MARKS, SURE = np.zeros((LANDMARK_COUNT, 2)), np.ones(LANDMARK_COUNT)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mask": MASK.astype(np.uint8)}, r"booleans of shape \(H, W\), not uint8 \(200, 150\)"),
        ({"mask": np.zeros((9, 9), bool)}, "at least 64 pixels high, found 0"),
        ({"landmarks": np.zeros((17, 2))}, r"landmarks \(33, 2\)"),
        ({"landmarks": MARKS * np.nan}, "finite"),
        ({"focal": 0.0}, "above zero, not 0"),
        ({"focal": np.inf}, "above zero, not inf"),
        ({"side": "top"}, 'not "top"'),
    ],
)
def test_a_view_says_what_it_misses(change: dict[str, object], message: str) -> None:
    given = {"mask": MASK, "landmarks": MARKS, "visibility": SURE, "focal": 300.0} | change
    with pytest.raises(FormatError, match=message):
        View(**given)  # type: ignore[arg-type]


def test_a_smaller_view_is_the_same_picture() -> None:
    marks = np.tile([75.0, 100.0], (LANDMARK_COUNT, 1))
    small = View(MASK, marks, SURE, 300.0).smaller(80.0)
    assert abs(small.figure - 80) <= 1 and abs(small.focal - 200) < 2
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


def test_calibration_finds_the_offsets_again(rng: np.random.Generator, tmp_path: Path) -> None:
    table = landmarks()
    pictures = []
    for number in range(12):
        joints = rng.normal(0, 0.3, (55, 3)) + (0, 0, 3)
        frames = rotation_matrices(rng.normal(0, 0.6, (55, 3)))
        at = joints[table.joints] + np.einsum("lij,lj->li", frames[table.joints], table.offsets * 1.7)
        marks = np.zeros((LANDMARK_COUNT, 2))
        marks[table.numbers] = at[:, :2] / at[:, 2:] * 1000 + (300, 400)
        if number == 3:
            marks += 150  # one person's are wrong
        pictures.append(KnownPicture(joints, frames, marks, 1000.0, np.array([300.0, 400.0]), 1.7))
    found = calibrate(pictures)
    assert np.abs(found.offsets - table.offsets).max() < 2e-3 and found.strays.max() < 3e-3
    write_table(found, tmp_path / "table.json", "made up")
    assert len(json.loads((tmp_path / "table.json").read_text())["landmarks"]) == len(LANDMARKS)


def test_twins_are_pairs() -> None:
    numbers = [number for number, _ in LANDMARKS]
    assert all(twin(twin(n)) == n and twin(n) in numbers for n in numbers) and twin(0) == 0 and twin(11) == 12
    table = landmarks()
    assert np.allclose(table.offsets[table.twins] * (-1, 1, 1), table.offsets)


def test_offsets_meet_what_is_known_and_are_smooth_elsewhere() -> None:
    body = open_body()
    chest = np.flatnonzero(body.skin & (body.vertices[:, 1] > 0.2) & (body.vertices[:, 1] < 0.4))
    offsets = smooth_offsets(body, chest, np.full(len(chest), 0.02), np.ones(len(chest)))
    assert abs(np.median(offsets[chest]) - 0.02) < 0.002 and np.abs(offsets[body.vertices[:, 1] < -0.7]).max() < 0.005
    assert offsets.min() >= -1e-9 and offsets.max() <= 0.0205
    assert smooth_offsets(body, chest, np.full(len(chest), 9.0), np.ones(len(chest))).max() <= MOST[1]


def test_calibration_finds_the_hands_places_again(rng: np.random.Generator, tmp_path: Path) -> None:
    table, hands = hand_places(), []
    for number in range(12):
        side, mirror = ("left", np.ones(3)) if number % 2 else ("right", np.array([-1.0, 1, 1]))
        joints, frames = rng.normal(0, 0.3, (55, 3)) + (0, 0, 3), rotation_matrices(rng.normal(0, 0.6, (55, 3)))
        carriers = [JOINT_NAMES.index(f"{side}_{name}") for name in CARRIERS]
        at = joints[carriers] + np.einsum("lij,lj->li", frames[carriers], table.offsets * mirror * 0.1)
        marks = at[:, :2] / at[:, 2:] * 1000 + (300, 400) + (30 if number == 4 else 0)  # one hand's are wrong
        hands.append(KnownHand(joints, frames, marks, side, 0.1, 1000.0, np.array([300.0, 400.0])))
    found = calibrate_hands(hands)
    assert np.abs(found.offsets - table.offsets).max() < 0.03 and found.strays.max() < 0.02
    write_hand_table(found, tmp_path / "table.json", "made up")
    assert len(json.loads((tmp_path / "table.json").read_text())["landmarks"]) == 21


def test_calibration_finds_the_spots_of_the_face_again(rng: np.random.Generator, tmp_path: Path) -> None:
    body, table = open_body(), face_places()
    people = []
    for number in range(6):
        turn = rotation_matrices(rng.normal(0, 0.1, 3)) @ facing(SIDES["front"])
        vertices = body.vertices @ turn.T + (0, 0.5, 3)
        marks = np.full((468, 2), -100.0)
        spots = table.of(body, vertices)
        marks[table.numbers] = spots[:, :2] / spots[:, 2:] * 2000 + (300, 400) + rng.normal(0, 0.3, (len(spots), 2))
        if number == 2:
            marks += 8
        people.append(KnownFace(vertices, marks, 2000.0, np.array([300.0, 400.0])))
    found = calibrate_face(body, people)
    both = np.isin(found.numbers, table.numbers)
    known = np.isin(table.numbers, found.numbers)
    assert both.all() and known.sum() > 0.8 * len(known)
    away = found.of(body, body.vertices) - table.of(body, body.vertices)[known]
    assert np.linalg.norm(away, axis=1).max() < 0.004 and np.linalg.norm(away, axis=1).mean() < 0.0015
    write_face_table(found, tmp_path / "table.json", "made up")
    assert len(json.loads((tmp_path / "table.json").read_text())["landmarks"]) == len(found.numbers)


def test_tables_of_hands_and_face_are_mirrored_and_whole() -> None:
    body, table = open_body(), face_places()
    spots = table.of(body, body.vertices)
    assert np.allclose(table.weights.sum(axis=1), 1) and (table.weights >= 0).all() and (table.strays > 0).all()
    near = np.linalg.norm(spots[:, None] * (-1, 1, 1) - spots, axis=2).min(axis=1)
    assert np.median(near) < 0.002 and body.skin[body.faces[table.faces]].all()
    assert hand_places().offsets.shape == (21, 3) == (len(CARRIERS), 3)
