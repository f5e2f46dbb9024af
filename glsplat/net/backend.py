"""What the server needs of a renderer. The network code never sees OpenGL, only this."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError, PoseError
from glsplat.net.codec.depth import DepthGrid
from glsplat.net.messages import Request
from glsplat.net.wire_schema import DEFAULT_OPTIONS, PictureOptions
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

if TYPE_CHECKING:
    import asyncio

    from glsplat.net.codec.encoded import Encoded
    from glsplat.net.room_view import RoomView
    from glsplat.renderer.resolve import ResolveStep

__all__ = [
    "AvatarInfo",
    "Backend",
    "Interruptible",
    "Placing",
    "PoseSolver",
    "RenderJob",
    "Rendered",
    "Solved",
    "WebFile",
]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RenderJob:
    """What a renderer needs of a request: made once, when its picture is due, and never changed."""

    cameras: tuple[Camera, ...]  # one or two, left first
    pose: Pose | None = None  # None: the rest pose
    place: NDArray[np.float64] | None = None  # [4, 4] from the scene to the user's space; None: they are the same
    frame_id: int | None = None  # of its request
    options: PictureOptions = DEFAULT_OPTIONS
    avatar: str = ""  # which of those the server offers; empty: its first, or the scene
    room: RoomView | None = None  # everybody in a room, instead of ``avatar`` alone
    viewer: int = 0  # who asks, for what a renderer keeps from picture to picture
    detail: float = 0.0  # added to RenderConfig.lod_bias: below 0 for coarser levels
    label: str = ""  # drawn near the head of the avatar
    notice: str = ""  # written into the picture
    mark: ResolveStep | None = None  # the watermark of the session
    others: float = 1.0  # of what others in a room may add to the picture (budget.others_share); 0: none is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """One picture that was drawn. ``images`` are read while the next one is drawn, until ``done`` is called.

    Outside ``covered`` the images are zero: transparent black. Where a worker encodes (``encoded``), they are empty.
    """

    images: NDArray[np.uint8]  # [V, H, W, 4] RGBA, rows top-down, one a camera of the job
    timings: Mapping[str, float] = field(default_factory=dict)  # ms by stage (skin, sort, ...)
    driver: str = ""
    covered: tuple[int, int, int, int] | None = None  # x, y, width, height: all outside is background; None: unknown
    done: Callable[[], None] | None = None
    levels: tuple[int, ...] = ()  # of detail that were drawn, one a thing of splats; 0 is the finest
    coarsest: bool = True  # there are no coarser ones
    posed: int = 0  # people who were skinned anew for it
    places: dict[str, list[float]] = field(default_factory=dict)
    """Where the one avatar is, if the job asks for it, metres in the cameras' world: "box" (x, y, z lowest, then
    highest), and where it touches the ground, if it has such joints, "feet" (left ankle, left ball, right ankle, right
    ball)."""
    depth: tuple[DepthGrid, ...] = ()  # one an image, if the job asks for it
    encoded: asyncio.Future[Encoded] | None = None  # by the worker; may raise WorkerLostError


@runtime_checkable
class Backend(Protocol):
    """A renderer. All three are called on one thread, ``open`` first and ``close`` last."""

    def open(self) -> str:
        """Make the context, load the scene and draw a plain picture of it; returns the driver string.

        May raise GlsplatError: after a lost context that, and nothing a client asks for, ends the server.
        """
        ...

    def render(self, job: RenderJob) -> Rendered:
        """Draw ``job.cameras`` at ``job.pose`` (None: the rest pose), of ``avatar`` without what ``options`` hide.

        Raises ContextLostError if the context is lost: the server then calls ``close`` and ``open`` again. BudgetError
        if the picture costs more than it may. Any other error costs this picture only.
        """
        ...

    def close(self) -> None:
        """Release everything; called once more after an ``open`` that failed."""
        ...


@runtime_checkable
class Interruptible(Protocol):
    """A backend that can leave a picture unfinished."""

    abandoned: Callable[[], bool]
    """Set from outside, and called now and then while a picture is drawn: returns True once it is not needed.

    ``render`` may then raise BudgetError.
    """


@runtime_checkable
class Placing(Protocol):
    """A backend that can draw to where its pictures are wanted, which saves a copy."""

    place: NDArray[np.uint8] | None
    """Set before ``render``: where its images [V, H, W, 4] go, contiguous, with anything in it; None: anywhere."""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """What a request with tracking comes to."""

    pose: Pose
    notes: tuple[str, ...] = ()  # what was out of the ordinary ("left_lost", ...), told to the client
    scale: float = 1.0  # user metres = avatar metres * scale
    floor: float = 0.0  # y of the user's floor in metres; 0 in the avatar's space

    @property
    def place(self) -> NDArray[np.float64]:
        """[4, 4] from the avatar's space to the user's. Raises PoseError where nobody can stand there."""
        try:
            return similarity((0.0, self.floor, 0.0), scale=self.scale)
        except GlsplatError as error:
            raise PoseError(f"nobody can stand at this scale and floor: {error}") from None

    def seen(self, camera: Camera) -> Camera:
        """Return a camera of the user's space in the avatar's."""
        viewmat = camera.viewmat.copy()
        viewmat[:3, 3] = -viewmat[:3, :3] @ ((camera.position - (0, self.floor, 0)) / self.scale)
        return replace(camera, viewmat=viewmat, near=camera.near / self.scale, far=camera.far / self.scale)


@dataclass(frozen=True, slots=True, eq=False)
class WebFile:
    """A file from which a browser draws an avatar, and how many bytes of it make a first picture."""

    data: bytes
    first: int


class PoseSolver(Protocol):
    """Raw tracking to a pose, one instance a session because it filters over time (inverse kinematics)."""

    def solve(self, request: Request, now: float) -> Solved:
        """Solve ``request.tracking`` at its time, or at ``now`` (seconds), when it arrived, where it has none.

        Called for every request of the session in order, also for those that are never drawn; one call at a time, on
        a thread that is neither the event loop's nor the renderer's. May raise PoseError.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AvatarInfo:
    """One of the things that clients may choose to see, as requests for it are read and answered."""

    name: str
    skeleton: Skeleton | None = None  # of its poses; None: the 55 joints of SMPL-X
    solver: Callable[[float | None, float | None], PoseSolver] | None = None
    """Makes a client's solver from its user's height and arm span (metres, None: not told); None: solves nothing."""
    height: float | None = None  # metres: the stature of a user who needs no scaling; None: no one avatar
    parts: frozenset[str] = frozenset()  # what of it can be left out
    untracked: str = ""  # why tracking is not solved, told to the client that sends it
    still: str = ""  # why poses do nothing, told with the picture; "" where they do something, or are refused
    made: bool = False  # of a photograph that a client sent: clients may delete it
    title: str = ""  # what its owner calls it, for people; "": its name
    file: Callable[[], WebFile] | None = None  # makes what a browser draws it from; None: nothing it could draw
