"""A leg: hip, knee and ankle for a placed foot; the heel rises where the leg is too short or the ankle stiff."""

from __future__ import annotations

from math import acos, atan2, cos, exp, hypot, radians, sin, sqrt

from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import ANKLES, FEET, HIPS, KNEES, PELVIS, Body
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.limb import Limb, two_bone
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, conj, distance, length, mul, pull, rotate, sub, unit

LegPose = tuple[Quat, Quat, Quat]
"""World rotation of the thigh, local rotation of the knee, world rotation of the foot."""

REFERENCE_LEG_M = 0.83  # of a person of 1.7 m, whose lengths and speeds the constants of stepping are

KNEE_FLEXION_DEG = 145.0  # that the knee may bend
DORSIFLEXION_RAD = 0.66  # that the ankle bends under load
TIPTOE_RAD = 1.0  # that the heel may lift about the ball
MAX_EXTENSION = 0.5  # metres a foot is behind the hip for each metre below it: 27 degrees
HEEL_BACK = 0.35  # from the ankle to the heel, of the way from ball to ankle
STRAIGHT = 0.997  # of its length a leg stretches to
KNEE_PRIOR_M = 0.05  # weight of the usual direction of a knee against a known one
SOFT = 0.03  # of its length over which a leg becomes straight: the knee would jump otherwise


