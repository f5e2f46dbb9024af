"""Bring a head that is higher than the body reaches, or in the floor, to where the body can follow."""

from __future__ import annotations

from dataclasses import replace
from math import exp

from glsplat.tracking.solve.quat import JointPose, Vec
from glsplat.tracking.solve.solution import Solution, Targets

MAX_JUMP_S = 0.7  # a head out of reach for longer is not a jump (0.7 s in the air is a leap of 0.6 m)
MIN_EYES = 0.04  # of the eye height: a head on the floor
SINK_SMOOTHING_S = 0.25  # of sinking, and of the ground under a user who climbs
FLAGGED_M = 0.02
STEP_UP = 0.14  # of the eye height: a user who stood within reach and is now so much higher stands on something;
UNSEEN_STEP_UP = 2.2  # times as much, where the user never stood within reach: the calibration may be off
STANDING_S, STANDING_BEND = 0.5, 0.06  # with legs bent by less (of the eye height), to have stood within reach
MAX_CLIMB_SPEED = 1.2  # m/s of a head; a faster one jumps
MAX_GROUND_SPEED = 0.8  # m/s of the ground that rises under a user who climbs
SPEED_SMOOTHING_S = 0.1
MOVED_M = 1e-4  # of the ground in a moment, above which feet do not stand


class HeightLimit:
    """Keep the head within the body's reach: above the floor, and no higher than the legs allow, except in a jump.

    A user taller than the avatar, or a head that looks straight down without bending, would else float for ever: the
    body stays below the head. A user on a step, a ladder or a table gets higher than that; the ground then rises under
    the feet, and falls with the head.
    """

    def __init__(self, eye_height: float) -> None:
        self.min_eye: float = MIN_EYES * eye_height
        self.eye_height: float = eye_height
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.height = 0.0  # metres of the ground over the floor
        self._flight_s = 0.0
        self._sink = 0.0  # metres the body stays below a head that is out of reach
        self._moved = 0.0  # metres the ground rose in the newest moment
        self._eye: float | None = None
        self._speed = 0.0  # m/s of the head, upwards
        self._max_speed = 0.0  # likewise, since the head was within reach
        self._stood_s = 0.0

    @property
    def notes(self) -> list[str]:
        """Flags of this moment."""
        out = ["head_out_of_reach"] if self._sink > FLAGGED_M else []
        return [*out, "raised"] if self.height > FLAGGED_M else out

    def limit(self, targets: Targets, slack: float, tiptoe: float, dt: float) -> Targets:
        """Return targets within reach, over ground at 0.

        ``slack``: metres that were left a moment ago until the tiptoes lost the ground; ``tiptoe``: metres that an
        ankle rises on them.
        """
        y = targets.eye[1]
        if self._eye is not None and dt > 0:
            self._speed += ((y - self._eye) / dt - self._speed) * (1 - exp(-dt / SPEED_SMOOTHING_S))
        self._eye = y
        self._flight_s = self._flight_s + dt if slack < 0 else 0.0
        away = self._flight_s > MAX_JUMP_S or self._sink > 0 or self.height > 0
        self._max_speed = max(self._max_speed, self._speed) if away or self._flight_s > 0 else 0.0
        if not away and 0 <= slack < STANDING_BEND * self.eye_height + tiptoe:
            self._stood_s += dt
        before = self.height
        if away:
            self._follow(slack - tiptoe, dt)
        self._moved = self.height - before
        x, y, z = targets.eye
        sunk = max(y - self.height - self._sink, self.min_eye)
        if self.height > 0:
            targets = _lowered(targets, self.height)
        return targets if sunk == targets.eye[1] else replace(targets, eye=(x, sunk, z))

    def raised(self, solution: Solution) -> Solution:
        """Return the body over the floor that was solved over the ground."""
        if self.height > 0 or self._moved:
            solution.pelvis = _up(solution.pelvis, self.height)
            left, right = solution.feet
            solution.feet = (left and _up(left, self.height), right and _up(right, self.height))
            if abs(self._moved) > MOVED_M:
                solution.planted = (False, False)
        return solution

    def _follow(self, slack: float, dt: float) -> None:
        """Sink to flat feet, ``slack`` metres away, and rise again with the head; raise the ground of a climber."""
        wanted = -slack * (1 - exp(-dt / SINK_SMOOTHING_S))
        if self.height > 0:
            rest = min(self.height + wanted, 0.0)
            self.height = max(0.0, self.height + wanted)
            self._sink = max(0.0, self._sink + rest)
        else:
            self._sink = max(0.0, self._sink + wanted)
        step = STEP_UP * self.eye_height * (1.0 if self._stood_s > STANDING_S else UNSEEN_STEP_UP)
        if self._sink > 0 and (self.height > 0 or self._sink > step) and self._max_speed < MAX_CLIMB_SPEED:
            over = min(self._sink, MAX_GROUND_SPEED * dt)
            self._sink, self.height = self._sink - over, self.height + over


def _up(position: Vec, metres: float) -> Vec:
    return (position[0], position[1] + metres, position[2])


def _lowered(targets: Targets, metres: float) -> Targets:
    """Return all targets as seen from ground that is higher."""

    def down(position: Vec | None) -> Vec | None:
        return position and _up(position, -metres)

    def foot_down(foot: JointPose | None) -> JointPose | None:
        return foot and (_up(foot[0], -metres), foot[1])

    return replace(
        targets,
        eye=_up(targets.eye, -metres),
        left=down(targets.left),
        right=down(targets.right),
        pelvis=down(targets.pelvis),
        feet=(foot_down(targets.feet[0]), foot_down(targets.feet[1])),
        knees=(down(targets.knees[0]), down(targets.knees[1])),
    )
