"""TrackerConfig: filters and tolerances of a Tracker."""

from __future__ import annotations

from dataclasses import dataclass

from glsplat.errors import PoseError
from glsplat.tracking.filters import OneEuro

__all__ = ["TrackerConfig"]

HEAD_POSITION, HEAD_ROTATION = OneEuro(1.2, 40.0, 0.5), OneEuro(1.2, 8.0, 1.2)
HAND_POSITION, HAND_ROTATION = OneEuro(1.0, 40.0, 0.5), OneEuro(1.0, 6.0, 1.2)
"""Filters that stop sway; at 1 m/s their lag is 4 ms, and they are never more than 9 mm behind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerConfig:
    """Filters and tolerances. The lags these filters add are in docs/tracking.md."""

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
    stretch: float = 0.25  # limit of the length that is added to an arm, as a part of it, where a hand is out of reach

    def __post_init__(self) -> None:
        if not 0 <= self.prediction <= 0.1:
            raise PoseError(f"prediction needs 0 to 0.1 seconds, not {self.prediction:g}")
        if not 0 <= self.stretch <= 1:
            raise PoseError(f"stretch needs 0 to 1 of an arm's length, not {self.stretch:g}")

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
