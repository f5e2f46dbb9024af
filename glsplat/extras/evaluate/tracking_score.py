"""Score estimated motions against the truth (conventions of AvatarPoser and its successors, docs/tracking.md)."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError
from glsplat.rotations import rotation_matrices
from glsplat.tracking.solve.body import FEET, WRISTS

Array = NDArray[np.float64]

BODY = slice(0, 22)  # the 22 joints of SMPL that the literature scores
LOWER = (1, 2, 4, 5, 7, 8, 10, 11)
UPPER = (3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21)
WINDOW = 10.0  # seconds of a part, to find the part with the largest mean error
CONTACT = 0.02  # metres above the flat ground up to which the ball of a foot counts as planted


@dataclass(frozen=True, slots=True)
class TrackingScore:
    """Errors in cm, cm/s and degrees; jitter (mean third derivative) in 100 m/s^3."""

    frames: int
    mpjpe: float  # 22 body joints
    upper: float
    lower: float
    root: float
    hands: float  # both wrists
    fingers: float  # the 30 finger joints
    mpjre: float  # local rotations of the 22 body joints; NaN without rotations
    mpjve: float
    jitter: float
    jitter_truth: float
    skate: float  # mean speed of the ball of a foot over the ground while it is planted
    skate_truth: float
    penetration: float  # mean depth of the lowest sole under the floor

    def to_json(self) -> dict[str, float | None]:
        """Return a JSON object; unknown values are null."""
        return {k: None if v != v else v for k, v in asdict(self).items()}


def score(
    positions: Array,  # [T, 55, 3] estimated joints, metres
    truth: Array,  # [T, 55, 3]
    rate: float,  # Hz
    sole: float,  # metres from the foot joint to the ground
    rotations: Array | None = None,  # [T, 55, 3] axis-angle
    true_rotations: Array | None = None,
) -> TrackingScore:
    """Compare two motions frame by frame. Raises PoseError for different shapes or fewer than 4 frames."""
    if positions.shape != truth.shape or positions.shape[1:] != (55, 3):
        raise PoseError(f"poses and truth need one shape (T, 55, 3), not {positions.shape} and {truth.shape}")
    if len(positions) < 4:
        raise PoseError(f"a score needs at least 4 frames, not {len(positions)}")
    error = np.linalg.norm(positions - truth, axis=-1) * 100
    velocity = np.linalg.norm(np.diff(positions - truth, axis=0), axis=-1) * rate * 100
    angle = float("nan")
    if rotations is not None and true_rotations is not None:
        ours, theirs = (rotation_matrices(r[:, BODY]) for r in (rotations, true_rotations))
        trace = np.einsum("tjab,tjab->tj", ours, theirs)
        angle = float(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))).mean())
    feet = positions[:, list(FEET)]
    return TrackingScore(
        frames=len(positions),
        mpjpe=float(error[:, BODY].mean()),
        upper=float(error[:, UPPER].mean()),
        lower=float(error[:, LOWER].mean()),
        root=float(error[:, 0].mean()),
        hands=float(error[:, WRISTS].mean()),
        fingers=float(error[:, 25:].mean()),
        mpjre=angle,
        mpjve=float(velocity[:, BODY].mean()),
        jitter=_jitter(positions, rate),
        jitter_truth=_jitter(truth, rate),
        skate=_skate(feet, sole, rate),
        skate_truth=_skate(truth[:, list(FEET)], sole, rate),
        penetration=float(np.maximum(sole - feet[..., 1].min(1), 0).mean() * 100),
    )


def windows(positions: Array, truth: Array, rate: float) -> tuple[float, ...]:
    """Return MPJPE in cm over equal parts of at least WINDOW seconds, or over the whole of a shorter motion."""
    error = np.linalg.norm(positions - truth, axis=-1)[:, BODY].mean(1) * 100
    return tuple([float(part.mean()) for part in np.array_split(error, max(1, int(len(error) / (WINDOW * rate))))])


def mean_score(scores: list[TrackingScore]) -> TrackingScore:
    """Return the mean over clips, weighted by their frames; NaN stays NaN."""
    weights = np.array([s.frames for s in scores], np.float64)
    values = np.array([list(asdict(s).values()) for s in scores], np.float64)
    mean = (values * weights[:, None]).sum(0) / weights.sum()
    return TrackingScore(int(weights.sum()), *mean[1:].tolist())


def _jitter(positions: Array, rate: float) -> float:
    third = np.diff(positions[:, BODY], n=3, axis=0) * rate**3
    return float(np.linalg.norm(third, axis=-1).mean() / 100)


def _skate(feet: Array, sole: float, rate: float) -> float:
    """Return the mean horizontal speed (cm/s) of the balls of the feet between two frames with ground contact."""
    low = feet[..., 1] < sole + CONTACT
    speed = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * rate * 100
    planted = low[1:] & low[:-1]
    return float(speed[planted].mean()) if planted.any() else 0.0