class Leg:
    """One leg's measures and its inverse kinematics."""

    def __init__(self, body: Body, index: int, soft: float = SOFT) -> None:
        hip, knee, ankle, foot = HIPS[index], KNEES[index], ANKLES[index], FEET[index]
        self.index, self.soft = index, soft
        self.hip: Vec = sub(body.joints[hip], body.joints[PELVIS])
        self.limb: Limb = Limb.of(body, (hip, knee, ankle), (1.0, 0.0, 0.0), KNEE_FLEXION_DEG, STRAIGHT)
        self.length: float = self.limb.upper + self.limb.lower
        self.ankle: Vec = sub(body.joints[ankle], body.joints[foot])  # from the ball
        self.knee: Vec = sub(body.joints[knee], body.joints[hip])
        self.shin: Vec = sub(body.joints[ankle], body.joints[knee])
        self.sole: float = body.sole
        self.ankle_height: float = 0.0  # metres, as last solved
        self.size: float = length(self.ankle)
        self.ball: Vec | None = None  # where the last solution put it, if the leg reached

    def solve(self, foot: Foot, hip: Vec, pelvis: Quat, yaw: float, knee_to: Vec | None = None) -> LegPose:
        """Return the leg; a foot out of its reach is ``strained``: a straight leg points at it.

        ``knee_to``: world direction in which the knee bends, where that is known; its length is its weight.
        """
        limb, pitch = self.limb, foot.tilt.at
        foot.strained = False
        aside_x = aside_z = 0.0
        exact = True
        ankle = self.above(foot, pitch)
        far = distance(hip, ankle)
        want = self._softly(far, self.soft)
        if far - want > 1e-6:
            # a leg too short for the flat foot lifts the heel, as little as it must
            pitch = self._heel(foot, hip, want, pitch, max(pitch, TIPTOE_RAD))
            ankle = self.above(foot, pitch)
            excess = distance(hip, ankle) - limb.farthest
            exact, foot.strained = excess < 1e-3, excess > 0.005
        elif far < limb.nearest:
            aside_x, aside_z = self._aside(hip, ankle, yaw)
            ankle = self.above(foot, pitch, aside_x, aside_z)
            foot.strained = hypot(aside_x, aside_z) > 0.005
        foot_yaw = foot.turn.at
        pole = self._pole(foot_yaw, pelvis, yaw, knee_to)
        thigh, knee, shin = two_bone(limb, hip, ankle, pole)
        for _ in range(3):
            # a deep crouch lifts the heel where the ankle bends no further
            lean = atan2(-(shin[0] * sin(foot_yaw) + shin[2] * cos(foot_yaw)), -shin[1])
            excess = lean - pitch - DORSIFLEXION_RAD
            if not 1e-4 < excess < 1.5 or pitch > 1.2:
                break
            pitch += 0.7 * excess
            ankle = self.above(foot, pitch, aside_x, aside_z)
            thigh, knee, shin = two_bone(limb, hip, ankle, pole)
            exact = exact and limb.nearest < distance(hip, ankle) < limb.farthest + 1e-3
        self.ankle_height = ankle[1]
        x, y, z = foot.ball
        self.ball = (x + aside_x, y, z + aside_z) if exact else None
        return thigh, knee, mul(quat.yaw_quat(foot_yaw), quat.to_quat((pitch, 0.0, 0.0)))

    def follow(
        self, foot: Foot, ankle: Vec, turn: Quat, hip: Vec, pelvis: Quat, yaw: float, knee_to: Vec | None
    ) -> LegPose:
        """Return the leg for an ankle and a foot that are tracked; a leg too short points at them."""
        far = distance(hip, ankle)
        want = self._softly(far, SOFT)
        foot.strained = far - want > 0.02
        if far > want:
            ankle = pull(hip, ankle, want / far)
        elif far < self.limb.nearest:
            x, z = self._aside(hip, ankle, yaw)
            ankle = add(ankle, (x, 0.0, z))
            foot.strained = hypot(x, z) > 0.02
        thigh, knee, _ = two_bone(self.limb, hip, ankle, self._pole(foot.yaw, pelvis, yaw, knee_to))
        self.ankle_height = ankle[1]
        self.ball = sub(ankle, rotate(turn, self.ankle))
        return thigh, knee, turn

    def lowest(self, ankle: Vec, turn: Quat) -> float:
        """Return the height in metres of a foot's lowest point, below its ball or at its heel."""
        _, up, back = self.ankle
        ball = ankle[1] - rotate(turn, self.ankle)[1]
        heel = ankle[1] + rotate(turn, (0.0, -up - self.sole, HEEL_BACK * back))[1]
        return min(ball - self.sole, heel)

    def _pole(self, foot_yaw: float, pelvis: Quat, yaw: float, knee_to: Vec | None) -> Vec:
        """Return the direction in which the knee bends: between pelvis and foot, or where it is known to be."""
        turn = quat.wrap(foot_yaw - yaw)
        facing = yaw + 0.5 * turn
        ahead = rotate(pelvis, (0.0, 0.0, 1.0))
        s, c = sin(facing), cos(facing)
        pole = unit((s + ahead[0], 0.5 * ahead[1], c + ahead[2]), (s, 0.0, c))
        # the knee bends outwards a little (hip abduction of a relaxed crouch)
        out = 0.12 if self.index == 0 else -0.12
        pole = unit((pole[0] + out * c, pole[1], pole[2] - out * s))
        return pole if knee_to is None else unit(add(quat.scale(pole, KNEE_PRIOR_M), knee_to))

    def _aside(self, hip: Vec, ankle: Vec, yaw: float) -> tuple[float, float]:
        """Return by how much a fully bent knee pushes the foot away from under the hip: x, z."""
        down, x, z = hip[1] - ankle[1], ankle[0] - hip[0], ankle[2] - hip[2]
        aside = hypot(x, z)
        if aside < 1e-6:
            x, z, aside = 1e-6 * sin(yaw), 1e-6 * cos(yaw), 1e-6
        k = sqrt(max(self.limb.nearest * self.limb.nearest - down * down, 0.0)) / aside - 1
        return x * k, z * k

    def strains(self, foot: Foot, hip: Vec, pelvis: Quat) -> bool:
        """Return whether a hip there would overstretch the leg to its planted foot, or extend too far back."""
        x, y, z = sub(self.above(foot, TIPTOE_RAD), hip)
        if x * x + y * y + z * z > self.limb.farthest * self.limb.farthest:
            return True
        x, y, z = rotate(conj(pelvis), (x, y, z))
        return -z > MAX_EXTENSION * -y > 0

    def above(self, foot: Foot, pitch: float, aside_x: float = 0.0, aside_z: float = 0.0) -> Vec:
        """Return the ankle's position, the heel lifted by ``pitch``, the foot pushed aside."""
        x, y, z = self.ankle
        c, s = cos(pitch), sin(pitch)
        y, z = y * c - z * s, y * s + z * c
        yaw = foot.turn.at
        c, s = cos(yaw), sin(yaw)
        return (foot.x.at + aside_x + x * c + z * s, foot.y.at + y, foot.z.at + aside_z - x * s + z * c)

    def settle(self, hip: Vec, thigh: Quat, knee: Quat) -> Quat:
        """Return the knee of a thigh moved by the hip's limits, bent so that the ankle keeps its height.

        The ankle's height is a sine of the bend; the nearest solution is taken.
        """
        at = add(hip, rotate(thigh, self.knee))
        x, y, z = rotate(knee, self.shin)
        ux, uy, uz = rotate(conj(thigh), (0.0, 1.0, 0.0))
        across, along = uy * y + uz * z, uz * y - uy * z
        size = hypot(across, along)
        lift = self.ankle_height - at[1] - ux * x
        if across >= lift or size < 1e-9:
            return knee
        middle, half = atan2(along, across), acos(clamp(lift / size, -1.0, 1.0))
        turn = min((quat.wrap(middle - half), quat.wrap(middle + half)), key=abs)
        bent = quat.rotation_vector(knee)[0]
        return mul(quat.to_quat((clamp(bent + turn, 0.0, radians(KNEE_FLEXION_DEG)) - bent, 0.0, 0.0)), knee)

    def _softly(self, far: float, share: float) -> float:
        """Return the distance from hip to ankle for a foot this far away: a leg never becomes straight at once."""
        soft = share * self.length
        begin = self.limb.farthest - soft
        return far if far <= begin else begin + soft * (1 - exp(-(far - begin) / soft))

    def _heel(self, foot: Foot, hip: Vec, want: float, low: float, high: float) -> float:
        """Return the pitch between low and high that brings the ankle to this distance from the hip, or nearest to it.

        Law of cosines about the ball: the ankle's circle in the foot's plane.
        """
        foot_yaw = foot.turn.at
        s, c = sin(foot_yaw), cos(foot_yaw)
        hx, hy, hz = hip[0] - foot.x.at, hip[1] - foot.y.at, hip[2] - foot.z.at
        hx, hz = hx * c - hz * s, hx * s + hz * c
        x, y, z = self.ankle
        across, along = hy * y + hz * z, hz * y - hy * z
        size = hypot(across, along)
        if size < 1e-9:
            return low
        goal = 0.5 * (hx * hx + hy * hy + hz * hz + self.size * self.size - want * want) - hx * x
        best = atan2(along, across)  # the ankle nearest to the hip
        return clamp(best - acos(clamp(goal / size, -1.0, 1.0)), low, high) if best > low else low
