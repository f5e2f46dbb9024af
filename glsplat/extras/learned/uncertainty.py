"""Uncertainty of the learned solver: poses outside its network's training, and the expected error of each joint."""

from __future__ import annotations

from math import exp, log

from glsplat.tracking.solve import body as b
from glsplat.tracking.solve.quat import Vec, clamp, length, rotate, scale, smoothstep, sub
from glsplat.tracking.solve.solution import Targets

# pairs: an uncertainty begins beyond the first value, and ends beyond the second
TILTED_UP = (0.3, 0.5)  # vertical part of the head's up: a head that lies or hangs
LOW_EYES = (0.62, 0.68)  # of the eye height: a deep squat, on all fours, on the floor
MISSED_HAND_M = (0.06, 0.03)  # at an eye height of 1.6 m: a hand out of reach of the estimated chest, ...
MISSED_S = (0.2, 1.0)  # ... for that long
TAKEOVER_S = 0.35  # duration of the torso's transition between the solvers

SMOOTHING_S = 0.5  # of the model's inputs
GAP_FLOOR_M, SPEED_FLOOR = 0.02, 0.05  # m, m/s: added under the logarithms
MAX_ERROR_M = 0.8

# a joint's expected error is exp of these times (1, log of gap, log of head speed, head lowness, lost hands)
COEFFICIENTS: dict[tuple[int, ...], tuple[float, float, float, float, float]] = {
    (b.PELVIS, *b.HIPS): (-0.74, 0.72, 0.15, 0.58, 0.10),
    (b.SPINE1, b.SPINE2, b.SPINE3): (-1.12, 0.67, 0.11, 0.70, 0.11),
    (b.NECK, b.HEAD): (-3.90, 0.18, -0.14, 0.96, 0.05),
    (*b.COLLARS, *b.SHOULDERS): (-2.39, 0.37, 0.00, 0.62, 0.16),
    b.ELBOWS: (-1.96, 0.45, 0.03, 0.21, 1.14),
    b.WRISTS: (-2.43, 1.52, -0.11, 0.79, 4.35),
    b.KNEES: (-0.69, 0.45, 0.25, 0.80, 0.05),
    (*b.ANKLES, *b.FEET): (-0.44, 0.39, 0.25, 0.63, 0.09),
}


class Uncertainty:
    """Share of the analytic solver in the torso: 0 none, 1 all of it. Smooth in time.

    The network is unreliable for heads near the ground, upside down or on their side, and for hands out of reach.
    """

    def __init__(self, eye_height: float) -> None:
        self.size: float = eye_height / 1.6
        self.low: tuple[float, float] = (LOW_EYES[0] * eye_height, LOW_EYES[1] * eye_height)
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self.uncertain: bool = False
        self._share: float | None = None  # before easing
        self._misses = False
        self._changed_s = 0.0  # time for which that has differed

    def update(self, targets: Targets, missed: float, dt: float) -> float:
        """Return the share now. ``missed``: distance of the worse arm from its hand in the last frame, metres."""
        up = rotate(targets.head, (0.0, 1.0, 0.0))[1]
        side = int(self._misses)
        changed = (missed > MISSED_HAND_M[side] * self.size) != self._misses
        self._changed_s = self._changed_s + dt if changed else 0.0
        if self._changed_s > MISSED_S[side]:
            self._misses, self._changed_s = not self._misses, 0.0
        side = int(self.uncertain)
        self.uncertain = up < TILTED_UP[side] or targets.eye[1] < self.low[side] or self._misses
        goal = float(self.uncertain)
        if self._share is None:
            self._share = goal
        self._share = clamp(goal, self._share - dt / TAKEOVER_S, self._share + dt / TAKEOVER_S)
        return smoothstep(self._share)


class ExpectedError:
    """Expected distance of each joint from the truth, fitted on people outside the network's training data.

    A generalised linear model (gamma errors, logarithmic link) on the gap between the network's and the analytic
    pelvis, the head's speed and height, and the number of lost hands. Lengths are those of eyes at 1.6 m.
    """

    def __init__(self, eye_height: float) -> None:
        self.eye_height = eye_height
        self.size: float = eye_height / 1.6
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self._last_eye: Vec | None = None
        self._inputs: tuple[float, ...] | None = None

    def update(self, targets: Targets, gap: float, dt: float) -> tuple[float, ...]:
        """Return metres for each of the 22 body joints. ``gap``: metres between the two solvers' pelves."""
        inputs = self.inputs(targets, gap, dt)
        out = [0.0] * 22
        for joints, weights in COEFFICIENTS.items():
            metres = self.size * exp(sum([w * x for w, x in zip(weights, inputs, strict=True)]))
            for joint in joints:
                out[joint] = min(metres, MAX_ERROR_M * self.size)
        return tuple(out)

    def inputs(self, targets: Targets, gap: float, dt: float) -> tuple[float, ...]:
        """Return the model's inputs: 1, and four smoothed numbers."""
        eye = targets.eye
        step = sub(eye, self._last_eye or eye)
        self._last_eye = eye
        speed = length(scale(step, 1 / (dt * self.size)))
        low = clamp(1 - eye[1] / self.eye_height, 0.0, 1.0)
        lost = 0.5 * ((targets.left is None) + (targets.right is None))
        now = (1.0, log(gap / self.size + GAP_FLOOR_M), log(speed + SPEED_FLOOR), low, lost)
        k = 1 - exp(-dt / SMOOTHING_S)
        before = self._inputs or now
        self._inputs = tuple([x + (y - x) * k for x, y in zip(before, now, strict=True)])
        return self._inputs
