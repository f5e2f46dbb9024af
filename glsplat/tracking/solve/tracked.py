"""A pelvis and feet that are tracked: taken up and given up in a moment, and met as far as head and floor allow."""

from __future__ import annotations

from math import atan2, exp

from glsplat.tracking.solve.quat import (
    IDENTITY,
    Quat,
    Vec,
    about,
    add,
    clamp,
    cross,
    dot,
    inverse_mul,
    length,
    mul,
    nlerp,
    pull,
    rotate,
    rotation_angle,
    rotation_vector,
    sub,
    swing_twist_y,
    to_quat,
    unit,
    wrap,
    yaw_quat,
)
from glsplat.tracking.solve.spine import Spine, Torso
from glsplat.tracking.solve.stepping.foot import FASTEST, Foot
from glsplat.tracking.solve.stepping.leg import Leg

__all__ = ["AFLOAT", "Follow", "Pelvis", "Trust"]

FOUND, LOST = 0.25, 0.3  # seconds in which something that is found or lost is taken up and given up
AT_ONCE = 30.0  # 1/s: how fast the heading is taken up half way through
TILTS = (1.1, 0.5, 0.6)  # radians a tracked pelvis is from the guessed one at most, about x, y, z
NO_PELVIS = (1.9, 2.5)  # radians between which the rotation of a waist's tracker stops to be one
SWING = 1.8  # of the angle that the pelvis misses its place by, seen from the neck, that the chest turns ...
MOST = 1.2  # ... and radians in all
ROUNDS = 5
AFLOAT, STANDS = 0.04, 0.2  # metres off the ground, m/s: up to there a tracked foot stands
GIVEN_UP = 0.36  # seconds of the step that a lost foot takes


