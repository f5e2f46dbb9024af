"""Arms: collar, shoulder, elbow and wrist so that the wrist is where the hand is, with a natural elbow."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, exp, pi, sqrt

from glsplat.tracking.solve.body import COLLARS, ELBOWS, SHOULDERS, SPINE3, WRISTS, Body
from glsplat.tracking.solve.limb import Limb, perpendicular, two_bone
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    about,
    clamp,
    cross,
    dot,
    inverse_mul,
    mul,
    pull,
    rotate,
    to_quat,
    unit,
    wrap,
)
from glsplat.tracking.solve.stepping.foot import Axis

__all__ = ["Arm", "ArmPose"]

ELBOW_FLEXION = 148.0  # degrees (CDC normal joint range of motion study: 144-150)
NEAR = 0.005  # metres the wrist may miss before the elbow looks for a better place
SEARCH_RATE = 6.0  # rad/s of that search
SWIVEL_RATE = 14.0  # rad/s an elbow may swing about the line from shoulder to wrist
SWIVEL_TIME = 0.15  # seconds in which it gets there, smoothly (0.09 s behind)
SOFT = 0.006  # of its length over which an arm becomes straight: the elbow would jump otherwise
FOREARM_SHARE = 0.5  # of pronation that the elbow joint takes; SMPL-X has no forearm joint
PRONATION = 1.4  # radians a side (AAOS: 80 degrees)
COLLAR_REACH = 0.35  # radians at most the collar turns to help a far hand


@dataclass(slots=True)
class ArmPose:
    """Local rotations of collar, shoulder, elbow, wrist; the wrist joint's place; metres it missed the hand by."""

    collar: Quat
    shoulder: Quat
    elbow: Quat
    wrist: Quat
    wrist_at: Vec
    miss: float


