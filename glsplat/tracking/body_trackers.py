"""The stage of a Tracker for trackers on waist and feet, or joints of a body that a device tracks itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import hypot

from glsplat.tracking.calibration import JOINTS, MAX_MOUNT_M, Calibration, MeanMount, bounded, standing_joints
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.filters import DeviceFilter
from glsplat.tracking.judge import flag_invalid, read_pose, read_position
from glsplat.tracking.sample import TRACKERS, Sample
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import ANKLES, FEET, HIPS, KNEES, PELVIS, SPINE1, Body
from glsplat.tracking.solve.quat import JointPose, Quat, Vec, cross, length, pull, rotate, sub, unit
from glsplat.tracking.solve.solution import Solution, Targets

MAX_DISTANCE = (0.7, 1.3, 1.3)  # of the eye height: limit of the distance from the eyes to waist and feet
LEARNED_AFTER_S = 0.3  # of weighted moments, after which a mount is known
WALKING_WEIGHT = 0.25  # of a moment in which the solver guesses where a foot is
SETTLED_AFTER_S = 0.1  # after which a new device's speed is known
MAX_LEARNING_SPEED = (2.0, 0.2, 0.2)  # m/s: a waist may walk along, feet must stand
UPRIGHT_EYES = 0.9  # of the eye height: with lower eyes the pelvis may be anywhere
STANDING_EYES = 0.97  # of the eye height: with higher eyes a still body stands as at rest
MAX_FOOT_ERROR_M = 0.35  # over the ground, and of height, from a foot's tracker to the solver's foot
MIN_PLANE_SINE = 0.17  # of the angle between two directions that span a plane
MIN_BONE_M = 0.01  # joints nearer than this have no direction

JointAt = Callable[[str], Vec | None]
"""The position of a joint of ``Sample.body`` by name."""


class _Tracker:
    """One tracked joint."""

    def __init__(self, index: int, config: TrackerConfig, calibrated: JointPose | None) -> None:
        self.index, self.calibrated = index, calibrated  # in TRACKERS, the mount of a calibration
        self.filter = DeviceFilter(
            config.body_tracker_position, config.body_tracker_rotation, config.hand_speed, config.turn_speed
        )
        self.reset()

    def reset(self) -> None:
        """Forget the user."""
        self.lose()
        self.mount = self.calibrated
        self.mean = MeanMount()
        self.seen_before = False
        self.from_body = False  # the device reports the joint itself

    def lose(self) -> None:
        """Forget the last pose: the next one passes unchanged."""
        self.filter.reset()
        self.seen_s = 0.0  # since it was last found


class BodyTrackers:
    """Add what is tracked beside head and hands to the targets. Samples without it cost and change nothing."""

    def __init__(self, body: Body, config: TrackerConfig, calibration: Calibration) -> None:
        self.body, self.config, self.floor = body, config, calibration.floor
        self.joints: BodyJoints = BodyJoints(body)
        self._max_distance = [share * body.eye_height for share in MAX_DISTANCE]
        self._trackers = [
            _Tracker(index, config, read_pose(mount, calibration.scale, 0.0, []))
            for index, mount in enumerate(calibration.mounts)
        ]

    def reset(self) -> None:
        """Forget the user: mounts are learned anew, except those of the calibration."""
        for tracker in self._trackers:
            tracker.reset()

    def lose(self) -> None:
        """Forget the place: the next poses pass unchanged."""
        for tracker in self._trackers:
            tracker.lose()

    def update(
        self, sample: Sample, eye: Vec, targets: Targets, dt: float, prediction: float, scale: float, flags: list[str]
    ) -> None:
        """Add to the targets what is tracked. ``eye``: position between the eyes, without prediction."""
        raw = (sample.waist, sample.left_foot, sample.right_foot)
        joints = sample.body
        if joints is not None and not isinstance(joints, Mapping):
            flag_invalid(flags)
            joints = None
        if joints is None and raw == (None, None, None) and not any([t.seen_before for t in self._trackers]):
            return

        def joint_at(name: str) -> Vec | None:
            joint = None if joints is None else joints.get(name)
            return read_position(joint, scale, self.floor, flags)

        feet: list[JointPose | None] = [None, None]
        knees: list[Vec | None] = [None, None]
        for tracker, transform in zip(self._trackers, raw, strict=True):
            side = tracker.index - 1
            pose, from_body = read_pose(transform, scale, self.floor, flags), False
            if pose is None and joints is not None:
                pose = self.joints.pelvis(joint_at) if side < 0 else self.joints.foot(side, joint_at)
                from_body = True
            if pose is None or length(sub(pose[0], eye)) > self._max_distance[tracker.index]:
                if tracker.seen_before:
                    flags.append(f"{TRACKERS[tracker.index]}_lost")
                tracker.lose()
                continue
            joint = self._joint(tracker, pose, from_body, dt, prediction)
            if joint is None:
                continue
            if side < 0:
                targets.pelvis, targets.pelvis_turn = joint
                continue
            feet[side] = joint
            if from_body:
                knees[side] = joint_at(("left-lower-leg", "right-lower-leg")[side])
        targets.feet, targets.knees = (feet[0], feet[1]), (knees[0], knees[1])

    def _joint(
        self, tracker: _Tracker, pose: JointPose, from_body: bool, dt: float, prediction: float
    ) -> JointPose | None:
        """Return the joint's filtered pose; None while the mount is unknown."""
        if from_body != tracker.from_body:
            tracker.lose()
            tracker.from_body = from_body
        tracker.seen_before = True
        tracker.seen_s += dt
        pose = tracker.filter.update(pose, dt)
        if prediction > 0:
            pose = tracker.filter.ahead(prediction, self.config)
        mount = ((0.0, 0.0, 0.0), quat.IDENTITY) if from_body else tracker.mount
        return None if mount is None else quat.compose(pose, mount)

    def learn(self, solution: Solution, eye: Vec, dt: float) -> None:
        """Learn mounts that no calibration has, from the solver's joints while their trackers are not used yet."""
        learning = [t for t in self._trackers if t.filter.pose is not None and t.mount is None and not t.from_body]
        if not learning:
            return
        yaw = quat.swing_twist_y(solution.rotations[PELVIS])
        if yaw is None or eye[1] < UPRIGHT_EYES * self.body.eye_height or solution.airborne:
            return
        # a user who stands upright and still stands as at rest, whatever a solver guesses of legs
        stands = all(solution.planted) and eye[1] > STANDING_EYES * self.body.eye_height
        poses = standing_joints(self.body, eye, yaw) if stands else self._solved(solution)
        for tracker in learning:
            pose, speed = tracker.filter.pose, length(tracker.filter.position.velocity)
            joint, weight = poses[tracker.index], dt
            if pose is None or tracker.seen_s < SETTLED_AFTER_S or speed > MAX_LEARNING_SPEED[tracker.index]:
                continue
            if tracker.index > 0:
                # a standing foot is flat; where it is, the solver guesses while the user walks
                x, _, z = joint[0]
                ankle = self.body.joints[ANKLES[tracker.index - 1]][1] - self.body.ground
                joint = (x, ankle, z), quat.yaw_quat(yaw)
                far = hypot(pose[0][0] - x, pose[0][2] - z)
                if far > MAX_FOOT_ERROR_M or pose[0][1] > MAX_FOOT_ERROR_M:
                    continue
                weight = dt if stands else WALKING_WEIGHT * dt
            tracker.mean.add(quat.relative(pose, joint), weight)
            if tracker.mean.weight >= LEARNED_AFTER_S:
                tracker.mount = bounded(tracker.mean.mount(), MAX_MOUNT_M[tracker.index])

    def _solved(self, solution: Solution) -> list[JointPose]:
        """Return the poses of ``JOINTS`` in a solution."""
        out = [(solution.pelvis, solution.rotations[PELVIS])]
        for leg in zip(HIPS, KNEES, ANKLES, strict=True):
            at, turn = out[0]
            for joint in leg:
                at, turn = quat.compose((at, turn), (self.body.offsets[joint], solution.rotations[joint]))
            out.append((at, turn))
        return out