class Trust:
    """How much of what is tracked counts: 1 while it is, all of it at the first moment of a body."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.share: float = 0.0
        self._fresh = True

    def update(self, seen: bool, dt: float) -> float:
        """The share, smooth in time."""
        if seen:
            self.share = 1.0 if self._fresh else min(1.0, self.share + dt / FOUND)
        else:
            self.share = max(0.0, self.share - dt / LOST)
        self._fresh = False
        return self.share * self.share * (3 - 2 * self.share)


class Pelvis:
    """Where the pelvis is tracked, from the eyes: a head that is brought to the floor takes it along."""

    def __init__(self) -> None:
        self._share = Trust()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._share.reset()
        self.share: float = 0.0
        self._at: Vec = (0.0, 0.0, 0.0)
        self._turn: Quat = IDENTITY
        self._yaw: float | None = None

    def update(self, at: Vec | None, turn: Quat, eye: Vec, dt: float) -> None:
        """Its place and rotation of now; None: lost."""
        self.share = self._share.update(at is not None, dt)
        if at is None:
            return
        self._at, self._turn = sub(at, eye), turn
        yaw = swing_twist_y(turn)
        self._yaw = self._yaw if yaw is None else yaw

    def facing(self, dt: float) -> tuple[float, float] | None:
        """The heading in radians, and by which part of the way the body takes it in this moment."""
        if self._yaw is None or self.share <= 0:
            return None
        rate = AT_ONCE * self.share / max(1 - self.share, 1e-6)
        return self._yaw, 1 - exp(-rate * dt)

    def bring(self, spine: Spine, eye: Vec, head: Quat, torso: Torso) -> Torso:
        """The torso with its pelvis where it is tracked; the eyes stay, the chest leans as it must."""
        if self.share <= 0:
            return torso
        goal = pull(torso.pelvis_at, add(eye, self._at), self.share)
        way = inverse_mul(torso.pelvis, self._turn)
        low, high = NO_PELVIS
        known = self.share * clamp((high - rotation_angle(way)) / (high - low), 0.0, 1.0)
        x, y, z = [clamp(v, -most, most) * known for v, most in zip(rotation_vector(way), TILTS, strict=True)]
        pelvis, chest, left = mul(torso.pelvis, to_quat((x, y, z))), torso.spine3, MOST
        for _ in range(ROUNDS):
            torso = spine.hang(eye, head, pelvis, chest)
            now, wanted = sub(torso.pelvis_at, torso.neck_at), sub(goal, torso.neck_at)
            axis = cross(now, wanted)
            size = length(axis)
            if size < 1e-5 or left <= 0:
                return torso
            angle = min(SWING * atan2(size, dot(now, wanted)), left)
            left -= angle
            chest = mul(about(unit(axis), angle), chest)
        return spine.hang(eye, head, pelvis, chest)


class Follow:
    """A foot that is tracked: the ankle's place and the foot's rotation, above the floor."""

    def __init__(self, leg: Leg) -> None:
        self.leg = leg
        self._share = Trust()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._share.reset()
        self.ankle: Vec | None = None  # None: not tracked
        self.turn: Quat = IDENTITY
        self.knee: Vec | None = None
        self.height: float = 0.0  # metres the lowest point of the foot is above the floor
        self._begin: tuple[Vec, Quat] | None = None

    def place(self, foot: Foot, goal: tuple[Vec, Quat] | None, knee: Vec | None, dt: float) -> None:
        """Put the foot where ankle and foot are tracked, moving as they do; one that was lost goes on from there."""
        before = self.ankle is not None
        if not before and goal is None:
            self._share.update(False, dt)
            return
        now = self.leg.above(foot, foot.tilt.at), mul(yaw_quat(foot.yaw), to_quat((foot.tilt.at, 0.0, 0.0)))
        if not self._update(goal, knee, now, dt):
            if not foot.planted:
                size = self.leg.length / 0.83
                foot.lift(GIVEN_UP, max(foot.y.at - self.leg.sole, 0.05 * size), False)
            return
        x, y, z = ball = self.ball
        moved = length(sub(ball, foot.ball)) / dt
        yaw = self.yaw
        values = (x, y, z, foot.turn.at if yaw is None else foot.turn.at + wrap(yaw - foot.turn.at), self.tilt)
        for channel, value in zip((foot.x, foot.y, foot.z, foot.turn, foot.tilt), values, strict=True):
            speed = (value - channel.at) / dt if before else 0.0
            channel.put(value)
            channel.speed = clamp(speed, -FASTEST, FASTEST)
        foot.planted, foot.left = y < self.leg.sole + AFLOAT and moved < STANDS, 0.0

    def solve(self, foot: Foot, hip: Vec, pelvis: Quat, yaw: float) -> tuple[Quat, Quat, Quat] | None:
        """Thigh, knee and foot, as ``Leg.solve`` gives them; None where the foot is not tracked."""
        if self.ankle is None:
            return None
        knee_to = None if self.knee is None else sub(self.knee, pull(hip, self.ankle, 0.5))
        return self.leg.follow(foot, self.ankle, self.turn, hip, pelvis, yaw, knee_to)

    def _update(self, goal: tuple[Vec, Quat] | None, knee: Vec | None, now: tuple[Vec, Quat], dt: float) -> bool:
        """Whether it is tracked; ``now``: ankle and rotation of the foot as it was shown last."""
        share = self._share.update(goal is not None, dt)
        if goal is None:
            # given up at once: the foot steps from where it is
            self._share.share = 0.0
            self.ankle = self.knee = self._begin = None
            return False
        ankle, turn = goal
        if share >= 1:
            self._begin = None
        else:
            begin = self._begin = self._begin or now
            ankle, turn = pull(begin[0], ankle, share), nlerp(begin[1], turn, share)
        low = self.leg.lowest(ankle, turn)
        self.ankle, self.turn, self.knee = add(ankle, (0.0, max(-low, 0.0), 0.0)), turn, knee
        self.height = max(low, 0.0)
        return True

    @property
    def ball(self) -> Vec:
        """World place of the foot joint."""
        assert self.ankle is not None
        return sub(self.ankle, rotate(self.turn, self.leg.ankle))

    @property
    def yaw(self) -> float | None:
        """Heading of the foot, of its axis across: a foot that hangs has no other. None: that is vertical."""
        x, _, z = rotate(self.turn, (1.0, 0.0, 0.0))
        return None if x * x + z * z < 0.09 else atan2(-z, x)

    @property
    def tilt(self) -> float:
        """Radians the heel is up."""
        x, y, z = rotate(self.turn, (0.0, 0.0, 1.0))
        return atan2(-y, max((x * x + z * z) ** 0.5, 1e-9))
