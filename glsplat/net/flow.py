"""The client's half of the protocol, without I/O: times come in as arguments, answers go out as values.

``FlowControl`` matches the server's messages to requests, finds the requests that a newer one replaced, and decides
what to acknowledge and when to send the next request. ``Backoff`` decides when to reconnect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from glsplat.errors import ProtocolError
from glsplat.net.messages import MAX_ARRIVAL_MS, VERSION
from glsplat.net.reply import Reply

POLICIES = ("mailbox", "stop-and-wait", "fifo")
"""When to send a request: at every refresh; once the last picture is decoded; while the window has room."""

_LATE_ERRORS = ("render", "encode")  # of a request that the server has taken: it replaced all older ones
_MAX_REMEMBERED = 256  # requests of a client that takes no pictures
_PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0)  # between attempts to reconnect


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedReply:
    """A reply with its times, in seconds of ``time.perf_counter``."""

    reply: Reply
    at: float  # when it arrived
    requested: float  # when its request was sent

    @property
    def communication_ms(self) -> float:
        """Milliseconds on the wire and in the sockets, both ways: the round trip less the server's own time."""
        return max(0.0, (self.at - self.requested) * 1e3 - self.reply.info.get("times", {}).get("total", 0.0))


@dataclass(frozen=True, slots=True)
class Answer:
    """The request that a message of the server answers."""

    frame_id: int | None  # None: it answers no request
    requested: float = 0.0  # seconds; when the request was sent
    wanted: bool = True  # False: its caller has stopped waiting
    replaced: tuple[int, ...] = ()  # older requests that will never be answered now, oldest first


class FlowControl:
    """The client's state of one connection. A new connection needs a new one: its frame_ids begin at 1."""

    def __init__(self) -> None:
        self.newest: int = 0  # frame_id of the newest request
        self.taken: int = 0  # frame_id of the newest picture that a caller took; it is acknowledged
        self.refused: int = 0  # frame_id of the newest request that was answered with an error
        self.last_error: str = ""  # the newest error without a frame_id, such as too many messages
        self._sent: dict[int, float] = {}  # by frame_id: when, in seconds
        self._arrivals: dict[int, tuple[float, float]] = {}  # by frame_id: seconds since the request, and when
        self._left: set[int] = set()  # frame_ids whose caller has stopped waiting
        self._subjects: dict[int, object] = {}

    @property
    def waiting(self) -> bool:
        """True while the newest request has no answer."""
        return self.newest in self._sent

    @property
    def unanswered(self) -> int:
        """Requests that may still be answered."""
        return len(self._sent)

    def may_request(self, policy: str, window: int, decoded: int) -> bool:
        """Return whether ``policy`` sends a request now; ``decoded`` is the newest frame_id ready to be shown."""
        if policy == "stop-and-wait":
            return self.newest <= max(decoded, self.refused)
        return policy == "mailbox" or self.unanswered < window

    def request(self, frame_id: int, now: float, subject: object = None) -> None:
        """Note that a request is sent. ``about`` returns its ``subject``."""
        if frame_id <= self.newest:
            raise ProtocolError(f"frame_id must grow: {frame_id} does not follow {self.newest}")
        self.newest = frame_id
        self._sent[frame_id] = now
        if subject is not None:
            self._subjects[frame_id] = subject
            _forget_oldest(self._subjects)

    def unsent(self, frame_id: int) -> None:
        """Note that a request could not be sent."""
        self._sent.pop(frame_id, None)

    def leave(self, frame_id: int) -> None:
        """Note that the caller has stopped waiting for a picture."""
        if frame_id in self._sent:
            self._left.add(frame_id)

    def about(self, frame_id: int) -> object:
        """Return the subject of a request; None once a later picture was taken."""
        return self._subjects.get(frame_id)

    def arrived(self, frame_id: int, now: float | None = None) -> Answer:
        """Note a picture; ``now`` is its arrival, to be reported to the server, or None.

        The answer's ``frame_id`` is None for a picture that was answered before or never requested.
        """
        requested = self._sent.pop(frame_id, None)
        if requested is None:
            return Answer(None)
        if now is not None:
            self._arrivals[frame_id] = now - requested, now
            _forget_oldest(self._arrivals)
        wanted = frame_id not in self._left
        self._left.discard(frame_id)
        return Answer(frame_id, requested, wanted, self._replace(frame_id))

    def failed(self, error: ProtocolError, waited_for: int | None = None) -> Answer:
        """Note an error; one without a frame_id counts for ``waited_for``."""
        number = error.frame_id
        if number is None:
            self.last_error = str(error)
            number = waited_for
        if number is None:
            return Answer(None)
        requested = self._sent.pop(number, 0.0)
        self.refused = max(self.refused, number)
        wanted = number not in self._left
        self._left.discard(number)
        return Answer(number, requested, wanted, self._replace(number) if error.code in _LATE_ERRORS else ())

    def take(self, frame_id: int) -> bool:
        """Note that a caller took a picture; return whether to acknowledge it at once, as newer requests wait."""
        self.taken = max(self.taken, frame_id)
        for number in [number for number in self._subjects if number < frame_id]:
            del self._subjects[number]
        return bool(self._sent)

    def acknowledging(self, now: float) -> dict[str, Any]:
        """Return the fields that acknowledge the picture taken last; its arrival is reported once."""
        fields: dict[str, Any] = {"ack": self.taken}
        arrival = self._arrivals.get(self.taken)
        for number in [number for number in self._arrivals if number <= self.taken]:
            del self._arrivals[number]
        if arrival is not None:
            age, at = arrival
            held = min(max(0.0, now - at) * 1e3, MAX_ARRIVAL_MS)
            fields["arrival"] = {"age": round(min(age * 1e3, MAX_ARRIVAL_MS), 3), "held": round(held, 3)}
        return fields

    def acknowledgement(self, now: float) -> str:
        """Return the message that only acknowledges."""
        return msgspec.json.encode({"v": VERSION, **self.acknowledging(now)}).decode()

    def end(self) -> None:
        """Note that the connection has ended."""
        self._sent.clear()

    def _replace(self, frame_id: int) -> tuple[int, ...]:
        old = tuple(number for number in self._sent if number < frame_id)
        for number in old:
            del self._sent[number]
            self._left.discard(number)
        return old


def _forget_oldest(entries: dict[int, Any]) -> None:
    if len(entries) > _MAX_REMEMBERED:
        del entries[next(iter(entries))]


class Backoff:
    """Pauses between attempts to reconnect, which grow until one succeeds."""

    def __init__(self) -> None:
        self._failed = 0

    def pause(self) -> float:
        """Return the seconds to wait after a failed attempt."""
        self._failed += 1
        return _PAUSES_S[min(self._failed, len(_PAUSES_S)) - 1]

    def connected(self) -> None:
        """Note that an attempt succeeded."""
        self._failed = 0


def server_error(text: str) -> ProtocolError:
    """Return the error in a text message of the server."""
    try:
        error = msgspec.json.decode(text)["error"]
        number = error.get("frame_id")
        return ProtocolError(str(error["message"]), str(error["code"]), number if isinstance(number, int) else None)
    except (msgspec.MsgspecError, KeyError, TypeError, AttributeError):
        return ProtocolError("the server sent a text message that is not an error", "bad_reply")
