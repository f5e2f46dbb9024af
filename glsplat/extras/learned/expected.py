"""Estimate the error of each joint, calibrated on people that the network has not seen."""

from __future__ import annotations

from math import exp, log

from glsplat.tracking.solve.body import (
    ANKLES,
    COLLARS,
    ELBOWS,
    FEET,
    HEAD,
    HIPS,
    KNEES,
    NECK,
    PELVIS,
    SHOULDERS,
    SPINE1,
    SPINE2,
    SPINE3,
    WRISTS,
)
from glsplat.tracking.solve.quat import Vec, clamp, length, scale, sub
from glsplat.tracking.solve.solution import Targets

__all__ = ["ExpectedError"]

PACE = 0.5  # seconds of the low pass of the head's speed, and of all that the doubt follows
FLOOR = (0.02, 0.05)  # metres, m/s under the logarithms: of the gap, of the pace
FARTHEST = 0.8  # metres: nobody's pelvis is expected to be further off

# a joint's expected error is exp of these times (1, log of the gap, log of the pace, how low, hands that are not seen)
TABLE: dict[tuple[int, ...], tuple[float, float, float, float, float]] = {
    (PELVIS, *HIPS): (-0.74, 0.72, 0.15, 0.58, 0.10),
    (SPINE1, SPINE2, SPINE3): (-1.12, 0.67, 0.11, 0.70, 0.11),
    (NECK, HEAD): (-3.90, 0.18, -0.14, 0.96, 0.05),
    (*COLLARS, *SHOULDERS): (-2.39, 0.37, 0.00, 0.62, 0.16),
    ELBOWS: (-1.96, 0.45, 0.03, 0.21, 1.14),
    WRISTS: (-2.43, 1.52, -0.11, 0.79, 4.35),
    KNEES: (-0.69, 0.45, 0.25, 0.80, 0.05),
    (*ANKLES, *FEET): (-0.44, 0.39, 0.25, 0.63, 0.09),
}


class ExpectedError:
    """Mean distances from the truth that people had whom the network had not seen, by what is known at run time.

    A generalised linear model (gamma errors, logarithmic link) on the gap between the network's and the analytic
    pelvis, the head's speed and height, and how many hands are seen.
    """

    def __init__(self, eye_height: float) -> None:
        self.eye_height = eye_height
        self.unit: float = eye_height / 1.6
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._before: Vec | None = None
        self._known: tuple[float, ...] | None = None

    def update(self, targets: Targets, gap: float, dt: float) -> tuple[float, ...]:
        """Return metres for each of the 22 body joints. ``gap``: metres between the two solvers' pelves."""
        known = self.known(targets, gap, dt)
        out = [0.0] * 22
        for joints, weights in TABLE.items():
            metres = self.unit * exp(sum([w * x for w, x in zip(weights, known, strict=True)]))
            for joint in joints:
                out[joint] = min(metres, FARTHEST * self.unit)
        return tuple(out)

    def known(self, targets: Targets, gap: float, dt: float) -> tuple[float, ...]:
        """Return the model's inputs: 1, and four numbers that change smoothly."""
        eye = targets.eye
        step = sub(eye, self._before or eye)
        self._before = eye
        pace = length(scale(step, 1 / (dt * self.unit)))
        low = clamp(1 - eye[1] / self.eye_height, 0.0, 1.0)
        unseen = 0.5 * ((targets.left is None) + (targets.right is None))
        now = (1.0, log(gap / self.unit + FLOOR[0]), log(pace + FLOOR[1]), low, unseen)
        k = 1 - exp(-dt / PACE)
        before = self._known or now
        self._known = tuple([a + (b - a) * k for a, b in zip(before, now, strict=True)])
        return self._known
