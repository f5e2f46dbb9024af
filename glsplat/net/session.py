"""The server's half of the protocol for one client, without I/O: times come in as arguments, answers go out as values.

The latest request wins: at most one waits; the older ones are dropped and counted. At most ``window`` pictures are
under way or unacknowledged.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

from glsplat.errors import ProtocolError
from glsplat.net.guard.limits import Bucket
from glsplat.net.guard.meter import POLICY_VIOLATION, Breach
from glsplat.net.messages import MAX_ID, Ack, Decoder, Request, error_text
from glsplat.net.pace.ladder import Rung
from glsplat.net.wire_schema import Arrival
from glsplat.optional import missing, plugin

if TYPE_CHECKING:
    from glsplat.renderer.resolve import ResolveStep

    class Watermark(ResolveStep, Protocol):
        """A watermark that identifies the session of a picture (extras/watermark)."""

        @property
        def session(self) -> int:
            """The session's id, 32 bits."""

    class WatermarkKey(Protocol):
        """The key of a server's watermarks (extras/watermark)."""

        def new_mark(self) -> Watermark:
            """Return the mark of a new session."""


log: logging.Logger = logging.getLogger(__name__)  # serve sets its level: these lines trace recorded pictures

GOING_AWAY = 1001  # RFC 6455, section 7.4.1


class LinkControl(Protocol):
    """Fits pictures to one client's link (extras/far_links). ``number`` is a picture's frame_id; times in seconds."""

    @property
    def known(self) -> bool:
        """Whether rate and round trip are known."""

    def rung(self, number: int, pixels: int, quality: int, crop: bool, now: float) -> Rung:
        """Start a picture of that many pixels and that JPEG quality; return its rung of the ladder."""

    def rest(self, now: float) -> float:
        """Return the seconds to wait before the next picture is started."""

    def written(self, number: int, nbytes: int, now: float) -> None:
        """Note that a picture was written to the socket."""

    def acknowledged(self, number: int, age: float, held: float, now: float) -> None:
        """Note that a picture arrived ``age`` seconds after its request; the client reports ``held`` seconds later."""

    def forget(self, number: int) -> None:
        """Expect no report on the pictures up to ``number``."""

    def lost(self, number: int, now: float) -> None:
        """Note that a picture will never arrive."""

    def failed(self, number: int) -> None:
        """Note that a picture could not be made."""

    def ping(self, now: float) -> bytes | None:
        """Return the payload of a ping to send before a picture; None for no ping."""

    def follow(self, number: int) -> bytes:
        """Return the payload of a ping to send behind a picture."""

    def ponged(self, payload: bytes, now: float) -> None:
        """Note the answer to a ping."""

    def status(self) -> dict[str, float | None]:
        """Return ``link`` of a client in /stats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionConfig:
    """Limits of one client."""

    window: int = 2  # pictures under way or unacknowledged; 2 measured best on a LAN, 3 from 15 ms of round trip
    rate: float = 240.0  # messages a second; above twice any display's rate
    burst: int = 120  # messages at once on top of that
    flood: int = 2000  # messages above the rate before the connection ends
    errors: int = 8  # malformed messages at once before the connection ends ...
    forgive: float = 0.5  # ... and how many of them a second are forgiven
    handshake: float = 10.0  # seconds from the connection to the first valid request
    idle: float = 60.0  # seconds without any message
    max_window: int = 8  # window of a client whose link is known and that requested no window
    adapt: bool = False  # fit pictures to the links of clients that report arrivals
    bitrate: float | None = None  # bits a second to each of them; None: as many as the link takes
    watermark: WatermarkKey | None = None  # key of the watermarks in the pictures; None: no watermarks


@dataclass(frozen=True, slots=True)
class Warn:
    """Send this error text and go on."""

    text: str


@dataclass(frozen=True, slots=True)
class Close:
    """Send this error text (unless empty), then close the connection with this code."""

    text: str
    code: int
    reason: str
    breach: bool = False  # the client broke a limit: its address is held off


@dataclass(slots=True)
class Counts:
    """Counts of a client's messages and replies."""

    received: int = 0  # messages
    accepted: int = 0  # requests that entered the mailbox
    dropped: int = 0  # requests replaced by a newer one before they were drawn
    stale: int = 0  # requests whose frame_id did not grow
    malformed: int = 0
    limited: int = 0  # messages above the rate, not read
    unread: int = 0  # messages beyond the client's share of time, dropped for newer ones
    failed: int = 0  # pictures that could not be drawn
    sent: int = 0  # replies
    posed: int = 0  # replies with poses
    bytes_sent: int = 0


