"""Hands and face of made-up people are found again; what the networks cannot know leaves the body as it was."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import BETAS, Points, open_body
from glsplat.extras.authoring.fit.body_fit import BodyFit, assemble_fit
from glsplat.extras.authoring.fit.details import fit_details
from glsplat.extras.authoring.fit.eyes import eyeball
from glsplat.extras.authoring.fit.face import face_places, fit_face
from glsplat.extras.authoring.fit.hands import CARRIERS, fit_hand, hand_places, hand_size
from glsplat.extras.authoring.fit.kinematics import PosedBody, fully_posed, projected
from glsplat.extras.authoring.fit.landmarks import LANDMARK_COUNT
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.prior import HINGES, MEAN
from glsplat.extras.authoring.fit.view import View, facing
from glsplat.extras.authoring.networks.face import Face
from glsplat.extras.authoring.networks.network import Crop
from glsplat.extras.authoring.networks.people import SIDES, DetectedPerson, Hand
from glsplat.extras.authoring.networks.person import DetectedBody as Readings
from glsplat.skinning.smplx import JOINT_NAMES

SIZE, FOCAL, CENTRE = (960, 640), 1280.0, np.array([320.0, 480.0])
BETAS_MADE = np.array([-0.6, 0.5, -0.4, 0.3, 0, 0.4, 0, 0, 0.2, 0])
CROP = Crop(0.0, 0.0, 1.0)
NOBODY = Readings(*[None] * len(Readings.__dataclass_fields__))  # type: ignore[arg-type]
FINGERS = [f"{name}{bone}" for name in ("thumb", "index", "middle", "ring", "pinky") for bone in (1, 2, 3)]


def body_pose() -> np.ndarray:
    return HINGES.rotations(MEAN)


def posed(rotations: np.ndarray, side: str = "front") -> PosedBody:
    return fully_posed(open_body(), BETAS_MADE, facing(SIDES[side]), np.array([0.02, 0.05, 3.0]), rotations)


def everywhere(made: PosedBody, rest: np.ndarray) -> np.ndarray:
    """[V, 2] pixels of a surface that rests at ``rest``."""
    body = open_body()
    points = body.points(np.arange(len(rest)), rest - body.shaped(BETAS_MADE)[0])
    return projected(made.points(points), FOCAL, CENTRE)[0]


@lru_cache(maxsize=4)
def fitted(*sides: str) -> tuple[BodyFit, tuple[View, ...]]:
    """A bare person in the mean pose, fitted without fault but for what details are to find."""
    body = open_body()
    bare, joints = body.shaped(BETAS_MADE)
    poses = [posed(body_pose(), side) for side in sides]
    views = []
    for made, side in zip(poses, sides, strict=True):
        mask = projected_mask(everywhere(made, bare), body.faces, SIZE)
        views.append(View(mask, np.full((LANDMARK_COUNT, 2), 320.0), np.ones(LANDMARK_COUNT), FOCAL, CENTRE, side))
    zero = np.zeros(len(bare))
    fit = assemble_fit(body, bare, joints, zero, poses, [body_pose()] * len(sides), views, [0.0] * len(sides))
    return fit, tuple(views)


def hand_marks(rotations: np.ndarray, side: str) -> np.ndarray:
    """[21, 2] where the network would see a hand."""
    body = open_body()
    joints = body.shaped(BETAS_MADE)[1]
    carriers = np.array([JOINT_NAMES.index(f"{side}_{name}") for name in CARRIERS])
    offsets = hand_places().offsets * (1.0 if side == "left" else -1.0, 1, 1) * hand_size(joints)
    points = Points(joints[carriers] + offsets, np.zeros((21, 3, BETAS)), carriers[:, None], np.ones((21, 1)))
    return projected(posed(rotations).points(points), FOCAL, CENTRE)[0]


def bent(side: str) -> np.ndarray:
    """[55, 3] the mean pose with one bent, twisted hand."""
    rotations = body_pose()
    sign = np.array([1, 1, 1] if side == "left" else [1, -1, -1])
    for name in ("index", "middle", "ring", "pinky"):
        for bone, bend in ((1, -0.5), (2, -0.6), (3, -0.4)):
            rotations[JOINT_NAMES.index(f"{side}_{name}{bone}")] = sign * (0, 0, bend)
    rotations[JOINT_NAMES.index(f"{side}_wrist")] += sign * (0.3, 0.05, 0.1)
    rotations[JOINT_NAMES.index(f"{side}_elbow")] += sign * (0.3, 0.03, 0)
    return rotations


def hand_at(points: np.ndarray, presence: float = 0.97) -> Hand:
    return Hand(points, presence)


def off(found: np.ndarray, true: np.ndarray, side: str) -> float:
    """Percent of the hand's length from where the fingers' joints are to where they should be, in the picture."""
    rows = [JOINT_NAMES.index(f"{side}_{name}") for name in FINGERS]
    away = (
        projected(posed(found).joints[rows], FOCAL, CENTRE)[0] - projected(posed(true).joints[rows], FOCAL, CENTRE)[0]
    )
    return float(np.linalg.norm(away, axis=1).mean() / (2 * hand_size(fitted("front")[0].joints) * FOCAL / 3) * 100)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_bent_and_twisted_hand_is_found_again(side: str) -> None:
    (fit, views), true = fitted("front"), bent(side)
    marks = hand_marks(true, side)
    found = fit_hand(open_body(), fit, fit.views[0], views[0], hand_at(marks), side)
    assert off(body_pose(), true, side) > 9 and off(found, true, side) < 2
    other = [k for k, name in enumerate(JOINT_NAMES) if not name.startswith(f"{side}_")]
    assert (found[other] == body_pose()[other]).all()
    wrong = marks.copy()
    wrong[[8, 16]] += (15, 10)  # two finger tips that the network takes for others
    found = fit_hand(open_body(), fit, fit.views[0], views[0], hand_at(wrong), side)
    assert found is not None and off(found, true, side) < 4


def test_hands_that_are_not_believed() -> None:
    (fit, views), marks = fitted("front"), hand_marks(bent("left"), "left")
    seen, size = fit.views[0], hand_size(fit.joints) * FOCAL / 3

    def found(hand: Hand) -> np.ndarray | None:
        return fit_hand(open_body(), fit, seen, views[0], hand, "left")

    assert found(hand_at(marks)) is not None
    assert found(hand_at(marks, 0.3)) is None
    assert found(hand_at(marks - (3 * size, 0))) is None  # somebody else's
    scattered = marks.mean(axis=0) + np.random.default_rng(5).normal(0, size, marks.shape)
    assert found(hand_at(scattered - scattered.mean(axis=0) + marks.mean(axis=0))) is None


TURN = np.array([0.08, 0.10, -0.05])


def other_face() -> np.ndarray:
    """[V, 3] metres: a face whose eyes are wider apart and whose mouth is lower than the body's."""
    vertices = open_body().vertices
    moved = np.zeros_like(vertices)
    face = (vertices[:, 2] > 0.06) & (vertices[:, 1] > 0.74)
    moved[face, 0] = 0.10 * vertices[face, 0]
    moved[face, 1] = 0.12 * (vertices[face, 1] - 0.87)
    return moved


