"""Bend forearms, wrists and fingers until their joints meet the hand network's landmarks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.extras.authoring.compute.solvers import least_squares
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import derivative_column, fully_posed, projected
from glsplat.extras.authoring.fit.landmarks import read_table
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import Hand
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.tracking.solve.limits import BOXES, FINGER_HIGH, FINGER_LOW

Indices = NDArray[np.intp]

_FINGERS = ("index", "middle", "ring", "pinky")
CARRIERS = ("wrist", *(f"{name}{bone}" for name in ("thumb", *_FINGERS) for bone in (1, 2, 3, 3)))
"""Joint, without its side, of each of the network's 21 landmarks; a finger's last joint also carries its tip."""

# joint without its side -> axis, mean and standard deviation in radians, for the left side. Elbow and wrist start from
# the body's fit, which does not determine the forearm's twist. Fingers bend about -z and spread about y.
_TABLE: dict[str, tuple[tuple[int, float, float], ...]] = {
    "elbow": ((0, 0.0, 0.35), (1, 0.0, 0.06), (2, 0.0, 0.06)),
    "wrist": ((0, 0.0, 0.35), (1, 0.0, 0.12), (2, 0.0, 0.15)),
    "thumb1": tuple((axis, 0.0, 0.15) for axis in range(3)),
    "thumb2": tuple((axis, 0.0, 0.10) for axis in range(3)),
    "thumb3": tuple((axis, 0.0, 0.10) for axis in range(3)),
    **{f"{name}1": ((1, 0.0, 0.08), (2, -0.15, 0.35)) for name in _FINGERS},
    **{f"{name}2": ((2, -0.20, 0.35),) for name in _FINGERS},
    **{f"{name}3": ((2, -0.15, 0.25),) for name in _FINGERS},
}
_NAMES = [name for name, rows in _TABLE.items() for _ in rows]
_AXES = np.array([axis for rows in _TABLE.values() for axis, _, _ in rows], np.intp)
_MEAN: F64 = np.array([mean for rows in _TABLE.values() for _, mean, _ in rows])
_SD_RAD: F64 = np.array([sd for rows in _TABLE.values() for *_, sd in rows])
_ARM = np.array([name in ("elbow", "wrist") for name in _NAMES])
_NEIGHBOUR_SD_RAD = 0.08  # difference of the bends of neighbouring fingers
_MAX_THUMB_RAD = 1.0  # either way about any axis

_MIN_PRESENCE = 0.5  # of the hand
_MAX_DISTANCE_HANDS = 1.0  # between the body's hand and the network's, in hand sizes; farther off is another hand
_MAX_MEDIAN_HANDS = 0.3  # final distance of the landmarks, in hand sizes
_OUTLIER_FACTOR = 1.5  # typical errors at which a landmark has half the weight
_WEIGHT_ROUNDS = 3  # updates of the landmarks' weights


@dataclass(frozen=True, eq=False)
class HandPlaces:
    """The 21 landmarks on a left hand, in fractions of ``hand_size``."""

    offsets: F64  # [21, 3] from the joint of CARRIERS, in its rest frame
    errors: F64  # [21] typical distance in the picture between the network's landmark and the true one


@lru_cache(maxsize=1)
def hand_places() -> HandPlaces:
    """Return the embedded table (hand_offsets.json), measured on people whose joints and skin are known."""
    rows = read_table("hand_offsets.json")
    return HandPlaces(np.array([row["offset"] for row in rows]), np.array([row["stray"] for row in rows]))


def hand_size(joints: F64) -> float:
    """Return the distance in metres from wrist to middle knuckle of resting ``joints`` [55, 3], half a hand."""
    return float(np.linalg.norm(joints[JOINT_NAMES.index("left_middle1")] - joints[JOINT_NAMES.index("left_wrist")]))


def fit_hand(body: Body, fit: BodyFit, fitted: FittedView, view: View, hand: Hand, side: str) -> F64 | None:
    """Return the view's rotations [55, 3] with one forearm and hand fitted, or None if the hand is not credible.

    A hand is credible if the network finds it near the body's hand and a bend of the fingers explains it.
    """
    points = _landmark_points(fit, side)
    size_px = view.focal * hand_size(fit.joints) / float(fitted.joints[JOINT_NAMES.index(f"{side}_wrist"), 2])
    sign = np.where(_AXES == 0, 1.0, 1.0 if side == "left" else -1.0)  # unknowns are those of a left hand
    rows = np.array([JOINT_NAMES.index(f"{side}_{name}") for name in _NAMES], np.intp)
    columns = [derivative_column(f"{side}_{name}", int(axis)) for name, axis in zip(_NAMES, _AXES, strict=True)]
    mean = np.where(_ARM, fitted.rotations[rows, _AXES] * sign, _MEAN)
    weights = 1 / (hand_places().errors * size_px)

    def turned(x: F64) -> F64:
        rotations = fitted.rotations.copy()
        rotations[rows, _AXES] = x * sign
        return rotations

    def away(x: F64, derive: bool) -> tuple[F64, F64]:
        """Return pixels [21, 2] from the landmarks to the hand's points, and derivatives [21, 2, P] if asked."""
        posed = fully_posed(body, fit.betas, fitted.root, fitted.pelvis, turned(x))
        where, moves = posed.derivatives(points) if derive else (posed.points(points), None)
        at, slopes = projected(where, view.focal, view.centre, None if moves is None else moves[..., columns] * sign)
        return at - hand.points, slopes

    distance_px = np.linalg.norm(away(mean, False)[0].mean(axis=0))
    if hand.presence < _MIN_PRESENCE or distance_px > _MAX_DISTANCE_HANDS * size_px:
        return None
    x, trust = mean, np.ones(len(weights))
    for _ in range(_WEIGHT_ROUNDS):

        def equations(x: F64, derive: bool, each: F64 = weights * trust) -> tuple[F64, F64]:
            far, slopes = away(x, derive)
            residual = np.concatenate([(far * each[:, None]).ravel(), (x - mean) / _SD_RAD, _TIES @ x])
            if not derive:
                return residual, np.zeros((0, 0))
            slope = (slopes * each[:, None, None]).reshape(-1, len(x))
            return residual, np.concatenate([slope, np.diag(1 / _SD_RAD), _TIES])

        x = least_squares(equations, x, 8).clip(*_LIMITS)
        far = np.linalg.norm(away(x, False)[0], axis=1)
        trust = 1 / np.sqrt(1 + (far * weights / _OUTLIER_FACTOR) ** 2)
    return turned(x) if np.median(far) < _MAX_MEDIAN_HANDS * size_px else None


