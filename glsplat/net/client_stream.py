"""ClientStream: one client's requests and answers in the render loop, and the stages from a request to a reply."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import PoseError
from glsplat.net.backend import AvatarInfo, Rendered, RenderJob, Solved
from glsplat.net.codec.body import PoseHistory, Poses
from glsplat.net.codec.encoded import DepthGrid, Encoded
from glsplat.net.guard.limits import CpuShare
from glsplat.net.messages import Request, eye_fields
from glsplat.net.pace.adaptive_quality import FULL, Detail
from glsplat.net.pose_queue import PoseQueue, SolutionFuture
from glsplat.net.room_view import RoomView
from glsplat.net.session import Session
from glsplat.net.wire_schema import PictureOptions
from glsplat.net.worker.encoding import ClientVideo

ANYTHING = AvatarInfo(name="")

_MAX_UNREAD = 256  # answers and texts that wait to be sent
_COST_WEIGHT = 0.1  # weight of each picture in the moving average of their times


class FrameObserver(Protocol):
    """Observes the requests and pictures of one client for a feature of the server. Its methods return at once."""

    def request_received(self, request: Request) -> None:
        """Handle an accepted request. Called on the event loop."""

    def picture_drawn(self, images: NDArray[np.uint8]) -> None:
        """Handle drawn pictures [V, H, W, 4]; may change them in place.

        Called on several encoding threads: calls may overlap, and need not come in the order of the frames.
        """

    def reply_sent(self, messages: Sequence[bytes]) -> None:
        """Handle a reply that the socket has taken. Called on the event loop."""


class RoomMember(Protocol):
    """A client's person in a room. May be used by several threads."""

    @property
    def own_fields(self) -> dict[str, Any]:
        """The fields of the ``room`` in a reply that concern the client alone."""

    def meeting(self, request: Request) -> Request:
        """Return the request with the faces of the others, for the solver."""

    def received(self, request: Request, at: float) -> None:
        """Note a request that arrived ``at`` seconds; its tracking may be solved much later."""

    def options(self, request: Request) -> PictureOptions:
        """Return the options of the request's picture, in the room's space."""

    def look(
        self, request: Request, cameras: Sequence[Camera], solved: Solved | None, at: float, now: float
    ) -> tuple[tuple[Camera, ...], RoomView]:
        """Return the ``cameras`` of a request that arrived ``at`` seconds, in the room's space, and its people."""

    def solved(self, request: Request, solved: Solved, at: float) -> None:
        """Show the person as ``solved``. Called on the solving thread. May raise PoseError."""

    def poses(self, history: PoseHistory, sha256: Callable[[str], bytes | None], now: float) -> Poses:
        """Return the poses that changed since the last ones in the client's ``history``."""

    def posed(self, count: int) -> None:
        """Count the people that were skinned for a picture."""

    def fair_cost(self, seconds: float) -> float:
        """Return the seconds to charge a viewer for a picture that took ``seconds``: the mean of the room."""