class Session:
    """The server's state of one connection. ``now`` is a monotonic clock in seconds.

    The owner passes messages to ``receive``, takes requests from ``next_request`` when the renderer is free, and
    reports ``sending`` and ``sent``, or ``failed``, for each of them. ``refusal`` returns why the avatar may not be
    shown any more, or "". ``sends_poses``: the server answers requests for poses.
    """

    def __init__(
        self,
        decoder: Decoder,
        config: SessionConfig | None = None,
        now: float = 0.0,
        refusal: Callable[[], str] = lambda: "",
        sends_poses: bool = True,
    ) -> None:
        self.config: SessionConfig = config or SessionConfig()
        self.counts: Counts = Counts()
        self.last_form: str = ""  # of the newest request, for /stats
        self.last_size: tuple[int, int] = (0, 0)
        watermark = self.config.watermark
        self.mark: Watermark | None = None if watermark is None else watermark.new_mark()
        self.link: LinkControl | None = None  # from the first report of an arrival on
        self.datagrams: bool = False  # the client accepts pictures by datagrams
        self.refusal: Callable[[], str] = refusal
        self._decoder, self._sends_poses = decoder, sends_poses
        self._opened = self._heard = self._noticed = now
        self._pending: dict[int, tuple[Request, float]] = {}  # by eye for the oldest form, else one
        self._kept: tuple[Request, float] | None = None
        self._under_way: dict[int, bool] = {}  # by frame_id: True for a picture, False for poses
        self._unacked: deque[int] = deque()
        self._newest = -1  # frame_id accepted
        self._newest_sent = -1
        self._rate = Bucket(self.config.rate + self.config.burst, self.config.rate, self.config.burst, now)
        self._flood = Bucket(self.config.flood, self.config.rate, self.config.flood, now)
        self._errors = Bucket(self.config.errors, self.config.forgive, self.config.errors, now)

    def announce(self, number: int, address: str) -> None:
        """Log the client together with its watermark's session id."""
        if self.mark is not None:
            log.info("client %d at %s is marked as session %08x", number, address, self.mark.session)

    def receive(self, data: str | bytes, now: float) -> Request | Warn | Close | None:
        """Decode a text message; return its request or the reaction to it, None for an ack or a stale request."""
        self._heard = now
        self.counts.received += 1
        if not self._rate.take(now):
            return self._limited(now)
        if why := self.refusal():
            return Close(error_text("not_allowed", why), POLICY_VIOLATION, "no longer allowed")
        try:
            message = self._decoder.decode(data)
            if isinstance(message, Ack):
                self._acknowledge(message.frame_id, message.arrival, now)
                return None
            return self._accept(message, now)
        except ProtocolError as error:
            return self.malformed(error, now)

    def malformed(self, error: ProtocolError, now: float) -> Warn | Close:
        """Count a message that could not be used; repeated ones end the connection."""
        self._heard = now
        self.counts.malformed += 1
        text = error_text(error.code, str(error), error.frame_id)
        if self._errors.take(now):
            return Warn(text)
        return Close(text, POLICY_VIOLATION, "too many malformed messages")

    def overspent(self, now: float) -> bool:
        """Count a picture that was too costly like a malformed message; return whether the connection ends."""
        return not self._errors.take(now)

    def broke(self, breach: Breach) -> Close:
        """Return how to close a connection whose frames are malformed or too many."""
        if breach.code != POLICY_VIOLATION:
            self.counts.malformed += 1
            return Close("", breach.code, breach.reason)
        self.counts.limited += 1
        text = error_text("rate", f"the connection ends: {breach.reason}")
        return Close(text, breach.code, breach.reason, breach=True)

    def ready(self) -> bool:
        """Return whether a request waits and the window has room for its picture."""
        waits = bool(self._pending) or self._kept is not None
        return waits and len(self._under_way.keys() | set(self._unacked)) < self.window

    @property
    def window(self) -> int:
        """Largest number of pictures under way or unacknowledged; on a known link ``rest`` spaces them, too."""
        known = self.link is not None and self.link.known
        return self.config.max_window if known else self.config.window

    def rung(self, request: Request, now: float) -> Rung | None:
        """Start the picture of ``request``; return its rung of the ladder, None where no link is measured."""
        if self.link is None:
            return None
        assert request.frame_id is not None
        first, options = request.cameras[0], request.options
        pixels = first.width * first.height * len(request.cameras)
        return self.link.rung(request.frame_id, pixels, options.quality, options.crop, now)

    def rest(self, now: float) -> float:
        """Return the seconds to wait before the next picture is started."""
        return 0.0 if self.link is None else self.link.rest(now)

    @property
    def waits_for_picture(self) -> bool:
        """True while a request for a picture waits."""
        waiting = (*self._pending.values(), self._kept)
        return any(entry is not None and not entry[0].poses for entry in waiting)

    @property
    def drawing(self) -> bool:
        """True while a picture is under way, which no later answer may overtake."""
        return any(self._under_way.values())

    @property
    def newest(self) -> Request | None:
        """The newest waiting request."""
        return next(iter(self._pending.values()))[0] if self._pending else None

    @property
    def kept(self) -> Request | None:
        """The request that ``keep`` reserved, until it or a newer one is taken."""
        return None if self._kept is None else self._kept[0]

    def keep(self) -> None:
        """Reserve the newest request although newer ones may come: its tracking is being solved."""
        self._kept = next(iter(self._pending.values()))

    def next_request(self, now: float, kept: bool = False) -> tuple[Request, float] | None:
        """Take the newest request, or the ``kept`` one; return it and the seconds it waited, or None.

        It is under way until ``sent`` or ``failed``.
        """
        taken = self._kept if kept else next(iter(self._pending.values()), None)
        if taken is None or not self.ready():
            return None
        request, arrived = taken
        if not kept and self._kept is not None and self._kept is not taken:
            self.counts.dropped += 1
        self._kept = None
        self._pending = {slot: entry for slot, entry in self._pending.items() if entry is not taken}
        assert request.frame_id is not None
        self._under_way[request.frame_id] = not request.poses
        return request, now - arrived

    def sending(self, request: Request, nbytes: int = 0, now: float = 0.0) -> None:
        """Note that the picture of ``request`` is written next: from now on the client may acknowledge it.

        ``nbytes`` are its bytes on the link; 0 for few.
        """
        assert request.frame_id is not None
        if self.link is not None and nbytes:
            self.link.written(request.frame_id, nbytes, now)
        self._newest_sent = max(self._newest_sent, request.frame_id)
        if request.ack is not None:  # the socket alone limits a client that never acknowledges
            self._unacked.append(request.frame_id)

    def sent(self, request: Request, nbytes: int) -> None:
        """Note that the socket has taken the reply to ``request``, of ``nbytes``."""
        assert request.frame_id is not None
        self._under_way.pop(request.frame_id, None)
        self.counts.sent += 1
        self.counts.posed += request.poses
        self.counts.bytes_sent += nbytes

    def lost(self, frame_id: int, now: float) -> None:
        """Note that a picture was sent but will never arrive; expect no acknowledgement of it."""
        self.give_up((frame_id,))
        if self.link is not None:
            self.link.lost(frame_id, now)

    def give_up(self, frame_ids: Collection[int]) -> None:
        """Expect no acknowledgements of these pictures."""
        self._unacked = deque(one for one in self._unacked if one not in frame_ids)

    def failed(self, request: Request, code: str, message: str) -> str:
        """Note that the picture of ``request`` cannot be drawn; return the error text to send."""
        assert request.frame_id is not None
        self._under_way.pop(request.frame_id, None)
        if self.link is not None:
            self.link.failed(request.frame_id)
        self.counts.failed += 1
        return error_text(code, message, request.frame_id)

    def expires(self) -> float:
        """Return the time at which the connection ends if nothing arrives before."""
        if self._newest < 0:
            return self._opened + self.config.handshake
        return self._heard + self.config.idle

    def expired(self, now: float) -> Close | None:
        """Return a Close once the client was silent for too long, or sent no valid request in time."""
        if now < self.expires():
            return None
        reason = "no valid request in time" if self._newest < 0 else "idle"
        return Close(error_text("timeout", reason), POLICY_VIOLATION, reason)

    def status(self) -> dict[str, Any]:
        """Return counts, window and the id in the watermark (hex), for /stats."""
        return asdict(self.counts) | {
            "mark": None if self.mark is None else f"{self.mark.session:08x}",
            "window": self.window,
            "link": None if self.link is None else self.link.status(),
            "unacknowledged": len(self._unacked),
            "under_way": len(self._under_way),
            "waiting": len({id(entry) for entry in (*self._pending.values(), self._kept) if entry is not None}),
        }

    def _accept(self, request: Request, now: float) -> Request | None:
        if request.ack is not None:
            self._acknowledge(request.ack, request.arrival, now)
        else:
            self._unacked.clear()  # a client that has stopped acknowledging is alive, as this request shows
            if self.link is not None:
                self.link.forget(self._newest_sent)
        # the oldest form has one eye a message and ignores frame_ids; others may omit them
        unnumbered = request.frame_id is None or request.form == "single-legacy"
        frame_id = self._newest + 1 if unnumbered else request.frame_id
        assert frame_id is not None
        if frame_id <= self._newest:
            self.counts.stale += 1
            return None
        if frame_id > MAX_ID:  # an unnumbered request behind the highest frame_id
            raise ProtocolError(f"there is no frame_id after {MAX_ID}; connect again", "bad_request")
        if request.poses and not self._sends_poses:
            raise ProtocolError(missing("browser", "want: pose"), "bad_request", request.frame_id)
        arrival = request.arrival if self.config.adapt else None
        if (frame_id, arrival) != (request.frame_id, request.arrival):
            request = replace(request, frame_id=frame_id, arrival=arrival)
        self._newest, self.datagrams = frame_id, request.datagrams
        self.last_form = request.form
        if request.cameras:
            self.last_size = (request.cameras[0].width, request.cameras[0].height)
        self.counts.accepted += 1
        # a right eye of the oldest form must not replace the left one
        slot = request.eyes[0] if request.form == "single-legacy" else -1
        keys = [key for key in self._pending if slot == -1 or key in (slot, -1)]
        for key in keys:
            self.counts.dropped += self._pending.pop(key) is not self._kept
        self._pending[slot] = (request, now)
        return request

    def _acknowledge(self, frame_id: int, arrival: Arrival | None, now: float) -> None:
        """Free the window up to ``frame_id``. Clients that received nothing yet send 0, which is always legal."""
        if frame_id > max(self._newest_sent, 0):
            raise ProtocolError(f"ack names {frame_id}, which was never sent", "bad_ack")
        while self._unacked and self._unacked[0] <= frame_id:
            self._unacked.popleft()
        if arrival is None or not self.config.adapt:
            if self.link is not None:
                self.link.forget(frame_id)
            return
        if self.link is None:
            module = _link_module()
            self.link = None if module is None else module.LinkControl(self.config.bitrate)
        if self.link is not None:
            self.link.acknowledged(frame_id, arrival.age / 1e3, arrival.held / 1e3, now)

    def _limited(self, now: float) -> Warn | Close | None:
        self.counts.limited += 1
        if not self._flood.take(now):
            text = error_text("rate", "the connection ends: too many messages")
            return Close(text, POLICY_VIOLATION, "too many messages", breach=True)
        if now - self._noticed < 1.0:
            return None
        self._noticed = now
        return Warn(error_text("rate", f"at most {self.config.rate:g} messages a second are read"))


@cache
def _link_module() -> ModuleType | None:
    """Return the module that controls clients' links; None where extras/far_links is not installed."""
    return plugin("far_links.link_control")