def _landmark_points(fit: BodyFit, side: str) -> Points:
    """Return the 21 landmarks as points of the person's hand, whose shape is already in ``fit.joints``."""
    table = hand_places()
    joints = np.array([JOINT_NAMES.index(f"{side}_{name}") for name in CARRIERS], np.intp)
    mirror = np.array([1.0 if side == "left" else -1.0, 1.0, 1.0])
    rest = fit.joints[joints] + table.offsets * mirror * hand_size(fit.joints)
    return Points(rest, np.zeros((len(rest), 3, BETAS)), joints[:, None], np.ones((len(rest), 1)))


def _bounds() -> tuple[F64, F64]:
    """Return the lowest [P] and highest [P] angles of the left arm and fingers, radians."""
    low, high = [], []
    for name, axis in zip(_NAMES, _AXES, strict=True):
        if name in ("elbow", "wrist"):
            box = BOXES[JOINT_NAMES.index(f"left_{name}")]
            bounds = box[axis], box[3 + axis]
        elif name.startswith("thumb"):
            bounds = -_MAX_THUMB_RAD, _MAX_THUMB_RAD
        else:
            bounds = FINGER_LOW[int(name[-1]) - 1, axis], FINGER_HIGH[int(name[-1]) - 1, axis]
        low.append(bounds[0])
        high.append(bounds[1])
    return np.array(low), np.array(high)


def _ties() -> F64:
    """Return the equations [9, P] that let neighbouring fingers bend alike."""
    rows = np.zeros((9, len(_NAMES)))
    pairs = [(f"{a}{bone}", f"{b}{bone}") for bone in (1, 2, 3) for a, b in pairwise(_FINGERS)]
    for row, pair in enumerate(pairs):
        for name, value in zip(pair, (1.0, -1.0), strict=True):
            bend = next(k for k, other in enumerate(_NAMES) if other == name and _AXES[k] == 2)
            rows[row, bend] = value / _NEIGHBOUR_SD_RAD
    return rows


_LIMITS, _TIES = _bounds(), _ties()