class DatagramTransport(Protocol):
    """A connection by datagrams for the pictures of one client, beside its WebSocket."""

    def offer(self) -> dict[str, str] | None:
        """Return "datagrams" of the next reply, where the client accepts them and its link gains by them."""

    def link_bytes(self, nbytes: int) -> int:
        """Return the bytes on the link, parity included, of a picture of ``nbytes``."""

    def send(self, frame_id: int, picture: bytes) -> bool:
        """Send a picture; return False where it has to go over the WebSocket."""

    def ping(self, payload: bytes) -> bool:
        """Send a ping; return False where it has to go over the WebSocket."""

    async def message(self) -> str:
        """Return the next message of the client."""

    def status(self) -> dict[str, float]:
        """Return "datagrams" of the client in /stats."""

    def close(self) -> None:
        """Close the connection."""


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """A request whose picture is drawn next, and the detail of that picture."""

    client: ClientStream
    request: Request
    arrived: float  # clock seconds
    cameras: tuple[Camera, ...]  # of the request, in the drawn size
    notice: str = ""  # text in the picture
    detail: Detail = FULL  # reduced where needed to hold a rate or to fit the link
    smaller: bool = False  # the link requires a smaller size than the rate
    solution: SolutionFuture | None = None  # of its tracking
    losses: int = 0  # workers that were lost while they drew or encoded it
    alone: bool = False  # drawn without the room's other people, because it failed with them

    @property
    def options(self) -> PictureOptions:
        """The options of the request, reduced to fit the link."""
        member, rung = self.client.member, self.detail.rung
        requested = self.request.options if member is None else member.options(self.request)
        return requested if rung is None else replace(requested, quality=rung.quality, crop=rung.crop)

    def solved(self) -> tuple[Solved | None, dict[str, float]]:
        """Return the pose of a request with tracking, and ``ik`` in ms. Raises PoseError where it is not solved."""
        if self.request.tracking is None:
            return None, {}
        if self.solution is None:
            raise PoseError(self.client.untracked)
        solved, ms = self.solution.result()
        return solved, {"ik": ms}


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A drawn picture, and its encoding, which may still be under way."""

    taken: Taken
    job: RenderJob
    rendered: Rendered
    encoded: asyncio.Future[Encoded]
    times: Mapping[str, float]  # ms by stage
    driver: str
    solved: Solved | None = None  # of a request with tracking

    def info(self, encoded: Encoded, times: Mapping[str, float]) -> dict[str, Any]:
        """Return the JSON object of the reply (docs/protocol.md, section 4)."""
        client, request, detail = self.taken.client, self.taken.request, self.taken.detail
        eyes = [eye_fields(camera) for camera in self.taken.cameras]
        info: dict[str, Any] = {
            "t": request.t,
            "times": {name: round(ms, 3) for name, ms in times.items()},
            "size": (self.taken.cameras[0].width, self.taken.cameras[0].height),
            "eyes": eyes,
            "crop": encoded.boxes,
            "dropped": client.session.counts.dropped,
            "driver": self.driver,
            "driven_by": client.driver,
        }
        if self.solved is not None:
            info["tracking"] = self.solved.notes
            drawn = [eye_fields(self.solved.seen(camera)) for camera in self.taken.cameras]
            if client.member is None and drawn != eyes:
                info["drawn"] = drawn
        if client.shown.still and request.pose is not None:
            info["still"] = client.shown.still
        for name, place in self.rendered.places.items():
            info[name] = [round(v, 5) for v in place]
        if self.rendered.depth:
            info["depth"] = DepthGrid.fields(self.rendered.depth)
        if any(self.rendered.levels) or detail != FULL:
            info["detail"] = detail.fields(self.rendered.levels)
        if encoded.video is not None:
            info["video"] = encoded.video
        if request.options.alpha == "straight":
            info["alpha"] = "straight"
        if client.member is not None and self.job.room is not None:
            info["room"] = self.job.room.fields() | client.member.own_fields
        return info


@dataclass(frozen=True, slots=True, eq=False)
class PoseAnswer:
    """Poses that are sent instead of a picture."""

    client: ClientStream
    request: Request
    arrived: float  # clock seconds
    times: Mapping[str, float]  # ms by stage
    poses: Poses
    notes: tuple[str, ...] | None = None  # of the tracking solver


@dataclass(frozen=True, slots=True, eq=False)
class Refused:
    """A request that is answered with an error."""

    request: Request
    code: str
    message: str
    ends: str = ""  # why the connection ends afterwards and the address is held off; "": it does not


Answer = Drawn | PoseAnswer | Refused | Taken
"""``Taken``: a picture whose worker was lost. It keeps its position among the answers and is drawn again."""


@dataclass(frozen=True, slots=True, eq=False)
class Outgoing:
    """A packed reply: binary messages, or the text of an error."""

    request: Request
    messages: Sequence[bytes] = ()
    error: str = ""
    ends: str = ""  # why the connection ends afterwards; "": it does not


@dataclass(eq=False, slots=True)
class ClientStream:
    """A client in the render loop."""

    number: int
    session: Session
    solving: PoseQueue | None = None  # None: its tracking is not solved
    _: KW_ONLY
    address: str = ""  # addresses share the renderer's time
    shown: AvatarInfo = ANYTHING
    account: str = ""  # name of its user; "": the server has no accounts
    driver: str = ""  # name of the avatar's driver; "": unknown
    label: str = ""  # "driven by ...", for clients that do not show it by themselves
    notice: Callable[[], str] = field(default=lambda: "")  # returns the text that a picture drawn now has to contain
    share: CpuShare | None = None  # of the time for reading and solving; None: no limit
    video: ClientVideo | None = None  # None: the server has no video
    member: RoomMember | None = None  # its person in a room; None: it is in no room
    room: str = ""  # name of its room
    relay: Callable[[str], bool] | None = None  # takes a text message to other clients; False: it is a request
    observers: tuple[FrameObserver, ...] = ()
    datagrams: DatagramTransport | None = None  # None: the server has no datagrams
    answers: asyncio.Queue[Answer | str] = field(default_factory=asyncio.Queue)  # bounded by the window and by ``say``
    pose_history: PoseHistory = field(default_factory=PoseHistory)  # the poses that it was sent
    cost: float = field(default=0.0, init=False)  # moving average of its pictures' seconds; 0: none was drawn
    newest: Encoded | None = field(default=None, init=False)  # JPEGs that were sent last, for the status page
    _redraw: tuple[Taken, asyncio.Future[Answer]] | None = field(default=None, init=False)
    _wake: Callable[[], None] = field(default=lambda: None, init=False)

    @property
    def place_key(self) -> str:
        """Key of the worker: clients with the same key share one where possible (extras/workers/placement.py)."""
        return f"room:{self.room}" if self.room else f"avatar:{self.shown.name}"

    @property
    def untracked(self) -> str:
        """The error for tracking where it is not solved."""
        why = self.shown.untracked
        how = f" for what it shows: {why}" if why else ": send pose instead of tracking"
        return f"this server has no tracking solver{how}"

    @property
    def redraws(self) -> bool:
        """True while a picture has to be drawn again, before any other."""
        return self._redraw is not None

    def stats(self, status: dict[str, Any], identity: bool) -> dict[str, Any]:
        """Return the client in /stats, with the ``status`` of its session; its ``identity`` only where requested."""
        return status | {
            "id": self.number,
            "form": self.session.last_form,
            "size": "x".join(map(str, self.session.last_size)),
            "datagrams": None if self.datagrams is None else self.datagrams.status(),
            "avatar": self.shown.name if identity else None,
            "room": self.room or None if identity else None,
            "mark": status["mark"] if identity else None,
        }

    def enter(self, room: str, member: RoomMember, name: str) -> None:
        """Enter a room as ``member``, by the ``name``."""
        self.member, self.room, self.driver = member, room, name
        if self.solving is not None:
            self.solving.on_solved = member.solved

    def observe(self, observer: FrameObserver) -> None:
        """Add an observer of requests and pictures."""
        self.observers = (*self.observers, observer)

    def offer(self, datagrams: DatagramTransport) -> None:
        """Offer the client datagrams for its pictures."""
        self.datagrams = datagrams

    def say(self, text: str) -> None:
        """Queue a text message that answers no request; drop it where too many answers are unread."""
        if self.answers.qsize() < _MAX_UNREAD:
            self.answers.put_nowait(text)

    def join(self, wake: Callable[[], None]) -> None:
        """Join a render loop; ``wake`` wakes it up."""
        self._wake = wake

    def wake(self) -> None:
        """Let the render loop check whether a picture can be drawn, after a request or an acknowledgement."""
        if self._redraw is not None or self.session.waits_for_picture:
            self._wake()

    def received(self, request: Request | None, now: float) -> None:
        """Note a message; queue the tracking of its ``request``."""
        if request is not None and request.tracking is not None and self.solving is not None:
            self.solving.add(request if self.member is None else self.member.meeting(request))
        if request is not None and self.member is not None:
            self.member.received(request, now)
        self.wake()

    def ready(self, solved: Callable[[], None], poses: bool = False) -> bool:
        """Return whether a request for a picture (or for ``poses``) can be answered now.

        If the tracking of none is solved, the newest is reserved and solved; ``solved`` is called afterwards, on any
        thread. Waiting for the newest sample of a stream would never end.
        """
        if self._redraw is not None:
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
        """Return the newest request that is ready, the seconds it waited, and its solution."""
        newest = self.session.newest
        kept = self.solving is not None and (newest is None or not self._solved(newest))
        taken = self.session.next_request(now, kept)
        assert taken is not None
        request, waited = taken
        return request, waited, None if self.solving is None else self.solving.take(request.frame_id)

    def redraw(self, taken: Taken) -> asyncio.Future[Answer]:
        """Queue a picture to be drawn again before any other; return its new answer."""
        answer: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._redraw = taken, answer
        self._wake()
        return answer

    def take_redraw(self) -> tuple[Taken, asyncio.Future[Answer]] | None:
        """Return the picture that has to be drawn again and the future for its answer, and clear them."""
        redraw, self._redraw = self._redraw, None
        return redraw

    def picture_drawn(self, images: NDArray[np.uint8]) -> None:
        """Pass pictures [V, H, W, 4] to the observers, which may change them. Called on an encoding thread."""
        for observer in self.observers:
            observer.picture_drawn(images)

    def picture_took(self, seconds: float) -> None:
        """Update the expected time of a picture."""
        self.cost += (seconds - self.cost) * (_COST_WEIGHT if self.cost else 1.0)

    def picture_sent(self, encoded: Encoded) -> None:
        """Keep the JPEGs that are sent for the status page; a video has none."""
        if encoded.pictures:
            self.newest = encoded if encoded.video is None else None

    def _solved(self, request: Request | None) -> bool:
        solving = self.solving
        return request is None or request.tracking is None or solving is None or solving.solved(request.frame_id)
