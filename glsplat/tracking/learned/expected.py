"""How far off the body probably is, joint by joint: the solver's own doubt, calibrated on people it has not seen."""

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
    (PELVIS, *HIPS): (-1.45, 0.50, 0.15, 1.45, 0.43),
    (SPINE1, SPINE2, SPINE3): (-1.69, 0.48, 0.13, 1.37, 0.47),
    (NECK, HEAD): (-3.42, 0.33, 0.03, 1.06, 0.42),
    (*COLLARS, *SHOULDERS): (-2.60, 0.26, 0.07, 1.13, 0.43),
    ELBOWS: (-2.07, 0.33, 0.07, 0.35, 1.33),
    WRISTS: (-4.36, 0.58, -0.17, 0.86, 4.51),
    KNEES: (-1.01, 0.41, 0.19, 1.54, 0.32),
    (*ANKLES, *FEET): (-0.86, 0.34, 0.11, 1.43, 0.30),
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
        """Metres for each of the 22 body joints. ``gap``: metres between the two pelves."""
        known = self.known(targets, gap, dt)
        out = [0.0] * 22
        for joints, weights in TABLE.items():
            metres = self.unit * exp(sum([w * x for w, x in zip(weights, known, strict=True)]))
            for joint in joints:
                out[joint] = min(metres, FARTHEST * self.unit)
        return tuple(out)

    def known(self, targets: Targets, gap: float, dt: float) -> tuple[float, ...]:
        """What the doubt follows: 1, and four numbers that change smoothly."""
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
