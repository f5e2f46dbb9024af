"""What the server needs of a renderer. The network code never sees OpenGL, only this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from glsplat.net.messages import RenderRequest
from glsplat.skinning.pose import Pose

__all__ = ["Backend", "PoseSolver", "Rendered"]


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """One rendered request. The server reads ``images`` while the next frame is drawn: hand over, do not reuse."""

    images: NDArray[np.uint8]  # [V, H, W, 4] RGBA, rows top-down, one a camera of the request
    timings: Mapping[str, float] = field(default_factory=dict)  # ms by stage (skin, sort, ...)
    driver: str = ""


class Backend(Protocol):
    """A renderer. The server calls all three on one thread of its own, ``open`` first and ``close`` last."""

    def open(self) -> str:
        """Make the context and load the scene; returns the driver string. May raise GlsplatError."""
        ...

    def render(self, request: RenderRequest) -> Rendered:
        """Draw ``request.cameras`` at ``request.pose`` (None: the rest pose)."""
        ...

    def close(self) -> None:
        """Release everything."""
        ...


class PoseSolver(Protocol):
    """Raw tracking to a pose, one instance a session because it filters over time (inverse kinematics)."""

    def __call__(self, tracking: Mapping[str, Any], t: float) -> Pose:
        """``tracking`` as it came in the request, ``t`` the client's time in ms. May raise PoseError."""
        ...
