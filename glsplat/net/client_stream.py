"""What goes through a render loop: one client's channel, and its frames from the renderer to the socket."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.net.backend import AvatarInfo, RenderJob, Solved
from glsplat.net.codec.body import PoseHistory, Poses
from glsplat.net.codec.depth import DepthGrid
from glsplat.net.codec.encode import Encoded
from glsplat.net.fields import PictureOptions
from glsplat.net.guard.limits import CpuShare
from glsplat.net.messages import Request, eye_fields
from glsplat.net.pace.adaptive_quality import FULL, Detail
from glsplat.net.pose_queue import PoseQueue, SolutionFuture
from glsplat.net.session import Session

if TYPE_CHECKING:
    from glsplat.net.room_view import RoomView

__all__ = ["ANYTHING", "ClientStream", "DatagramTransport", "Frame", "FrameObserver", "RoomMember", "VideoStream"]

ANYTHING = AvatarInfo(name="")


class FrameObserver(Protocol):
    """What a feature of the server hears of one client. Its methods return at once."""

    def request_received(self, request: Request) -> None:
        """A request was accepted. Called on the event loop."""
        ...

    def picture_drawn(self, images: NDArray[np.uint8]) -> None:
        """Pictures [V, H, W, 4] were drawn in this process; they may be changed in place. Called while drawing."""
        ...

    def reply_sent(self, messages: Sequence[bytes]) -> None:
        """The socket took the messages of a reply. Called on the event loop."""
        ...


class VideoStream(Protocol):
    """Codes the pictures of one client as video (extras/far_links). Called on one thread at a time."""

    def encode(
        self,
        images: NDArray[np.uint8],
        codecs: Sequence[str],
        quality: int = 80,
        covered: tuple[int, int, int, int] | None = None,
        alpha: bool | str = False,
        key: bool = False,
    ) -> Encoded | None:
        """Return the next picture of ``images`` [V, H, W, 4]; None: it is to be a JPEG."""
        ...


class RoomMember(Protocol):
    """A client's person in a room, as drawing and answering see it. May be used by several threads."""

    @property
    def resume(self) -> str:
        """The token by which the person comes back on another connection."""
        ...

    def meeting(self, request: Request) -> Request:
        """Return a request with tracking and with the faces of the others, for the solver."""
        ...

    def received(self, request: Request, at: float) -> None:
        """A request came ``at`` seconds; its tracking is solved elsewhere, perhaps much later."""
        ...

    def options(self, request: Request) -> PictureOptions:
        """Return the options of the request's picture, in the room's space."""
        ...

    def look(
        self, request: Request, cameras: Sequence[Camera], solved: Solved | None, at: float, now: float
    ) -> tuple[tuple[Camera, ...], RoomView]:
        """Return the ``cameras`` of a request that came ``at`` seconds, in the room's space, and everybody in it."""
        ...

    def poses(self, history: PoseHistory, sha256: Callable[[str], bytes | None], now: float) -> Poses:
        """Return the poses that changed since the client was last sent any, by its ``history``."""
        ...

    def posed(self, count: int) -> None:
        """Count people who were skinned anew for a picture."""
        ...

    def fair_cost(self, seconds: float) -> float:
        """Return the seconds that a picture counts for its viewer: those of a mean picture of this room."""
        ...


class DatagramTransport(Protocol):
    """A second connection for the pictures of one client, beside its WebSocket."""

    def offer(self) -> dict[str, str] | None:
        """Return what the next reply says of it, where it is wanted and worth it."""
        ...

    def on_the_way(self, nbytes: int) -> int:
        """Return the bytes that a picture of ``nbytes`` takes of the link."""
        ...

    def send(self, frame_id: int, picture: bytes) -> bool:
        """Send a picture; False where it has to go over the WebSocket."""
        ...

    def ping(self, payload: bytes) -> bool:
        """Send a ping; False where it has to go over the WebSocket."""
        ...

    async def message(self) -> str:
        """Return the next message of the client."""
        ...

    def status(self) -> dict[str, float]:
        """Return its numbers for /stats."""
        ...

    def close(self) -> None:
        """The client has left."""
        ...


