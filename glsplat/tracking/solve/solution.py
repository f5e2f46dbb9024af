"""What a solver takes and gives, and the protocol that a learned model can fill."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from glsplat.tracking.solve.quat import IDENTITY, JointPose, Quat, Vec


@dataclass(slots=True)
class Targets:
    """Filtered, calibrated targets in the avatar's metres, the ground at y = 0. Rotations are those of the joints."""

    eye: Vec  # between the eyes
    head: Quat
    left: Vec | None = None  # wrist joint
    left_hand: Quat = IDENTITY
    right: Vec | None = None
    right_hand: Quat = IDENTITY
    pelvis: Vec | None = None  # its joint, where a waist is tracked
    pelvis_turn: Quat = IDENTITY
    feet: tuple[JointPose | None, JointPose | None] = (None, None)  # the ankle's position, the foot's rotation
    knees: tuple[Vec | None, Vec | None] = (None, None)  # positions, where their feet are tracked too


@dataclass(slots=True)
class Solution:
    """Local rotations of the 22 body joints, the pelvis' position, and which targets could not be met."""

    rotations: list[Quat]
    pelvis: Vec
    reach: tuple[float, float] = (0.0, 0.0)  # metres the left and right wrist miss their targets by
    head_off: float = 0.0  # radians the head had to give up
    planted: tuple[bool, bool] = (True, True)
    airborne: bool = False
    notes: list[str] = field(default_factory=list)  # further flags
    feet: tuple[Vec | None, Vec | None] = (None, None)  # positions of the foot joints, where they are known exactly
    expected_error: tuple[float, ...] = ()  # metres each of the 22 joints is probably off by; empty: no estimate


class Solver(Protocol):
    """The interface that ``Tracker`` calls. Implement it to plug in a learned model."""

    def reset(self) -> None:
        """Forget the past: a teleport or a new user."""

    def solve(self, targets: Targets, dt: float) -> Solution:
        """Return the body ``dt`` seconds (0 < dt <= 0.1) after the last one. Must be deterministic."""
