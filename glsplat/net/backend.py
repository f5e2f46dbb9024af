"""What the server needs of a renderer. The network code never sees OpenGL, only this."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.net.messages import RenderRequest
from glsplat.skinning.pose import Pose

__all__ = ["Backend", "PoseSolver", "Rendered", "Solved"]


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """One rendered request. The server reads ``images`` while the next frame is drawn, until it calls ``done``.

    Outside ``covered`` the images are zero: transparent black.
    """

    images: NDArray[np.uint8]  # [V, H, W, 4] RGBA, rows top-down, one a camera of the request
    timings: Mapping[str, float] = field(default_factory=dict)  # ms by stage (skin, sort, ...)
    driver: str = ""
    covered: tuple[int, int, int, int] | None = None  # x, y, width, height: all outside is background; None: unknown
    done: Callable[[], None] | None = None


class Backend(Protocol):
    """A renderer. The server calls all three on one thread of its own, ``open`` first and ``close`` last."""

    def open(self) -> str:
        """Make the context and load the scene; returns the driver string. May raise GlsplatError."""
        ...

    def render(self, request: RenderRequest) -> Rendered:
        """Draw ``request.cameras`` at ``request.pose`` (None: the rest pose).

        Raises ContextError if the context is lost: the server then calls ``close`` and ``open`` again. Any other
        error costs this picture only.
        """
        ...

    def close(self) -> None:
        """Release everything; called once more after an ``open`` that failed."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """What a request with tracking comes to in the avatar's space."""

    pose: Pose
    cameras: tuple[Camera, ...]  # of the request, moved from the user's room to the avatar's space
    notes: tuple[str, ...] = ()  # what was out of the ordinary ("left_lost", ...), told to the client


class PoseSolver(Protocol):
    """Raw tracking to a pose, one instance a session because it filters over time (inverse kinematics)."""

    def solve(self, request: RenderRequest, now: float) -> Solved:
        """Solve ``request.tracking`` at its ``t`` (ms), or at ``now`` (ms), when it arrived, where it has none.

        Called for every request of the session in order, also for those that are never drawn; one call at a time, on
        a thread that is neither the event loop's nor the renderer's. May raise PoseError.
        """
        ...