class Arm:
    """One arm. Remembers the elbow's direction so that it neither flips nor jumps."""

    def __init__(self, body: Body, index: int) -> None:
        self.index = index
        self.sign: float = 1.0 if index == 0 else -1.0
        collar, shoulder, elbow, wrist = (pair[index] for pair in (COLLARS, SHOULDERS, ELBOWS, WRISTS))
        self.joints: tuple[int, int, int] = (shoulder, elbow, wrist)
        self.collar_offset: Vec = _minus(body.joints[collar], body.joints[SPINE3])
        self.shoulder_offset: Vec = _minus(body.joints[shoulder], body.joints[collar])
        self.elbow_offset: Vec = _minus(body.joints[elbow], body.joints[shoulder])
        self.wrist_offset: Vec = _minus(body.joints[wrist], body.joints[elbow])
        self.rest: Vec = _plus(self.collar_offset, self.shoulder_offset)  # of the shoulder, from the chest
        self.axis: Vec = body.direction(elbow, wrist)  # of the forearm at rest: the axis of pronation
        # the left forearm flexes about -y (towards +z), the right one about +y
        self.limb: Limb = Limb.of(body, (shoulder, elbow, wrist), (0.0, -self.sign, 0.0), ELBOW_FLEXION)
        self.reach: float = self.limb.upper + self.limb.lower
        f = self.wrist_offset
        self.back: tuple[float, float, float] = (-f[0], -f[1], -f[2])
        self.pole: Vec | None = None  # last elbow direction, in the chest's frame
        self.swivel: Axis = Axis()  # radians from one sample to the next
        self.extra: float = 0.0  # radians the elbow is away from its natural direction because of the shoulder's limits
        self.twist: float = 0.0

    def reset(self) -> None:
        """Forget the past."""
        self.pole = None
        self.swivel.put(0.0)
        self.twist = self.extra = 0.0

    def solve(self, chest: Quat, chest_at: Vec, hand_at: Vec, hand: Quat, dt: float) -> ArmPose:
        """``hand_at``, ``hand``: world place and rotation of the wrist joint; ``chest``: the spine3 joint's."""
        collar_at = _plus(chest_at, rotate(chest, self.collar_offset))
        collar = self._collar(chest, collar_at, hand_at)
        clavicle = mul(chest, collar)
        root = _plus(collar_at, rotate(clavicle, self.shoulder_offset))
        line = unit(_minus(hand_at, root))
        pole = self._elbow(chest, root, line, hand_at, hand, dt)
        found = self._place(clavicle, root, hand_at, line, pole, self.extra)
        if found[0] > NEAR or self.extra:
            found = self._search(found, clavicle, root, hand_at, line, pole, dt)
        miss, shoulder, world, bend, at = found
        elbow, wrist = self._pronation(mul(world, bend), bend, hand)
        return ArmPose(collar, shoulder, elbow, wrist, at, miss)

    def _place(
        self, clavicle: Quat, root: Vec, hand_at: Vec, line: Vec, pole: Vec, extra: float
    ) -> tuple[float, Quat, Quat, Quat, Vec]:
        """Miss (m), shoulder, its world rotation, elbow flexion and the wrist's place for one elbow direction."""
        if extra:
            pole = rotate(about(line, extra), perpendicular(pole, line))
        world, bend, _ = two_bone(self.limb, root, self._softly(root, hand_at), pole)
        free = inverse_mul(clavicle, world)
        shoulder = clamp_joint(self.joints[0], free)
        if shoulder is not free:
            world = mul(clavicle, shoulder)
        x, y, z = rotate(bend, self.wrist_offset)
        o = self.elbow_offset
        at = _plus(root, rotate(world, (o[0] + x, o[1] + y, o[2] + z)))
        return _distance(at, hand_at), shoulder, world, bend, at

    def _softly(self, root: Vec, hand_at: Vec) -> Vec:
        """The hand's place, or a little nearer where the arm is all but straight."""
        soft = SOFT * self.reach
        begin, far = self.limb.farthest - soft, _distance(root, hand_at)
        if far <= begin:
            return hand_at
        return pull(root, hand_at, (begin + soft * (1 - exp(-(far - begin) / soft))) / far)

    def _search(
        self,
        found: tuple[float, Quat, Quat, Quat, Vec],
        clavicle: Quat,
        root: Vec,
        hand_at: Vec,
        line: Vec,
        pole: Vec,
        dt: float,
    ) -> tuple[float, Quat, Quat, Quat, Vec]:
        """A shoulder at its limit: swing the elbow to where the hand can be reached, a little every sample."""
        miss, step = found[0], SEARCH_RATE * dt
        if miss <= NEAR:  # back towards the natural elbow, as far as the hand stays within reach
            extra = self.extra * (1 - min(1.0, dt / 0.3))
            extra = 0.0 if abs(extra) < 1e-3 else extra
            other = self._place(clavicle, root, hand_at, line, pole, extra)
            if other[0] > NEAR:
                extra = self.extra + (extra - self.extra) * (NEAR - miss) / (other[0] - miss)
                other = self._place(clavicle, root, hand_at, line, pole, extra)
            self.extra = extra
            return other
        best, best_extra = found, self.extra
        for extra in (self.extra - step, self.extra + step):
            if abs(extra) > 2.5:
                continue
            other = self._place(clavicle, root, hand_at, line, pole, extra)
            if other[0] < best[0] - 1e-5:
                best, best_extra = other, extra
        if best[0] < NEAR:  # no further than needed
            best_extra = self.extra + (best_extra - self.extra) * (miss - NEAR) / (miss - best[0])
            best = self._place(clavicle, root, hand_at, line, pole, best_extra)
        self.extra = best_extra
        return best

    def _collar(self, chest: Quat, collar_at: Vec, hand_at: Vec) -> Quat:
        """The shoulder girdle follows the arm: a third of its elevation above the shoulder, and a far reach."""
        to = rotate((chest[0], -chest[1], -chest[2], -chest[3]), _minus(hand_at, collar_at))
        rest = self.shoulder_offset
        arm = (to[0] - rest[0], to[1] - rest[1], to[2] - rest[2])
        far = sqrt(dot(arm, arm))
        direction = unit(arm)
        # scapulohumeral rhythm (Inman 1944): 2 : 1 above the first 30 degrees; the clavicle shows about half of it
        up = 0.3 * max(direction[1], -0.2)
        stretch = clamp((far / self.reach - 0.88) / 0.12, 0.0, 1.0)
        forward = 0.12 * direction[2] + stretch * COLLAR_REACH * direction[2]
        up += stretch * 0.5 * COLLAR_REACH * direction[1]
        # left: turning +x towards +z is about -y, towards +y about +z; mirrored on the right
        return to_quat((0.0, clamp(-forward, -0.45, 0.3) * self.sign, clamp(up, -0.1, 0.6) * self.sign))

    def _elbow(self, chest: Quat, root: Vec, line: Vec, hand_at: Vec, hand: Quat, dt: float) -> Vec:
        """World direction in which the elbow points: a straight wrist if it can be, down and out if not."""
        guess = _plus(hand_at, rotate(hand, self.back))  # the elbow of a straight wrist
        g = _minus(guess, root)
        s = dot(g, line)
        prior = rotate(chest, (0.5 * self.sign, -1.0, -0.5))
        p = perpendicular(prior, line)
        k = 0.15
        want = (g[0] - s * line[0] + k * p[0], g[1] - s * line[1] + k * p[1], g[2] - s * line[2] + k * p[2])
        inverse = (chest[0], -chest[1], -chest[2], -chest[3])
        axis = rotate(inverse, line)
        new = perpendicular(rotate(inverse, want), axis)
        if self.pole is not None:
            old = perpendicular(self.pole, axis)
            angle = atan2(dot(cross(old, new), axis), dot(old, new))
            most = SWIVEL_RATE * dt
            self.swivel.at = 0.0
            self.swivel.approach(angle, SWIVEL_TIME, dt)
            new = rotate(about(axis, clamp(self.swivel.at, -most, most)), old)
        self.pole = new
        return rotate(chest, new)

    def _pronation(self, forearm: Quat, bend: Quat, hand: Quat) -> tuple[Quat, Quat]:
        """Elbow and wrist: the elbow takes its share of the hand's twist about the forearm."""
        local = inverse_mul(forearm, hand)
        ax = self.axis
        twist = wrap(2 * atan2(local[1] * ax[0] + local[2] * ax[1] + local[3] * ax[2], local[0]))
        # stay on the branch of before when the hand is turned by about half a turn
        if twist - self.twist > pi:
            twist -= 2 * pi
        elif twist - self.twist < -pi:
            twist += 2 * pi
        self.twist = clamp(twist, -1.2 * pi, 1.2 * pi)
        share = about(ax, clamp(self.twist, -2 * PRONATION, 2 * PRONATION) * FOREARM_SHARE)
        elbow = clamp_joint(self.joints[1], mul(bend, share))
        return elbow, clamp_joint(self.joints[2], inverse_mul(share, local))


def _plus(a: Vec, b: Vec) -> Vec:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vec, b: Vec) -> Vec:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _distance(a: Vec, b: Vec) -> float:
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
