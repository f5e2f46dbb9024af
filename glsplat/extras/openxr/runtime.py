"""What a session asks of an OpenXR runtime, in plain values: poses, fields of view, states, images by GL names.

``openxr.openxr`` answers by pyopenxr; tests have a runtime of their own. Sections are those of the OpenXR 1.1
specification. Poses are ``Transform``s in the session's space: y up, metres, the floor at y = 0; times are its
nanoseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Protocol

from glsplat.extras.openxr.eyes import DepthRange
from glsplat.tracking.sample import Transform

Blend = Literal["opaque", "additive", "alpha"]
"""XrEnvironmentBlendMode; alpha also where XR_FB_passthrough takes its place."""


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
    """XrFovf: angles in radians from the line of sight; left and down are negative, and any of them may differ."""

    left: float
    right: float
    up: float
    down: float


@dataclass(frozen=True, slots=True)
class ViewPose:
    """XrView: where an eye is and what it sees. What a picture was drawn for is given back with it."""

    pose: Transform
    fov: Fov


@dataclass(frozen=True, slots=True)
class FrameTiming:
    """XrFrameState: what xrWaitFrame says of the frame that begins."""

    display_time: int  # nanoseconds
    period: int
    should_render: bool


@dataclass(frozen=True, slots=True)
class Event:
    """Something that the runtime tells: a ``state``, or that the user's space is another from ``time`` on."""

    kind: Literal["state", "recentred", "lost"]
    state: State = State.UNKNOWN
    time: int = 0


Hands = tuple[tuple[Transform, ...] | None, tuple[Transform, ...] | None]
"""Left and right: the 26 joints of XR_HAND_JOINT_SET_DEFAULT_EXT, palm first; None: not tracked."""


@dataclass(frozen=True, slots=True)
class Devices:
    """What is known of the user at one time. What the runtime lacks, or loses, is None; numbers as they came."""

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
    next_view: bool = False  # the button A or X is down


class SwapchainImages(Protocol):
    """One XrSwapchain (11.3): an image is acquired, drawn into, released, in that order."""

    @property
    def size(self) -> tuple[int, int]:
        """Width, height."""
        ...

    @property
    def layers(self) -> int:
        """Of each image; 1: a plain texture."""
        ...

    @property
    def textures(self) -> Sequence[int]:
        """GL names, an image each."""
        ...

    def acquire(self) -> int:
        """The index of the image to draw into now, once the runtime no longer reads it."""
        ...

    def release(self) -> None:
        """It is drawn."""
        ...

    def close(self) -> None:
        """Destroy it."""
        ...


@dataclass(frozen=True, slots=True)
class Projection:
    """A projection layer (11.4): what was drawn last into ``colour``, and the poses that it was drawn for."""

    views: Sequence[ViewPose]  # left first
    colour: Sequence[SwapchainImages]  # one of two layers, or one an eye
    depth: Sequence[SwapchainImages] = ()  # likewise, or none
    depth_range: DepthRange | None = None
    transparent: bool = False  # what is behind shows by alpha; colours are premultiplied


class Runtime(Protocol):
    """One instance with its system and session. ContextLostError from any call: it is gone, only ``close`` is left."""

    @property
    def name(self) -> str:
        """What it calls itself."""
        ...

    @property
    def extensions(self) -> frozenset[str]:
        """Those that are on."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Pixels that it recommends for an eye."""
        ...

    @property
    def max_size(self) -> tuple[int, int]:
        """Pixels of an image, at most."""
        ...

    @property
    def blends(self) -> Sequence[Blend]:
        """What it can do; what it prefers comes first."""
        ...

    @property
    def formats(self) -> Sequence[int]:
        """GL's internal formats of its images, likewise."""
        ...

    def poll(self) -> Event | None:
        """The next event, None if there is none."""
        ...

    def begin(self) -> None:
        """xrBeginSession, in the state READY."""
        ...

    def end(self) -> None:
        """xrEndSession, in the state STOPPING."""
        ...

    def request_exit(self) -> None:
        """Ask for the way out: STOPPING comes."""
        ...

    def wait_frame(self) -> FrameTiming:
        """xrWaitFrame: returns when the next frame is to be begun."""
        ...

    def begin_frame(self) -> None:
        """xrBeginFrame."""
        ...

    def end_frame(self, display_time: int, projection: Projection | None, blend: Blend) -> None:
        """xrEndFrame: show this, or nothing."""
        ...

    def views(self, time: int) -> tuple[ViewPose, ViewPose] | None:
        """xrLocateViews for that time; None while the head's pose is not known."""
        ...

    def devices(self, time: int, active: bool) -> Devices:
        """What is tracked, for that time; actions are read while ``active`` (FOCUSED)."""
        ...

    def move(self, place: Transform) -> None:
        """Put the session's space there: a pose in the space as it was at the beginning."""
        ...

    def swapchain(self, internal_format: int, size: tuple[int, int], layers: int, depth: bool) -> SwapchainImages:
        """Make one. GlsplatError if it cannot have so many layers."""
        ...

    def close(self) -> None:
        """Destroy everything; may be called in any state, and when the runtime is gone."""
        ...