def face_at(moved: np.ndarray, turn: np.ndarray = TURN, presence: float = 1.0) -> Face:
    """What the network would see of a face."""
    rotations, body = body_pose(), open_body()
    rotations[JOINT_NAMES.index("head")] += turn
    points = np.zeros((468, 3))
    table = face_places()
    spots = table.points(body, body.shaped(BETAS_MADE)[0] + moved)
    points[table.numbers, :2] = projected(posed(rotations).points(spots), FOCAL, CENTRE)[0]
    return Face(points, presence, CROP)


def test_a_turned_and_other_face_is_found_again() -> None:
    (fit, views), body, true = fitted("front"), open_body(), other_face()
    found = fit_face(body, fit, fit.views[0], views[0], face_at(true))
    head, table = JOINT_NAMES.index("head"), face_places()
    neck = [JOINT_NAMES.index("neck"), head]
    assert np.abs(found[0][neck].sum(axis=0) - body_pose()[neck].sum(axis=0) - TURN).max() < 0.04
    left = np.linalg.norm(table.of(body, found[1] - true)[:, :2], axis=1)
    assert np.linalg.norm(table.of(body, true), axis=1).mean() > 0.004 and left.mean() < 0.0015
    behind = (body.vertices[:, 2] < 0) | (body.vertices[:, 1] < 0.6)
    assert (found[1][behind] == 0).all() and (found[1][:, 2] == 0).all() and np.abs(found[1]).max() < 0.02


