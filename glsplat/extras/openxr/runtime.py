"""Values exchanged by a session and an OpenXR runtime: poses, fields of view, states, layers.

``openxr.runtime`` fills them by pyopenxr. Sections are those of the OpenXR 1.1 specification. Poses are
``Transform``s in the session's space: y up, metres, the floor at y = 0; times are its nanoseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Literal

from glsplat.extras.openxr.eyes import DepthRange
from glsplat.tracking.sample import Transform

if TYPE_CHECKING:
    from glsplat.extras.openxr.openxr.calls import Swapchain

Blend = Literal["opaque", "additive", "alpha"]
"""XrEnvironmentBlendMode; alpha also stands for XR_FB_passthrough."""

Hands = tuple[tuple[Transform, ...] | None, tuple[Transform, ...] | None]
"""Left and right: the 26 joints of XR_HAND_JOINT_SET_DEFAULT_EXT, palm first; None: not tracked."""


class State(IntEnum):
    """XrSessionState (9.3), with its numbers."""

    UNKNOWN = 0
    IDLE = 1
    READY = 2
    SYNCHRONIZED = 3
    VISIBLE = 4
    FOCUSED = 5
    STOPPING = 6
    LOSS_PENDING = 7
    EXITING = 8


@dataclass(frozen=True, slots=True)
class Fov:
    """XrFovf: angles from the line of sight, radians; left and down are negative, and all may differ."""

    left: float
    right: float
    up: float
    down: float


@dataclass(frozen=True, slots=True)
class ViewPose:
    """XrView: pose and field of view of an eye; submitted with its picture."""

    pose: Transform
    fov: Fov


@dataclass(frozen=True, slots=True)
class FrameTiming:
    """XrFrameState of the frame that begins."""

    display_time: int  # nanoseconds
    period: int
    should_render: bool


@dataclass(frozen=True, slots=True)
class Event:
    """An event of the runtime: a new ``state``, a loss, or a new origin of the user's space from ``time`` on."""

    kind: Literal["state", "recentred", "lost"]
    state: State = State.UNKNOWN
    time: int = 0


@dataclass(frozen=True, slots=True)
class Devices:
    """Tracked devices of the user at one time, unchecked; None if the runtime has none, or lost it."""

    head: Transform | None = None
    grips: tuple[Transform | None, Transform | None] = (None, None)
    squeezes: tuple[float, float] = (0.0, 0.0)
    triggers: tuple[float, float] = (0.0, 0.0)
    hands: Hands = (None, None)
    body: Sequence[Transform | None] | None = None  # by XrBodyJointFB
    face: Sequence[float] | None = None  # by XrFaceExpression2FB
    eyes_htc: Sequence[float] | None = None  # by XrEyeExpressionHTC
    lips_htc: Sequence[float] | None = None  # by XrLipExpressionHTC
    gaze: Transform | None = None  # of XR_EXT_eye_gaze_interaction, -z ahead
    next_view: bool = False  # whether the button A or X is down


@dataclass(frozen=True, slots=True)
class Projection:
    """A projection layer (11.4): the newest picture in ``colour``, and its poses."""

    views: Sequence[ViewPose]  # left first
    colour: Sequence[Swapchain]  # one of two layers, or one for each eye
    depth: Sequence[Swapchain] = ()  # likewise, or none
    depth_range: DepthRange | None = None
    transparent: bool = False  # blend by alpha; colours are premultiplied
