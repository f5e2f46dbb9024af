"""Arms: collar, shoulder, elbow and wrist so that the wrist is where the hand is, with a natural elbow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, exp, pi

from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import COLLARS, ELBOWS, SHOULDERS, SPINE3, WRISTS, Body
from glsplat.tracking.solve.foot import Axis
from glsplat.tracking.solve.limb import Limb, perpendicular, two_bone
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import Quat, Vec, about, add, clamp, conj, distance, dot, mul, pull, rotate, sub, unit
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.spine import Torso

ELBOW_FLEXION_DEG = 148.0  # CDC normal joint range of motion study: 144-150
MAX_MISS_M = 0.005  # of the wrist, before the elbow swings to reach further
SEARCH_RATE = 6.0  # rad/s of that swing
MAX_SEARCH_RAD = 2.5  # likewise
SEARCH_BACK_S = 0.3  # in which the elbow returns to its natural direction
MAX_SWIVEL_RATE = 14.0  # rad/s of an elbow about the line from shoulder to wrist
SWIVEL_S = 0.15  # in which it gets there, smoothly (0.09 s behind)
SOFT = 0.006  # of its length over which an arm becomes straight: the elbow would jump otherwise
FOREARM_SHARE = 0.5  # of pronation that the elbow joint takes; SMPL-X has no forearm joint
MAX_PRONATION_RAD = 1.4  # a side (AAOS: 80 degrees)
MAX_COLLAR_RAD = 0.35  # that the collar turns to help a far hand
HOLD_S, SINK_S, REGAIN_S = 0.25, 0.35, 0.2  # a lost hand stays, sinks to the side, is taken up again


@dataclass(slots=True)
class ArmPose:
    """Local rotations of collar, shoulder, elbow, wrist; the wrist's position; metres from there to the hand."""

    collar: Quat
    shoulder: Quat
    elbow: Quat
    wrist: Quat
    wrist_at: Vec
    miss: float


@dataclass(slots=True)
class _Reach:
    """The arm for one direction of the elbow."""

    miss: float  # metres
    shoulder: Quat  # local
    world: Quat  # rotation of the upper arm
    bend: Quat  # of the elbow, local
    wrist_at: Vec


@dataclass(slots=True)
class _LostHand:
    """The last pose of a hand, in the chest's frame."""

    at: Vec = (0.0, 0.0, 0.0)
    turn: Quat = quat.IDENTITY
    known: bool = False
    lost_s: float = 0.0
    weight: float = 0.0  # 1 lost .. 0 tracked


class Arms:
    """Both arms. A lost hand is held for a moment, then sinks to the side; a found one is taken up smoothly."""

    def __init__(self, body: Body) -> None:
        self.arms = (Arm(body, 0), Arm(body, 1))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._lost = (_LostHand(), _LostHand())
        for arm in self.arms:
            arm.reset()

    def solve(self, targets: Targets, torso: Torso, dt: float) -> list[ArmPose]:
        """Return both arms, reaching for hands as tracked or as remembered."""
        hands = ((targets.left, targets.left_hand), (targets.right, targets.right_hand))
        return [
            arm.solve(torso.spine3, torso.spine3_at, *self._goal(arm, at, turn, torso, dt), dt)
            for arm, (at, turn) in zip(self.arms, hands, strict=True)
        ]

    def _goal(self, arm: Arm, at: Vec | None, hand: Quat, torso: Torso, dt: float) -> tuple[Vec, Quat]:
        """Return position and rotation to reach for with a hand that is tracked at ``at``, or lost (None)."""
        lost = self._lost[arm.index]
        inverse = conj(torso.spine3)
        if at is not None and lost.weight <= 0:
            lost.at, lost.turn = rotate(inverse, sub(at, torso.spine3_at)), mul(inverse, hand)
            lost.lost_s, lost.known = 0.0, True
            return at, hand
        if at is not None:  # found again
            lost.weight, lost.lost_s = max(0.0, lost.weight - dt / REGAIN_S), 0.0
        else:
            lost.weight, lost.lost_s = 1.0, lost.lost_s + dt
        relaxed_at, relaxed_turn = arm.relaxed(torso)
        if not lost.known:  # never seen
            lost.at, lost.turn, lost.known, lost.lost_s = relaxed_at, relaxed_turn, True, HOLD_S
        if lost.lost_s > HOLD_S:
            k = 1 - exp(-dt / SINK_S)
            lost.at, lost.turn = pull(lost.at, relaxed_at, k), quat.nlerp(lost.turn, relaxed_turn, k)
        last_at, last_turn = quat.compose((torso.spine3_at, torso.spine3), (lost.at, lost.turn))
        if at is None:
            return last_at, last_turn
        weight = quat.smoothstep(lost.weight)
        return pull(at, last_at, weight), quat.nlerp(hand, last_turn, weight)