@dataclass(eq=False, slots=True)
class Frame:
    """One picture on its way from the renderer to the socket, and what the server notes of it."""

    channel: ClientStream  # whose it is
    request: Request
    arrived: float  # clock seconds
    times: dict[str, float]  # ms
    cameras: tuple[Camera, ...]  # those of the request, in the size that is drawn
    notice: str = ""  # what has to stand in it
    job: RenderJob | None = None  # what is drawn, once its pose is known
    encoded: Awaitable[Encoded] | None = None  # None: it could not be drawn
    error: tuple[str, str] = ("", "")  # code and message in that case
    notes: tuple[str, ...] | None = None  # of the tracking solver
    drawn: tuple[Camera, ...] | None = None  # the eyes in the avatar's space, where tracking was solved
    places: Mapping[str, list[float]] = field(default_factory=dict)
    """"box" and "feet" of the avatar in the client's room, where they were asked for."""
    depth: tuple[DepthGrid, ...] = ()  # of its eyes, in the client's metres, where it was asked for
    ends: str = ""  # why the connection ends after this answer and its address is held off, if it does
    detail: Detail = FULL  # less than was asked for, where a rate is held
    smaller: bool = False  # than the time for drawing it asks for
    levels: tuple[int, ...] = ()  # of detail that were drawn
    driver: str = ""  # what drew it
    solution: SolutionFuture | None = None  # of its tracking
    again: asyncio.Future[None] | None = None  # it is being drawn anew: done once it is
    moved: bool = False  # whoever had it cannot draw it, another may
    losses: int = 0  # of those who were drawing it
    alone: bool = False  # it went wrong, and is drawn anew without the others of its room
    poses: Poses | None = None  # what is sent instead of a picture

    @property
    def shows_others(self) -> bool:
        """Whether other people of a room are in what was drawn, or was to be drawn."""
        job = self.job
        if job is None or job.room is None or not job.others:
            return False
        return any(one.key != job.room.viewer and one.opacity > 0 for one in job.room.people)

    @property
    def options(self) -> PictureOptions:
        """How it is encoded: as it was asked for, or as the link takes it."""
        request, member, rung = self.request, self.channel.member, self.detail.rung
        asked = request.options if member is None else member.options(request)
        return asked if rung is None else replace(asked, quality=rung.quality, crop=rung.crop)

    def info(self, encoded: Encoded) -> dict[str, Any]:
        """The JSON object of the reply (docs/protocol.md, section 4)."""
        channel, request, first = self.channel, self.request, self.cameras[0]
        info: dict[str, Any] = {
            "t": request.t,
            "times": {name: round(ms, 3) for name, ms in self.times.items()},
            "size": (first.width, first.height),
            "eyes": [eye_fields(camera) for camera in self.cameras],
            "crop": encoded.boxes,
            "dropped": channel.session.counts.dropped,
            "driver": self.driver,
            "driven_by": channel.driver,
        }
        if self.notes is not None:
            info["tracking"] = self.notes
        drawn = None if self.drawn is None else [eye_fields(camera) for camera in self.drawn]
        if drawn is not None and drawn != info["eyes"]:
            info["drawn"] = drawn
        if channel.shown.still and request.pose is not None:
            info["still"] = channel.shown.still
        info |= self.places
        if self.depth:
            info["depth"] = DepthGrid.fields(self.depth)
        if any(self.levels) or self.detail != FULL:
            info["detail"] = self.detail.fields(self.levels)
        if encoded.video is not None:
            info["video"] = encoded.video
        if request.options.alpha == "straight":
            info["alpha"] = "straight"
        if channel.member is not None and self.job is not None and self.job.room is not None:
            info["room"] = self.job.room.fields() | {"resume": channel.member.resume}
        return info


@dataclass(eq=False, slots=True)
class ClientStream:
    """One client as the render loop sees it."""

    number: int
    session: Session
    solving: PoseQueue | None = None  # None: this server solves no tracking
    address: str = ""  # what has a fair share of the renderer's time
    shown: AvatarInfo = ANYTHING
    member: RoomMember | None = None  # in a room; None: sees what it is shown alone
    room: str = ""  # its name
    account: str = ""  # whose it is; "": the server has no accounts
    driver: str = ""  # name of who drives what is shown; "": nobody knows
    label: str = ""  # over the head of what is shown alone
    notice: Callable[[], str] = field(default=lambda: "")  # what has to stand in a picture drawn now
    share: CpuShare | None = None  # of the time for reading and solving; None: no limit
    frames: asyncio.Queue[Frame] = field(default_factory=asyncio.Queue)  # bounded by the session's window
    again: Frame | None = None  # one of those that were taken from ``frames``, to be drawn anew before any other
    cost: float = 0.0  # seconds a picture, lately; 0: none was drawn yet
    pose_history: PoseHistory = field(default_factory=PoseHistory)  # whom it was sent in poses, and how they stood
    observers: tuple[FrameObserver, ...] = ()  # of the server's features
    video: VideoStream | None = None  # what codes its pictures where it asks for video; None: this server has none
    coding: Future[Encoded] | None = None  # the newest picture of it: the next is coded after that
    way: DatagramTransport | None = None  # for its pictures; None: this server has none
    newest: Encoded | None = None  # what it was sent last, for the status page

    @property
    def place_key(self) -> str:
        """Clients with the same key are best drawn by one worker (workers/placement.py)."""
        return f"room:{self.room}" if self.room else f"avatar:{self.shown.name}"

    @property
    def untracked(self) -> str:
        """Why tracking is not solved, where it is not."""
        why = self.shown.untracked
        how = f" for what it shows: {why}" if why else ": send pose instead of tracking"
        return f"this server has no tracking solver{how}"

    def ready(self, solved: Callable[[], None], poses: bool = False) -> bool:
        """True while a request for a picture (or for ``poses``) can be answered without waiting for its tracking.

        Where none is solved yet, the newest is from now on, and ``solved`` is called (on any thread) once it is: under
        a stream of samples that are all newer, waiting for the newest would never end.
        """
        if self.again is not None:
            return not poses
        session, newest = self.session, self.session.newest
        if not session.ready():
            return False
        due = newest if session.kept is None or (newest is not None and self._solved(newest)) else session.kept
        if due is None or due.poses != poses:
            return False
        if self.solving is None or (newest is not None and self._solved(newest)):
            return True
        if session.kept is None:
            assert newest is not None
            session.keep()
            self.solving.begin(newest.frame_id, solved)
        return self._solved(session.kept)

    def take(self, now: float) -> tuple[Request, float, SolutionFuture | None]:
        """The newest request that is ready, the seconds it waited, and its solution."""
        newest = self.session.newest
        kept = self.solving is not None and (newest is None or not self._solved(newest))
        taken = self.session.next_request(now, kept)
        assert taken is not None
        request, waited = taken
        return request, waited, None if self.solving is None else self.solving.take(request.frame_id)

    def _solved(self, request: Request | None) -> bool:
        solving = self.solving
        return request is None or request.tracking is None or solving is None or solving.solved(request.frame_id)
