"""What happens to a head that is higher than the body can bring it, or in the floor."""

from __future__ import annotations

from dataclasses import replace
from math import exp

from glsplat.tracking.solve.quat import Vec
from glsplat.tracking.solve.solution import Solution, Targets

__all__ = ["HeightLimit"]

LONGEST_JUMP = 0.7  # seconds; a head out of reach for longer is not a jump (0.7 s in the air is a leap of 0.6 m)
LOWEST_EYE = 0.04  # of the eye height: a head on the floor
FOLLOWS = 0.25  # seconds: of sinking, and of the ground under somebody who climbs
TOLD = 0.02  # metres
STEP = 0.14  # of the eye height: who stood within reach before and is now so much higher stands on something;
UNKNOWN = 2.2  # times as much, who never stood within reach: the calibration may be off
STOOD, UPRIGHT = 0.5, 0.06  # seconds of standing with legs that are bent by less (of the eye height)
CLIMBS = 1.2  # m/s: nobody climbs faster
RISES = 0.8  # m/s of the ground, where it turns out that somebody climbs
SMOOTH = 0.1  # seconds
STILL = 1e-4  # metres


class HeightLimit:
    """The head within the body's reach: above the floor, and not higher than the legs allow for longer than a jump.

    A user taller than the avatar, or a head that looks straight down without bending, would else float for ever: the
    body stays below the head. Who climbs a step, a ladder or a table gets higher than that; the ground then rises under
    the feet, and falls with the head.
    """

    def __init__(self, eye_height: float) -> None:
        self.lowest: float = LOWEST_EYE * eye_height
        self.size: float = eye_height
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.height = 0.0  # metres of the ground over the floor
        self._flight = 0.0  # seconds in the air
        self._sink = 0.0  # metres the body stays below a head that is out of reach
        self._moved = 0.0  # metres the ground rose in the newest moment
        self._eye: float | None = None
        self._speed = 0.0  # m/s of the head, upwards
        self._fastest = 0.0  # likewise, since the head was within reach
        self._stood = 0.0  # seconds

    @property
    def notes(self) -> list[str]:
        """What to say of it."""
        return [*(["head_out_of_reach"] if self._sink > TOLD else []), *(["raised"] if self.height > TOLD else [])]

    def bring(self, targets: Targets, slack: float, tiptoe: float, dt: float) -> Targets:
        """Targets that can be met, over ground at 0. ``slack``: metres that were left a moment ago until the tiptoes
        lost the ground; ``tiptoe``: metres that an ankle rises on them.
        """
        y = targets.eye[1]
        if self._eye is not None and dt > 0:
            self._speed += ((y - self._eye) / dt - self._speed) * (1 - exp(-dt / SMOOTH))
        self._eye = y
        self._flight = self._flight + dt if slack < 0 else 0.0
        away = self._flight > LONGEST_JUMP or self._sink > 0 or self.height > 0
        self._fastest = max(self._fastest, self._speed) if away or self._flight > 0 else 0.0
        if not away and 0 <= slack < UPRIGHT * self.size + tiptoe:
            self._stood += dt
        step = STEP * self.size * (1.0 if self._stood > STOOD else UNKNOWN)
        before = self.height
        if away:
            # down to flat feet, and up again with the head
            wanted = -(slack - tiptoe) * (1 - exp(-dt / FOLLOWS))
            if self.height > 0:
                rest = min(self.height + wanted, 0.0)
                self.height = max(0.0, self.height + wanted)
                self._sink = max(0.0, self._sink + rest)
            else:
                self._sink = max(0.0, self._sink + wanted)
            if self._sink > 0 and (self.height > 0 or self._sink > step) and self._fastest < CLIMBS:
                over = min(self._sink, RISES * dt)
                self._sink, self.height = self._sink - over, self.height + over
        self._moved = self.height - before
        x, y, z = targets.eye
        sunk = max(y - self.height - self._sink, self.lowest)
        if self.height > 0:
            targets = _lower(targets, self.height)
        return targets if sunk == targets.eye[1] else replace(targets, eye=(x, sunk, z))

    def lift(self, solution: Solution) -> Solution:
        """The body over the floor that was solved over the ground."""
        if self.height > 0 or self._moved:
            solution.pelvis = _up(solution.pelvis, self.height)
            left, right = solution.feet
            solution.feet = (left and _up(left, self.height), right and _up(right, self.height))
            if abs(self._moved) > STILL:
                solution.planted = (False, False)
        return solution


def _up(place: Vec, metres: float) -> Vec:
    return (place[0], place[1] + metres, place[2])


def _lower(targets: Targets, metres: float) -> Targets:
    """Everything tracked, as seen from higher ground."""

    def down(place: Vec | None) -> Vec | None:
        return place and _up(place, -metres)

    left, right = targets.feet
    feet = (left and (_up(left[0], -metres), left[1]), right and (_up(right[0], -metres), right[1]))
    knees = (down(targets.knees[0]), down(targets.knees[1]))
    return replace(
        targets,
        eye=_up(targets.eye, -metres),
        left=down(targets.left),
        right=down(targets.right),
        pelvis=down(targets.pelvis),
        feet=feet,
        knees=knees,
    )
