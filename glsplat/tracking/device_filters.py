"""Filter and predict tracked devices: the stage of a Tracker between the judged input and the solver."""

from __future__ import annotations

from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.filters import OneEuro, PositionFilter, RotationFilter
from glsplat.tracking.judge import Moment
from glsplat.tracking.solve.quat import JointPose, Vec
from glsplat.tracking.solve.solution import Targets

__all__ = ["DeviceFilter", "HeadAndHandFilters"]


class DeviceFilter:
    """Filters of one tracked pose."""

    def __init__(self, position: OneEuro, rotation: OneEuro, max_speed: float, max_turn_speed: float) -> None:
        self.position = PositionFilter(position, max_speed)
        self.rotation = RotationFilter(rotation, max_turn_speed)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next pose passes unchanged."""
        self.position.reset()
        self.rotation.reset()
        self.pose: JointPose | None = None  # as filtered last

    def update(self, pose: JointPose, dt: float) -> JointPose:
        """Return the filtered pose ``dt`` seconds after the last one."""
        self.pose = self.position.update(pose[0], dt), self.rotation.update(pose[1], dt)
        return self.pose

    def ahead(self, seconds: float, config: TrackerConfig) -> JointPose:
        """Return the last pose extrapolated by ``seconds``, within the bounds of ``config``."""
        return (
            self.position.ahead(seconds, config.predicted_metres),
            self.rotation.ahead(seconds, config.predicted_radians),
        )


class HeadAndHandFilters:
    """The stage of a Tracker that filters and predicts head and hands."""

    def __init__(self, config: TrackerConfig, head_only: bool) -> None:
        self.config, self.head_only = config, head_only
        self.head: DeviceFilter = DeviceFilter(
            config.head_position, config.head_rotation, config.head_speed, config.turn_speed
        )
        self.hands: tuple[DeviceFilter, ...] = tuple(
            [
                DeviceFilter(config.hand_position, config.hand_rotation, config.hand_speed, config.turn_speed)
                for _ in range(2)
            ]
        )

    def reset(self) -> None:
        """Forget the past."""
        for device in (self.head, *self.hands):
            device.reset()

    @property
    def eye(self) -> Vec:
        """Position between the eyes as filtered, without prediction."""
        assert self.head.pose is not None
        return self.head.pose[0]

    def update(self, moment: Moment, prediction: float, flags: list[str]) -> Targets:
        """Return the solver's targets ``prediction`` seconds ahead; a lost head stays where it is."""
        if moment.head is not None:
            self.head.update(moment.head, moment.dt)
        assert self.head.pose is not None
        predicted = prediction > 0 and moment.head is not None
        targets = Targets(*(self.head.ahead(prediction, self.config) if predicted else self.head.pose))
        for side, (device, hand) in enumerate(zip(self.hands, moment.hands, strict=True)):
            if hand is None:
                if not self.head_only:
                    flags.append("right_lost" if side else "left_lost")
                device.reset()
                continue
            position, rotation = device.update(hand, moment.dt)
            if prediction > 0:
                position, rotation = device.ahead(prediction, self.config)
            if side:
                targets.right, targets.right_hand = position, rotation
            else:
                targets.left, targets.left_hand = position, rotation
        return targets
