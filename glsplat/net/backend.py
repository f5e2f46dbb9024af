"""The interface between the server and a renderer or a tracking solver; no OpenGL."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError, PoseError
from glsplat.net.codec.encoded import DepthGrid, Encoded
from glsplat.net.messages import Request
from glsplat.net.room_view import RoomView
from glsplat.net.wire_schema import DEFAULT_OPTIONS, PictureOptions
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

if TYPE_CHECKING:
    import asyncio

    from glsplat.renderer.resolve import ResolveStep


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RenderJob:
    """A picture to draw; made when it is due, and never changed."""

    cameras: tuple[Camera, ...]  # one or two, left first
    pose: Pose | None = None  # None: the rest pose
    to_user: NDArray[np.float64] | None = None  # [4, 4] user's space from scene; None: they are the same
    frame_id: int | None = None  # of its request
    options: PictureOptions = DEFAULT_OPTIONS
    avatar: str = ""  # name of an offered one; "": the first one, or the scene
    room: RoomView | None = None  # all people of a room, instead of ``avatar`` alone
    viewer: int = 0  # number of the client; a renderer keeps state for each viewer
    detail: float = 0.0  # added to RenderConfig.lod_bias: below 0 for coarser levels
    notice: str = ""  # written into the picture
    mark: ResolveStep | None = None  # the watermark of the session
    others: float = 1.0  # factor on the cost limit of a room's other people (scene_renderer.others_share); 0 hides them


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """A drawn picture. ``images`` stay valid while the next one is drawn, until ``done`` is called.

    Outside ``covered`` the images are zero: transparent black. Where a worker encodes (``encoded``), they are empty.
    """

    images: NDArray[np.uint8]  # [V, H, W, 4] RGBA, rows top-down, one for each camera of the job
    timings: Mapping[str, float] = field(default_factory=dict)  # ms by stage (skin, sort, ...)
    covered: tuple[int, int, int, int] | None = None  # x, y, width, height of all but the background; None: unknown
    done: Callable[[], None] | None = None
    levels: tuple[int, ...] = ()  # levels of detail that were drawn, one for each item of splats; 0 is the finest
    coarsest: bool = True  # there are no coarser levels
    posed: int = 0  # people who were skinned for this picture
    places: dict[str, list[float]] = field(default_factory=dict)
    """Positions of the one avatar, if requested, metres in the cameras' world: "box" (lowest x, y, z, then highest) and
    "feet" (left ankle, left ball, right ankle, right ball), if it has such joints."""
    depth: tuple[DepthGrid, ...] = ()  # one for each image, if requested
    encoded: asyncio.Future[Encoded] | None = None  # by the worker; may raise WorkerLostError


@runtime_checkable
class Backend(Protocol):
    """A renderer. All methods are called on one thread, ``open`` first and ``close`` last."""

    def open(self) -> str:
        """Make the context, load the scene and draw it once; return the driver string.

        Raises GlsplatError. After a lost context that ends the server; no request of a client does.
        """

    def render(self, job: RenderJob) -> Rendered:
        """Draw a picture.

        Raises ContextLostError if the context is lost: the server then calls ``close`` and ``open``. Raises BudgetError
        if the picture is too costly. Any other error fails this picture only.
        """

    def close(self) -> None:
        """Release everything; also called after an ``open`` that failed."""


@dataclass(frozen=True, slots=True, eq=False)
class Submitted:
    """A picture that the GPU still draws. Both functions are called on the backend's thread."""

    ready: Callable[[float], bool]  # waits up to so many seconds; whether ``collect`` returns without a wait
    collect: Callable[[], Rendered]  # called once; raises the errors of ``Backend.render``


@runtime_checkable
class Overlapping(Protocol):
    """A backend that can begin a picture while the GPU still draws the one before."""

    def submit(self, job: RenderJob) -> Rendered | Submitted:
        """Draw a picture as ``Backend.render`` does, without waiting for the GPU. Collect all pictures in order."""


@runtime_checkable
class Interruptible(Protocol):
    """A backend that can abandon a picture."""

    abandoned: Callable[[], bool]
    """Set by the worker for each picture; returns True once it is not needed, and drawing may raise BudgetError."""


@runtime_checkable
class MemoryTarget(Protocol):
    """A backend that can draw into given memory, which saves a copy."""

    out: NDArray[np.uint8] | None
    """Set before ``render``: uninitialised, contiguous memory for its images [V, H, W, 4]; None: its own memory."""


POLL_S = 5e-4
"""Seconds of a wait for the GPU, after which a worker looks for another order."""


def begin(backend: Backend, job: RenderJob, abandoned: Callable[[], bool]) -> Rendered | Submitted:
    """Begin a picture, or draw it where the backend cannot overlap pictures; ``abandoned`` is that of Interruptible."""
    if isinstance(backend, Interruptible):
        backend.abandoned = abandoned
    return backend.submit(job) if isinstance(backend, Overlapping) else backend.render(job)


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The solution of a tracking sample."""

    pose: Pose
    notes: tuple[str, ...] = ()  # problems of the sample ("left_lost", ...), reported to the client
    scale: float = 1.0  # user metres = avatar metres * scale
    floor: float = 0.0  # y of the user's floor in metres; 0 in the avatar's space

    @property
    def to_user(self) -> NDArray[np.float64]:
        """[4, 4] user's space from avatar's. Raises PoseError for an impossible scale or floor."""
        try:
            return similarity((0.0, self.floor, 0.0), scale=self.scale)
        except GlsplatError as error:
            raise PoseError(f"a person cannot be placed at this scale and floor: {error}") from None

    def seen(self, camera: Camera) -> Camera:
        """Return a camera of the user's space in the avatar's."""
        return camera.in_space(self.to_user)


@dataclass(frozen=True, slots=True, eq=False)
class WebFile:
    """A file from which a browser draws an avatar."""

    data: bytes
    first: int  # bytes that suffice for a first picture


class PoseSolver(Protocol):
    """Solves tracking to poses for one session; it filters over time."""

    def solve(self, request: Request, now: float) -> Solved:
        """Solve ``request.tracking`` at its time, or at its arrival ``now`` (seconds) where it has none.

        Called for every request of the session in order, one at a time, also for requests that are never drawn, on a
        thread that is neither the event loop's nor the renderer's. May raise PoseError.
        """


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AvatarInfo:
    """An avatar, or a scene, that clients may choose."""

    name: str
    skeleton: Skeleton | None = None  # of its poses; None: the 55 joints of SMPL-X
    solver: Callable[[float | None, float | None], PoseSolver] | None = None
    """Makes a client's solver from its user's height and arm span (metres, None: unknown); None: no tracking."""
    height: float | None = None  # metres: the stature of a user who needs no scaling; None: a scene, not one avatar
    parts: frozenset[str] = frozenset()  # parts that requests may hide
    untracked: str = ""  # why tracking is not solved, for the client that sends it
    still: str = ""  # why poses have no effect; "" if they take effect or are refused
    made: bool = False  # made of a client's photograph: clients may delete it
    title: str = ""  # the name that people see; "": ``name``
    file: Callable[[], WebFile] | None = None  # makes its file for browsers; None: a browser cannot draw it