class Arm:
    """One arm. Remembers the elbow's direction so that it neither flips nor jumps."""

    def __init__(self, body: Body, index: int) -> None:
        self.index = index
        self.sign: float = 1.0 if index == 0 else -1.0
        collar, shoulder, elbow, wrist = (pair[index] for pair in (COLLARS, SHOULDERS, ELBOWS, WRISTS))
        self.joints: tuple[int, int, int] = (shoulder, elbow, wrist)
        self.collar_offset: Vec = sub(body.joints[collar], body.joints[SPINE3])
        self.shoulder_offset: Vec = sub(body.joints[shoulder], body.joints[collar])
        self.elbow_offset: Vec = sub(body.joints[elbow], body.joints[shoulder])
        self.wrist_offset: Vec = sub(body.joints[wrist], body.joints[elbow])
        self.rest: Vec = add(self.collar_offset, self.shoulder_offset)  # of the shoulder, from the chest
        self.axis: Vec = body.direction(elbow, wrist)  # of the forearm at rest: the axis of pronation
        # the left forearm flexes about -y (towards +z), the right one about +y
        self.limb: Limb = Limb.of(body, (shoulder, elbow, wrist), (0.0, -self.sign, 0.0), ELBOW_FLEXION_DEG)
        self.reach: float = self.limb.upper + self.limb.lower
        self.back: Vec = quat.scale(self.wrist_offset, -1.0)
        self.swivel: Axis = Axis()  # radians from one sample to the next
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.pole: Vec | None = None  # last elbow direction, in the chest's frame
        self.swivel.put(0.0)
        self.twist = 0.0  # of the hand about the forearm, radians
        self.search = 0.0  # radians from the elbow's natural direction, because of the shoulder's limits

    def solve(self, chest: Quat, chest_at: Vec, hand_at: Vec, hand: Quat, dt: float) -> ArmPose:
        """Return the arm; ``hand_at``, ``hand``: the wrist joint in the world; ``chest``: the spine3 joint's."""
        collar_at = add(chest_at, rotate(chest, self.collar_offset))
        collar = self._collar(chest, collar_at, hand_at)
        clavicle = mul(chest, collar)
        root = add(collar_at, rotate(clavicle, self.shoulder_offset))
        line = unit(sub(hand_at, root))
        pole = self._elbow(chest, root, line, hand_at, hand, dt)

        def reach(search: float) -> _Reach:
            direction = rotate(about(line, search), perpendicular(pole, line)) if search else pole
            return self._reach(clavicle, root, hand_at, direction)

        found = reach(self.search)
        if found.miss > MAX_MISS_M or self.search:
            if found.miss <= MAX_MISS_M:
                found = self._search_back(found, reach, dt)
            else:
                found = self._search_on(found, reach, SEARCH_RATE * dt)
        elbow, wrist = self._pronation(mul(found.world, found.bend), found.bend, hand)
        return ArmPose(collar, found.shoulder, elbow, wrist, found.wrist_at, found.miss)

    def relaxed(self, torso: Torso) -> tuple[Vec, Quat]:
        """Return a hanging hand in the chest's frame, the palm towards the thigh."""
        inverse = conj(torso.spine3)
        down = unit(rotate(inverse, rotate(torso.pelvis, (0.12 * self.sign, -1.0, 0.12))))
        turn = mul(inverse, mul(torso.pelvis, quat.to_quat((0.0, 0.0, -1.45 * self.sign))))
        return add(self.rest, quat.scale(down, 0.96 * self.reach)), turn

    def _reach(self, clavicle: Quat, root: Vec, hand_at: Vec, pole: Vec) -> _Reach:
        """Return the arm whose elbow points along ``pole``."""
        soft = SOFT * self.reach
        begin, far = self.limb.farthest - soft, distance(root, hand_at)
        end = hand_at
        if far > begin:  # a little nearer where the arm is almost straight
            end = pull(root, hand_at, (begin + soft * (1 - exp(-(far - begin) / soft))) / far)
        world, bend, _ = two_bone(self.limb, root, end, pole)
        free = quat.inverse_mul(clavicle, world)
        shoulder = clamp_joint(self.joints[0], free)
        if shoulder is not free:
            world = mul(clavicle, shoulder)
        at = add(root, rotate(world, add(self.elbow_offset, rotate(bend, self.wrist_offset))))
        return _Reach(distance(at, hand_at), shoulder, world, bend, at)

    def _search_back(self, found: _Reach, reach: Callable[[float], _Reach], dt: float) -> _Reach:
        """Swing the elbow back to its natural direction, as far as the hand stays within reach."""
        search = self.search * (1 - min(1.0, dt / SEARCH_BACK_S))
        search = 0.0 if abs(search) < 1e-3 else search
        other = reach(search)
        if other.miss > MAX_MISS_M:
            search = self.search + (search - self.search) * (MAX_MISS_M - found.miss) / (other.miss - found.miss)
            other = reach(search)
        self.search = search
        return other

    def _search_on(self, found: _Reach, reach: Callable[[float], _Reach], step: float) -> _Reach:
        """Swing the elbow of a shoulder at its limit to where the hand can be reached, a little every sample."""
        best, best_search = found, self.search
        for search in (self.search - step, self.search + step):
            if abs(search) > MAX_SEARCH_RAD:
                continue
            other = reach(search)
            if other.miss < best.miss - 1e-5:
                best, best_search = other, search
        if best.miss < MAX_MISS_M:  # no further than needed
            too_far, gained = found.miss - MAX_MISS_M, found.miss - best.miss
            best_search = self.search + (best_search - self.search) * too_far / gained
            best = reach(best_search)
        self.search = best_search
        return best

    def _collar(self, chest: Quat, collar_at: Vec, hand_at: Vec) -> Quat:
        """Turn the collar with the arm: a third of its elevation above the shoulder, and towards a far hand."""
        arm = sub(rotate(conj(chest), sub(hand_at, collar_at)), self.shoulder_offset)
        far = quat.length(arm)
        direction = unit(arm)
        # scapulohumeral rhythm (Inman 1944): 2 : 1 above the first 30 degrees; the clavicle shows about half of it
        up = 0.3 * max(direction[1], -0.2)
        stretch = clamp((far / self.reach - 0.88) / 0.12, 0.0, 1.0)
        forward = 0.12 * direction[2] + stretch * MAX_COLLAR_RAD * direction[2]
        up += stretch * 0.5 * MAX_COLLAR_RAD * direction[1]
        # left: turning +x towards +z is about -y, towards +y about +z; mirrored on the right
        return quat.to_quat((0.0, clamp(-forward, -0.45, 0.3) * self.sign, clamp(up, -0.1, 0.6) * self.sign))

    def _elbow(self, chest: Quat, root: Vec, line: Vec, hand_at: Vec, hand: Quat, dt: float) -> Vec:
        """Return the world direction of the elbow: for a straight wrist if possible, else down and out."""
        g = sub(add(hand_at, rotate(hand, self.back)), root)  # to the elbow of a straight wrist
        s = dot(g, line)
        prior = rotate(chest, (0.5 * self.sign, -1.0, -0.5))
        p = perpendicular(prior, line)
        k = 0.15
        want = (g[0] - s * line[0] + k * p[0], g[1] - s * line[1] + k * p[1], g[2] - s * line[2] + k * p[2])
        inverse = conj(chest)
        axis = rotate(inverse, line)
        new = perpendicular(rotate(inverse, want), axis)
        if self.pole is not None:
            old = perpendicular(self.pole, axis)
            angle = atan2(dot(quat.cross(old, new), axis), dot(old, new))
            most = MAX_SWIVEL_RATE * dt
            self.swivel.at = 0.0
            self.swivel.approach(angle, SWIVEL_S, dt)
            new = rotate(about(axis, clamp(self.swivel.at, -most, most)), old)
        self.pole = new
        return rotate(chest, new)

    def _pronation(self, forearm: Quat, bend: Quat, hand: Quat) -> tuple[Quat, Quat]:
        """Return elbow and wrist: the elbow takes its share of the hand's twist about the forearm."""
        local = quat.inverse_mul(forearm, hand)
        ax = self.axis
        twist = quat.wrap(2 * atan2(local[1] * ax[0] + local[2] * ax[1] + local[3] * ax[2], local[0]))
        # stay on the last branch when the hand is turned by about half a turn
        if twist - self.twist > pi:
            twist -= 2 * pi
        elif twist - self.twist < -pi:
            twist += 2 * pi
        self.twist = clamp(twist, -1.2 * pi, 1.2 * pi)
        share = about(ax, clamp(self.twist, -2 * MAX_PRONATION_RAD, 2 * MAX_PRONATION_RAD) * FOREARM_SHARE)
        elbow = clamp_joint(self.joints[1], mul(bend, share))
        return elbow, clamp_joint(self.joints[2], quat.inverse_mul(share, local))
