"""The hands: arms, wrists and fingers bent a little, until their joints lie where the hand network sees them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.extras.authoring.compute.levenberg import least_squares
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import column, fully_posed, projected
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.hand import Hand
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.tracking.solve.limits import BOXES, FINGER_HIGH, FINGER_LOW

__all__ = ["CARRIERS", "HandPlaces", "fit_hand", "hand_places", "hand_size"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_FINGERS = ("index", "middle", "ring", "pinky")
CARRIERS = ("wrist", *(f"{name}{bone}" for name in ("thumb", *_FINGERS) for bone in (1, 2, 3, 3)))
"""The joint, without its side, that carries each of the network's 21 landmarks; the last one carries the tip too."""

# joint without its side -> axis, mean and standard deviation in radians, as the left side turns. Elbow and wrist begin
# at the body's fit, which knows nothing of how the forearm is twisted. Fingers bend about -z and spread about y.
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
_DOUBT: F64 = np.array([doubt for rows in _TABLE.values() for *_, doubt in rows])
_ARM = np.array([name in ("elbow", "wrist") for name in _NAMES])
_TIE = 0.08  # radians by which a finger bends otherwise than its neighbour

_SURE = 0.5  # presence of a hand that is there
_NEAR = 1.0  # hand sizes between the body's hand and the network's: farther off it is another hand
_MET = 0.3  # hand sizes that landmarks may be off in the end, by the median
_OUTLIER = 1.5  # strays; a landmark this far off counts half
_ROUNDS = 3  # landmarks weighed anew


@dataclass(frozen=True, eq=False)
class HandPlaces:
    """Where the 21 landmarks lie on a left hand, in shares of ``hand_size``."""

    offsets: F64  # [21, 3] from the joint of CARRIERS, in its rest frame
    strays: F64  # [21] typical distance in the picture between where a landmark should be and where the network puts it


@lru_cache(maxsize=1)
def hand_places() -> HandPlaces:
    """Return the embedded table (hand_offsets.json), measured on people whose joints and skin are known."""
    text = (resources.files("glsplat.extras.authoring.fit") / "hand_offsets.json").read_text(encoding="utf-8")
    rows = json.loads(text)["landmarks"]
    return HandPlaces(np.array([row["offset"] for row in rows]), np.array([row["stray"] for row in rows]))


def hand_size(joints: F64) -> float:
    """Metres from the left wrist to the middle knuckle of resting joints [55, 3]; a hand is about twice as long."""
    return float(np.linalg.norm(joints[JOINT_NAMES.index("left_middle1")] - joints[JOINT_NAMES.index("left_wrist")]))


def fit_hand(body: Body, fit: BodyFit, seen: FittedView, view: View, hand: Hand, side: str) -> F64 | None:
    """[55, 3] the view's rotations with those of one forearm and hand replaced, None for a hand that is not believed.

    That is one the network does not see, or not where the body has it, or that no bending of fingers explains. The
    network's rough depths are not used: with them fingers came out worse, in the picture and in space.
    """
    points = _landmark_points(fit, side)
    pixels = view.focal * hand_size(fit.joints) / float(seen.joints[JOINT_NAMES.index(f"{side}_wrist"), 2])
    sign = np.where(_AXES == 0, 1.0, 1.0 if side == "left" else -1.0)  # unknowns are those of a left hand
    rows = np.array([JOINT_NAMES.index(f"{side}_{name}") for name in _NAMES], np.intp)
    columns = [column(f"{side}_{name}", int(axis)) for name, axis in zip(_NAMES, _AXES, strict=True)]
    mean = np.where(_ARM, seen.rotations[rows, _AXES] * sign, _MEAN)
    weights = 1 / (hand_places().strays * pixels)

    def turned(x: F64) -> F64:
        rotations = seen.rotations.copy()
        rotations[rows, _AXES] = x * sign
        return rotations

    def away(x: F64, derive: bool) -> tuple[F64, F64]:
        """[21, 2] pixels from the landmarks to where the hand has them, and [21, 2, P] derivatives if asked."""
        posed = fully_posed(body, fit.betas, seen.root, seen.pelvis, turned(x))
        where, moves = posed.derivatives(points) if derive else (posed.points(points), None)
        at, slopes = projected(where, view.focal, view.centre, None if moves is None else moves[..., columns] * sign)
        return at - hand.points, slopes

    if hand.presence < _SURE or np.linalg.norm(away(mean, False)[0].mean(axis=0)) > _NEAR * pixels:
        return None
    x, trust = mean, np.ones(len(weights))
    for _ in range(_ROUNDS):

        def equations(x: F64, derive: bool, each: F64 = weights * trust) -> tuple[F64, F64]:
            far, slopes = away(x, derive)
            residual = np.concatenate([(far * each[:, None]).ravel(), (x - mean) / _DOUBT, _TIES @ x])
            if not derive:
                return residual, np.zeros((0, 0))
            slope = (slopes * each[:, None, None]).reshape(-1, len(x))
            return residual, np.concatenate([slope, np.diag(1 / _DOUBT), _TIES])

        x = least_squares(equations, x, 8).clip(*_LIMITS)
        far = np.linalg.norm(away(x, False)[0], axis=1)
        trust = 1 / np.sqrt(1 + (far * weights / _OUTLIER) ** 2)
    return turned(x) if np.median(far) < _MET * pixels else None


def _landmark_points(fit: BodyFit, side: str) -> Points:
    """The 21 landmarks as points of the person's hand; their shape is in ``fit.joints`` already."""
    table = hand_places()
    joints = np.array([JOINT_NAMES.index(f"{side}_{name}") for name in CARRIERS], np.intp)
    mirror = np.array([1.0 if side == "left" else -1.0, 1.0, 1.0])
    rest = fit.joints[joints] + table.offsets * mirror * hand_size(fit.joints)
    return Points(rest, np.zeros((len(rest), 3, BETAS)), joints[:, None], np.ones((len(rest), 1)))


def _bounds() -> tuple[F64, F64]:
    """[P] lowest and [P] highest angles: ranges of motion of the left arm and fingers."""
    low, high = [], []
    for name, axis in zip(_NAMES, _AXES, strict=True):
        if name in ("elbow", "wrist"):
            box = BOXES[JOINT_NAMES.index(f"left_{name}")]
            bounds = box[axis], box[3 + axis]
        elif name.startswith("thumb"):
            bounds = -_THUMB, _THUMB
        else:
            bounds = FINGER_LOW[int(name[-1]) - 1, axis], FINGER_HIGH[int(name[-1]) - 1, axis]
        low.append(bounds[0])
        high.append(bounds[1])
    return np.array(low), np.array(high)


def _ties() -> F64:
    """[9, P] neighbouring fingers bend alike."""
    rows = np.zeros((9, len(_NAMES)))
    pairs = [(f"{a}{bone}", f"{b}{bone}") for bone in (1, 2, 3) for a, b in pairwise(_FINGERS)]
    for row, pair in enumerate(pairs):
        for name, value in zip(pair, (1.0, -1.0), strict=True):
            bend = next(k for k, other in enumerate(_NAMES) if other == name and _AXES[k] == 2)
            rows[row, bend] = value / _TIE
    return rows


_THUMB = 1.0  # radians, either way about any axis
_LIMITS, _TIES = _bounds(), _ties()
