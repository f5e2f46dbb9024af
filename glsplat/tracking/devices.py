"""Trackers on waist and feet, or a device's own body: judged, mounted, filtered, and put among the solver's targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot

from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.filters import Device, PositionFilter, RotationFilter
from glsplat.tracking.mounts import JOINTS, MOST, Mean, Pose, between, mounted, standing, within
from glsplat.tracking.places import Places
from glsplat.tracking.reading import invalid, read_place, read_pose
from glsplat.tracking.sample import TRACKERS, Sample, Transform
from glsplat.tracking.solve.body import ANKLES, HIPS, KNEES, PELVIS, Body
from glsplat.tracking.solve.quat import IDENTITY, Vec, add, length, mul, rotate, sub, swing_twist_y, yaw_quat
from glsplat.tracking.solve.solution import Solution, Targets

__all__ = ["Extras"]

FARTHEST = (0.7, 1.3, 1.3)  # of the eye height, metres from the eyes that waist and feet can be
ENOUGH = 0.3  # seconds of good moments after which a mount is known
GUESSED = 0.25  # what a moment is worth at which the solver does not know where the foot is
SETTLED = 0.1  # seconds after which a new device's speed is known
QUIET = (2.0, 0.2, 0.2)  # m/s below which a mount is learned: a waist that walks along, feet that stand
UPRIGHT = 0.9  # of the eye height: below, the pelvis is anywhere
STANDS = 0.97  # of the eye height: above, a still body stands as at rest
NEARBY = 0.35  # metres over the ground, and of height, that a foot's tracker may be from where the solver has it
BODY = ((0.0, 0.0, 0.0), IDENTITY)  # the mount of joints that are told as such


@dataclass(slots=True)
class _Slot:
    """One tracked joint."""

    index: int  # in TRACKERS
    device: Device
    told: Pose | None  # the mount of a calibration
    mount: Pose | None = None  # of the tracker
    own: bool = False  # the device tells the joint itself
    seen: float = 0.0  # seconds since it was last found
    ever: bool = False
    learned: Mean = field(default_factory=Mean)

    def reset(self) -> None:
        """A new user."""
        self.lose()
        self.mount, self.ever, self.learned = self.told, False, Mean()

    def lose(self) -> None:
        """Not seen any more."""
        self.device.reset()
        self.seen = 0.0


class Extras:
    """What a sample may have beside head and hands. Samples without it cost nothing and change nothing."""

    def __init__(
        self, body: Body, config: TrackerConfig, scale: float, floor: float, mounts: Sequence[Transform | None]
    ) -> None:
        self.body, self.config, self.scale, self.floor = body, config, scale, floor
        self.prediction: float = config.prediction  # seconds, as the tracker has it
        self.places: Places = Places(body)
        self._farthest = [share * body.eye_height for share in FARTHEST]
        self._slots = [
            _Slot(
                index,
                Device(
                    PositionFilter(config.extra_position, config.hand_speed),
                    RotationFilter(config.extra_rotation, config.turn_speed),
                ),
                read_pose(mount, scale, 0.0, []),
            )
            for index, mount in enumerate(mounts)
        ]
        self.reset()

    def reset(self) -> None:
        """A new user: mounts are learned anew, but for those of the calibration."""
        for slot in self._slots:
            slot.reset()

    def lose(self) -> None:
        """A new place: the next poses are taken as they come."""
        for slot in self._slots:
            slot.lose()

    def update(self, sample: Sample, eye: Vec, targets: Targets, dt: float, flags: list[str]) -> None:
        """Add to the targets what is tracked. ``eye``: the head as it is, before any prediction."""
        trackers = (sample.waist, sample.left_foot, sample.right_foot)
        joints = sample.body
        if joints is not None and not isinstance(joints, Mapping):
            invalid(flags)
            joints = None
        if joints is None and trackers == (None, None, None) and not any([slot.ever for slot in self._slots]):
            return

        def at(name: str) -> Vec | None:
            joint = None if joints is None else joints.get(name)
            return read_place(joint, self.scale, self.floor, flags)

        feet: list[Pose | None] = [None, None]
        knees: list[Vec | None] = [None, None]
        for slot, tracker in zip(self._slots, trackers, strict=True):
            pose, own = read_pose(tracker, self.scale, self.floor, flags), False
            side = slot.index - 1
            if pose is None and joints is not None:
                pose, own = (self.places.pelvis(at) if side < 0 else self.places.foot(side, at)), True
            if pose is not None and length(sub(pose[0], eye)) > self._farthest[slot.index]:
                pose = None
            if pose is None:
                if slot.ever:
                    flags.append(f"{TRACKERS[slot.index]}_lost")
                slot.lose()
                continue
            joint = self._filtered(slot, pose, own, dt)
            if joint is None:
                continue
            if side < 0:
                targets.pelvis, targets.pelvis_turn = joint
                continue
            feet[side] = joint
            if own:
                knees[side] = self.places.knee(side, at)
        targets.feet, targets.knees = (feet[0], feet[1]), (knees[0], knees[1])

    def _filtered(self, slot: _Slot, pose: Pose, own: bool, dt: float) -> Pose | None:
        """The joint's pose; None while the mount is not known."""
        if own != slot.own:
            slot.lose()
            slot.own = own
        slot.ever = True
        slot.seen += dt
        device, config = slot.device, self.config
        device.at = device.position.update(pose[0], dt)
        device.turn = device.rotation.update(pose[1], dt)
        at, turn = device.at, device.turn
        if self.prediction > 0:
            at, turn = device.ahead(self.prediction, config.predicted_metres, config.predicted_radians)
        mount = BODY if own else slot.mount
        return None if mount is None else mounted((at, turn), mount)

    # -- mounts

    def learn(self, solution: Solution, eye: Vec, dt: float) -> None:
        """Mounts that no calibration told: from where the solver has a joint while its tracker is not used yet."""
        learning = [s for s in self._slots if s.device.at is not None and s.mount is None and not s.own]
        if not learning:
            return
        pelvis, ankles = _joints(self.body, solution)
        yaw = swing_twist_y(pelvis[1])
        if yaw is None or eye[1] < UPRIGHT * self.body.eye_height or solution.airborne:
            return
        # who stands upright and still stands as at rest, whatever a solver guesses of legs
        rest = all(solution.planted) and eye[1] > STANDS * self.body.eye_height
        if rest:
            pelvis, *ankles_at_rest = standing(self.body, eye, yaw)
            ankles = [place for place, _ in ankles_at_rest]
        for slot in learning:
            device, side = slot.device, slot.index - 1
            if slot.seen < SETTLED or device.at is None or length(device.position.velocity) > QUIET[slot.index]:
                continue
            joint, worth = pelvis, dt
            if side >= 0:
                # a foot that stands is flat; where it is, the solver guesses while somebody walks
                x, _, z = ankles[side]
                joint = (x, self.body.joints[ANKLES[side]][1] - self.body.ground, z), yaw_quat(yaw)
                far = hypot(device.at[0] - x, device.at[2] - z)
                if far > NEARBY or device.at[1] > NEARBY:
                    continue
                worth = dt if rest else GUESSED * dt
            slot.learned.add(between((device.at, device.turn), joint), worth)
            if slot.learned.worth >= ENOUGH:
                slot.mount = within(slot.learned.pose(), MOST[slot.index])


def _joints(body: Body, solution: Solution) -> tuple[Pose, list[Vec]]:
    """The pelvis, and the places of both ankles."""
    pelvis = solution.pelvis, solution.rotations[PELVIS]
    ankles = []
    for leg in zip(HIPS, KNEES, ANKLES, strict=True):
        at, turn = pelvis
        for joint in leg:
            at = add(at, rotate(turn, body.offsets[joint]))
            turn = mul(turn, solution.rotations[joint])
        ankles.append(at)
    return pelvis, ankles


assert len(JOINTS) == len(TRACKERS)
