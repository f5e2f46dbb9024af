"""TrackerConfig: filters and tolerances of a Tracker; docs/tracking.md has the lags that the filters add."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi

from glsplat.errors import PoseError


@dataclass(frozen=True, slots=True)
class OneEuro:
    """Settings of a One Euro filter (filters.py)."""

    min_cutoff: float  # Hz at rest; 0 switches the filter off
    beta: float  # Hz for each m/s (positions) or rad/s (rotations)
    knee: float = 0.0  # m/s or rad/s below which the cutoff grows with the square of the speed: sway is not motion yet
    derivative_cutoff: float = 4.0  # Hz, smoothing of the speed itself

    def cutoff(self, speed: float) -> float:
        """Return the cutoff in Hz at this speed."""
        return self.min_cutoff + self.beta * speed * (1.0 if speed >= self.knee else speed / self.knee)

    def share(self, speed: float, dt: float) -> float:
        """Return the fraction of the way to its input that each of the two low passes goes in dt seconds."""
        return 1.0 if self.min_cutoff <= 0 else 1 - exp(-4 * pi * self.cutoff(speed) * dt)

    def lag(self, speed: float) -> float:
        """Return the seconds by which the filter delays a motion of this speed (m/s or rad/s)."""
        return 0.0 if self.min_cutoff <= 0 else 1 / (2 * pi * self.cutoff(speed))


HEAD_POSITION, HEAD_ROTATION = OneEuro(1.2, 40.0, 0.5), OneEuro(1.2, 8.0, 1.2)
HAND_POSITION, HAND_ROTATION = OneEuro(1.0, 40.0, 0.5), OneEuro(1.0, 6.0, 1.2)
"""Filters that stop sway; at 1 m/s their lag is 4 ms, and they are never more than 9 mm behind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerConfig:
    """Filters and tolerances of a Tracker."""

    head_position: OneEuro = HEAD_POSITION
    head_rotation: OneEuro = HEAD_ROTATION
    hand_position: OneEuro = HAND_POSITION
    hand_rotation: OneEuro = HAND_ROTATION
    body_tracker_position: OneEuro = HAND_POSITION  # waist and feet
    body_tracker_rotation: OneEuro = HAND_ROTATION
    finger_smoothing: float = 0.02  # seconds
    prediction: float = 0.0  # seconds to extrapolate head and hands to the time of display; at most 0.1
    predicted_metres: float = 0.10  # limits of the extrapolation
    predicted_radians: float = 0.35
    head_speed: float = 12.0  # m/s; a faster head is followed at this speed
    hand_speed: float = 20.0
    turn_speed: float = 50.0  # rad/s
    teleport: float = 0.7  # metres the head may jump in a sample (beyond 8 m/s); more is a teleport
    gap: float = 0.5  # seconds without samples after which the body starts anew
    joint_speed: float = 45.0  # rad/s of any joint of the output
    root_speed: float = 14.0  # m/s of the output's pelvis
    foot_speed: float = 10.0  # m/s of the output's feet, over the pelvis' own
    arm_scaling: float = 0.25  # limit of the length that is added to an arm, as a part of it, for a hand out of reach

    def __post_init__(self) -> None:
        if not 0 <= self.prediction <= 0.1:
            raise PoseError(f"prediction needs 0 to 0.1 seconds, not {self.prediction:g}")
        if not 0 <= self.arm_scaling <= 1:
            raise PoseError(f"arm_scaling needs 0 to 1 of an arm's length, not {self.arm_scaling:g}")

    @classmethod
    def raw(cls, prediction: float = 0.0) -> TrackerConfig:
        """Return settings without filters, for recordings without noise."""
        off = OneEuro(0.0, 0.0)
        return cls(
            head_position=off,
            head_rotation=off,
            hand_position=off,
            hand_rotation=off,
            body_tracker_position=off,
            body_tracker_rotation=off,
            finger_smoothing=0.0,
            prediction=prediction,
        )