class BodyJoints:
    """Pelvis and feet from the joint positions of a body that a device tracks.

    Rotations of such joints are not used, because their axes differ between runtimes: the pelvis turns with the line
    between the hips, a foot with the plane of shin and foot.
    """

    def __init__(self, body: Body) -> None:
        joints = body.joints
        self._hips = pull(sub(joints[HIPS[0]], joints[PELVIS]), sub(joints[HIPS[1]], joints[PELVIS]), 0.5)
        across = sub(joints[HIPS[0]], joints[HIPS[1]])
        self._pelvis = _frame(across, sub(joints[SPINE1], joints[PELVIS]))
        # shins straight up: whether a rest pose's knees are behind or before the ankles is its author's choice
        soles = [sub(joints[foot], joints[ankle]) for foot, ankle in zip(FEET, ANKLES, strict=True)]
        self._feet = [_frame(cross((0.0, 1.0, 0.0), sole), sole) for sole in soles]

    def pelvis(self, at: JointAt) -> JointPose | None:
        """Return the pelvis from both hips and the direction of the spine; None where a joint is missing."""
        left, right, low, up = at("left-upper-leg"), at("right-upper-leg"), at("hips"), at("spine-lower")
        if left is None or right is None or low is None or up is None:
            return None
        now = _frame(sub(left, right), sub(up, low))
        if now is None or self._pelvis is None:
            return None
        turn = quat.mul(now, quat.conj(self._pelvis))
        return sub(pull(left, right, 0.5), rotate(turn, self._hips)), turn

    def foot(self, side: int, at: JointAt) -> JointPose | None:
        """Return the ankle's position and the foot's rotation; ``side``: left 0, right 1."""
        name = ("left", "right")[side]
        knee, ankle, ball = at(f"{name}-lower-leg"), at(f"{name}-foot-ankle"), at(f"{name}-foot-ball")
        rest = self._feet[side]
        if knee is None or ankle is None or ball is None or rest is None:
            return None
        shin, sole = sub(knee, ankle), sub(ball, ankle)
        across = cross(shin, sole)
        if length(across) < MIN_PLANE_SINE * length(shin) * length(sole):
            return None
        now = _frame(across, sole)
        return None if now is None else (ankle, quat.mul(now, quat.conj(rest)))


def _frame(across: Vec, along: Vec) -> Quat | None:
    """Return axes with x ``across`` and y as near to ``along`` as a right angle allows; None if both are parallel."""
    if length(across) < MIN_BONE_M**2 or length(along) < MIN_BONE_M:
        return None
    x = unit(across)
    z = cross(x, unit(along))
    if length(z) < MIN_PLANE_SINE:
        return None
    z = unit(z)
    return quat.from_axes(x, cross(z, x), z)


assert len(JOINTS) == len(TRACKERS)