def test_eyeballs_stay_round_and_turn_about_their_joint() -> None:
    fit, views = fitted("front")
    nothing = hand_at(np.zeros((21, 2)), 0.0)
    found = fit_details(fit, views, [DetectedPerson(NOBODY, face_at(other_face()), nothing, nothing)])
    for side in ("left", "right"):
        ball = eyeball(open_body(), side)
        moved = found.rest[ball.vertices] - fit.rest[ball.vertices]
        joint = JOINT_NAMES.index(f"{side}_eye_smplhf")
        assert 0.002 < np.linalg.norm(moved[0]) < 0.006 and np.ptp(moved, axis=0).max() < 1e-9
        assert np.allclose(found.joints[joint] - fit.joints[joint], moved[0])
        place = projected(found.views[0].joints[[joint]], FOCAL, CENTRE)[0]
        assert np.linalg.norm(found.views[0].pixels[ball.vertices].mean(axis=0) - place) < 1.5
    assert found.views[0].overlap > 0.98 and found.problem == ""


def test_a_hidden_half_follows_the_one_that_is_seen(rng: np.random.Generator) -> None:
    (fit, views), body, true, table = fitted("front"), open_body(), other_face(), face_places()
    face = face_at(true)
    hidden = table.of(body, body.vertices)[:, 0] < 0
    points = face.points.copy()
    points[table.numbers[hidden], :2] += rng.normal(0, 8, (int(hidden.sum()), 2))  # the network guesses
    found = fit_face(body, fit, fit.views[0], views[0], Face(points, 1.0, CROP))
    left = np.linalg.norm(table.of(body, found[1] - true)[:, :2], axis=1)
    assert left[hidden].mean() < 0.004 and left[~hidden].mean() < 0.003


def test_faces_that_are_not_believed(rng: np.random.Generator) -> None:
    fit, views = fitted("front")
    face = face_at(other_face())
    for points, presence in ((face.points, 0.1), (face.points + rng.normal(0, 60, (468, 3)), 1.0)):
        assert fit_face(open_body(), fit, fit.views[0], views[0], Face(points, presence, CROP)) is None


def test_all_details_of_two_views_at_once() -> None:
    fit, views = fitted("front", "back")
    marks = hand_marks(bent("left"), "left")
    person = DetectedPerson(NOBODY, face_at(other_face()), hand_at(marks), hand_at(marks, 0.0))
    found = fit_details(fit, views, [person, None])
    fingers = [JOINT_NAMES.index(f"left_{name}") for name in FINGERS]
    assert off(found.views[0].rotations, bent("left"), "left") < 2
    assert (found.views[1].rotations[fingers] == found.views[0].rotations[fingers]).all()  # not seen from behind
    assert (found.views[1].rotations[12] == fit.views[1].rotations[12]).all()  # the head is each view's own


def test_nothing_to_go_by_leaves_the_body() -> None:
    fit, views = fitted("front")
    nothing = hand_at(np.zeros((21, 2)), 0.0)
    hidden = DetectedPerson(NOBODY, face_at(other_face(), presence=0.1), nothing, nothing)
    assert fit_details(fit, views, [None]) is fit and fit_details(fit, views, [hidden]) is fit
