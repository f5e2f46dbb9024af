"""Two legs with their feet, and how far the body is from losing the ground: common to both solvers."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.quat import JointPose, Quat, Vec, add, rotate
from glsplat.tracking.solve.stepping.foot import Foot
from glsplat.tracking.solve.stepping.leg import REFERENCE_LEG_M, SOFT, TIPTOE_RAD, Leg
from glsplat.tracking.solve.tracked import AFLOAT_M, TrackedFoot

__all__ = ["TAKE_OFF_M", "USEFUL_STEP_M", "USEFUL_TURN_RAD", "TwoLegs"]

TAKE_OFF_M = 0.02  # below and above the reach of the tiptoes, over which a jump begins
USEFUL_STEP_M, USEFUL_TURN_RAD = 0.06, 0.25  # smaller steps and turns do not help a strained leg


class TwoLegs:
    """Legs, feet and trackers of feet of one body, over flat ground at y = 0."""

    def __init__(self, body: Body, soft: float = SOFT) -> None:
        self.sole: float = body.sole
        self.legs: tuple[Leg, Leg] = (Leg(body, 0, soft), Leg(body, 1, soft))
        self.length: float = self.legs[0].length
        self.size: float = self.length / REFERENCE_LEG_M  # 1 for a person of 1.7 m
        self.feet: tuple[Foot, Foot] = (Foot(0), Foot(1))
        self.tracked: tuple[TrackedFoot, TrackedFoot] = (TrackedFoot(self.legs[0]), TrackedFoot(self.legs[1]))
        _, up, back = self.legs[0].ankle
        self.tiptoe: float = up * cos(TIPTOE_RAD) - back * sin(TIPTOE_RAD) - up  # metres the ankle rises on tiptoe
        self._max_hip: float = self.legs[0].limb.farthest + up + self.tiptoe + self.sole  # height on tiptoe
        self.slack: float = 0.0  # metres left until the tiptoes lose the ground
        self.air: float = 0.0  # metres both feet are off the ground

    def reset(self, feet: Sequence[Foot] | None = None) -> None:
        """Forget the past; go on with another solver's ``feet``, if given."""
        self.slack = self.air = 0.0
        for tracked in self.tracked:
            tracked.reset()

    def hips(self, pelvis_at: Vec, pelvis: Quat) -> list[Vec]:
        """Return the positions of both hip joints."""
        return [add(pelvis_at, rotate(pelvis, leg.hip)) for leg in self.legs]

    def _follow(self, goals: Sequence[JointPose | None], knees: Sequence[Vec | None], dt: float) -> None:
        """Put tracked feet where they are."""
        for tracked, foot, goal, knee in zip(self.tracked, self.feet, goals, knees, strict=True):
            tracked.place(foot, goal, knee, dt)

    def _update_clearance(self, hips: Sequence[Vec]) -> None:
        """Update ``slack`` and ``air`` for these hips."""
        left, right = self.tracked[0].height, self.tracked[1].height
        reach = min(hips[0][1] - left, hips[1][1] - right) - self._max_hip
        self.slack = -reach
        if self.tracked[0].ankle is not None and self.tracked[1].ankle is not None:
            self.air = max(min(left, right) - AFLOAT_M, 0.0)
        elif reach < -TAKE_OFF_M:
            self.air = 0.0
        else:  # half a parabola from before the tiptoes lose the ground: the feet leave it without a jolt
            self.air = max(reach, (min(reach, TAKE_OFF_M) + TAKE_OFF_M) ** 2 / (4 * TAKE_OFF_M))

    def _free_feet(self) -> list[Foot]:
        """Return the feet that are not tracked."""
        return [foot for foot in self.feet if self.tracked[foot.index].ankle is None]
