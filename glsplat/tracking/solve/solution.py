"""What a solver takes and gives, the protocol that a learned model can fill, and how parts become a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from glsplat.tracking.solve.arms import Arm, ArmPose
from glsplat.tracking.solve.body import (
    ANKLES,
    COLLARS,
    ELBOWS,
    HEAD,
    HIPS,
    KNEES,
    NECK,
    PELVIS,
    SHOULDERS,
    SPINE1,
    SPINE2,
    SPINE3,
    WRISTS,
)
from glsplat.tracking.solve.hands import Hands
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, add, inverse_mul, mul, rotate
from glsplat.tracking.solve.spine import Torso
from glsplat.tracking.solve.stepping.foot import Foot
from glsplat.tracking.solve.stepping.leg import Leg

__all__ = ["Limb", "Solution", "Solver", "Targets", "assembled", "reaching"]

Limb = tuple[Quat, Quat, Quat]
"""World rotation of the thigh, local rotation of the knee, world rotation of the foot."""

RESTING = 1e-3  # metres a planted foot may still be above the floor


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
    feet: tuple[tuple[Vec, Quat] | None, tuple[Vec, Quat] | None] = (None, None)  # the ankle's place, the foot's turn
    knees: tuple[Vec | None, Vec | None] = (None, None)  # places, where their feet are tracked too


@dataclass(slots=True)
class Solution:
    """Local rotations of the 22 body joints, the pelvis' place, and what could not be met."""

    rotations: list[Quat]
    pelvis: Vec
    reach: tuple[float, float] = (0.0, 0.0)  # metres the left and right wrist miss their targets by
    head_off: float = 0.0  # radians the head had to give up
    planted: tuple[bool, bool] = (True, True)
    airborne: bool = False
    notes: list[str] = field(default_factory=list)
    feet: tuple[Vec | None, Vec | None] = (None, None)  # places of the foot joints, where they are known exactly
    expected_error: tuple[float, ...] = ()  # metres each of the 22 joints is probably off by; empty: not said


class Solver(Protocol):
    """What ``Tracker`` calls. Bring another one to plug in a learned model."""

    def reset(self) -> None:
        """A teleport or a new user: forget the past."""

    def solve(self, targets: Targets, dt: float) -> Solution:
        """The body of this moment, ``dt`` (0 < dt <= 0.1 s) after the last one. Must be deterministic."""


def reaching(arms: Sequence[Arm], hands: Hands, targets: Targets, torso: Torso, dt: float) -> list[ArmPose]:
    """Both arms towards the hands, tracked or remembered."""
    seen = ((targets.left, targets.left_hand), (targets.right, targets.right_hand))
    return [
        arm.solve(torso.spine3, torso.spine3_at, *hands.reach_for(arm.index, at, hand, torso, dt), dt)
        for arm, (at, hand) in zip(arms, seen, strict=True)
    ]


def assembled(
    torso: Torso,
    limbs: Sequence[Limb],  # left and right
    arms: Sequence[ArmPose],
    legs: Sequence[Leg],
    feet: Sequence[Foot],  # strained where a joint's limit moves them
    sole: float,
    air: float,  # metres both feet are off the ground
    notes: list[str],
) -> Solution:
    """The body: local rotations inside the joints' limits."""
    out = [IDENTITY] * 22
    out[PELVIS] = torso.pelvis
    out[SPINE1] = out[SPINE2] = out[SPINE3] = torso.third
    out[NECK] = inverse_mul(torso.spine3, torso.neck)
    out[HEAD] = inverse_mul(torso.neck, torso.head)
    places: list[Vec | None] = [None, None]
    for i in (0, 1):
        thigh, knee, foot = limbs[i]
        free = inverse_mul(torso.pelvis, thigh)
        out[HIPS[i]] = hip = clamp_joint(HIPS[i], free)
        bound = hip is not free
        if bound:
            thigh = mul(torso.pelvis, hip)
            leg = legs[i]
            knee = clamp_joint(KNEES[i], leg.settle(add(torso.pelvis_at, rotate(torso.pelvis, leg.hip)), thigh, knee))
        out[KNEES[i]] = knee
        free = inverse_mul(mul(thigh, knee), foot)
        out[ANKLES[i]] = ankle = clamp_joint(ANKLES[i], free)
        if bound or ankle is not free:  # a joint's limit moves the foot: it has to step
            feet[i].strained = True
        elif not feet[i].strained:
            places[i] = legs[i].ball
        arm = arms[i]
        out[COLLARS[i]], out[SHOULDERS[i]], out[ELBOWS[i]], out[WRISTS[i]] = (
            arm.collar,
            arm.shoulder,
            arm.elbow,
            arm.wrist,
        )
    left, right = [
        foot.planted and known is not None and abs(foot.y.at - sole) < RESTING
        for foot, known in zip(feet, places, strict=True)
    ]
    return Solution(
        out,
        torso.pelvis_at,
        (arms[0].miss, arms[1].miss),
        torso.head_off,
        (left, right),
        air > 0.01,
        notes,
        (places[0], places[1]),
    )
