"""The client's half of the protocol without sockets and clocks: times come in as arguments, answers go out as values.

It gives out frame_ids, knows which requests are under way, what each message of the server answers, what it makes
pointless (the newest request wins), what to acknowledge, when to ask again and when to connect again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from glsplat.errors import ProtocolError
from glsplat.net.messages import LONGEST, VERSION
from glsplat.net.reply import Reply

__all__ = ["POLICIES", "Answer", "Backoff", "FlowControl", "ReceivedReply", "server_error"]

POLICIES = ("mailbox", "stop-and-wait", "fifo")
"""When to ask: at every refresh; when the last picture is decoded; when fewer than the window are unanswered."""

_AFTERWARDS = ("render", "encode")  # errors of a picture that was taken in hand: older requests were replaced by it
_SUBJECTS = 256  # kept at most
_PAUSES = (0.5, 1.0, 2.0, 4.0, 8.0)  # seconds between attempts to connect again


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedReply:
    """A reply and when it came, on the clock of ``time.perf_counter``."""

    reply: Reply
    at: float  # seconds
    requested: float  # seconds; when its request was sent

    @property
    def communication_ms(self) -> float:
        """Round trip less the server's own time: both directions on the wire and in the sockets."""
        return max(0.0, (self.at - self.requested) * 1e3 - self.reply.info.get("times", {}).get("total", 0.0))


@dataclass(frozen=True, slots=True)
class Answer:
    """What a message of the server is about."""

    frame_id: int | None  # of the request; None: of none
    requested: float = 0.0  # seconds; when it was sent
    wanted: bool = True  # False: whoever waited for it has left
    replaced: tuple[int, ...] = ()  # requests that will never be answered now, oldest first


class FlowControl:
    """The state of one connection, from the client's side. A new connection is a new Flow: frame_ids begin at 1."""

    def __init__(self) -> None:
        self.newest: int = 0  # frame_id of the newest request
        self.taken: int = 0  # frame_id of the newest picture that somebody took: what is acknowledged
        self.refused: int = 0  # frame_id of the newest request that was answered with an error
        self.said: str = ""  # the newest error that names no request, such as too many messages
        self._sent: dict[int, float] = {}  # frame_id: seconds
        self._arrivals: dict[int, tuple[float, float]] = {}  # frame_id: seconds from the request, and when it came
        self._left: set[int] = set()  # frame_ids whose waiter left: their pictures are for nobody
        self._subjects: dict[int, object] = {}

    @property
    def waiting(self) -> bool:
        """True while the newest request has no answer."""
        return self.newest in self._sent

    @property
    def unanswered(self) -> int:
        """Requests that may still be answered."""
        return len(self._sent)

    def may_ask(self, policy: str, window: int, decoded: int) -> bool:
        """Whether a client that asks by that policy asks now; ``decoded`` is the newest frame_id ready to be shown."""
        if policy == "stop-and-wait":
            return self.newest <= max(decoded, self.refused)
        return policy == "mailbox" or self.unanswered < window

    def ask(self, frame_id: int, now: float, subject: object = None) -> None:
        """A request goes out. ``subject`` is what it is about to the client; ``about`` gives it back."""
        if frame_id <= self.newest:
            raise ProtocolError(f"frame_id has to grow: {frame_id} does not follow {self.newest}")
        self.newest = frame_id
        self._sent[frame_id] = now
        if subject is not None:
            self._subjects[frame_id] = subject
            if len(self._subjects) > _SUBJECTS:  # of a client that takes nothing
                del self._subjects[next(iter(self._subjects))]

    def unsent(self, frame_id: int) -> None:
        """It did not go out after all."""
        self._sent.pop(frame_id, None)

    def leave(self, frame_id: int) -> None:
        """Nobody waits for its picture any more."""
        if frame_id in self._sent:
            self._left.add(frame_id)

    def about(self, frame_id: int) -> object:
        """The subject of a request: until a later picture is taken."""
        return self._subjects.get(frame_id)

    def arrived(self, frame_id: int, now: float | None = None) -> Answer:
        """A picture came, at ``now`` where the server is to hear of that.

        Of one answered before, or never asked for, ``frame_id`` is None.
        """
        requested = self._sent.pop(frame_id, None)
        if requested is None:
            return Answer(None)
        if now is not None:
            self._arrivals[frame_id] = now - requested, now
            if len(self._arrivals) > _SUBJECTS:  # of a client that takes nothing
                del self._arrivals[next(iter(self._arrivals))]
        wanted = frame_id not in self._left
        self._left.discard(frame_id)
        return Answer(frame_id, requested, wanted, self._replace(frame_id))

    def failed(self, error: ProtocolError, waited_for: int | None = None) -> Answer:
        """An error came. One that names no request is taken to be about ``waited_for``."""
        number = error.frame_id
        if number is None:
            self.said = str(error)
            number = waited_for
        if number is None:
            return Answer(None)
        requested = self._sent.pop(number, 0.0)
        self.refused = max(self.refused, number)
        wanted = number not in self._left
        self._left.discard(number)
        return Answer(number, requested, wanted, self._replace(number) if error.code in _AFTERWARDS else ())

    def take(self, frame_id: int) -> bool:
        """Somebody took a picture; True: acknowledge it at once, because newer requests are under way."""
        self.taken = max(self.taken, frame_id)
        for number in [number for number in self._subjects if number < frame_id]:
            del self._subjects[number]
        return bool(self._sent)

    def acknowledging(self, now: float) -> dict[str, Any]:
        """The fields that acknowledge what was taken; how it arrived is said once."""
        fields: dict[str, Any] = {"ack": self.taken}
        arrival = self._arrivals.get(self.taken)
        for number in [number for number in self._arrivals if number <= self.taken]:
            del self._arrivals[number]
        if arrival is not None:
            age, at = arrival
            held = min(max(0.0, now - at) * 1e3, LONGEST)
            fields["arrival"] = {"age": round(min(age * 1e3, LONGEST), 3), "held": round(held, 3)}
        return fields

    def acknowledgement(self, now: float) -> str:
        """The message that only acknowledges."""
        return msgspec.json.encode({"v": VERSION, **self.acknowledging(now)}).decode()

    def end(self) -> None:
        """The connection ended: nothing is under way any more."""
        self._sent.clear()

    def _replace(self, frame_id: int) -> tuple[int, ...]:
        old = tuple(number for number in self._sent if number < frame_id)
        for number in old:
            del self._sent[number]
            self._left.discard(number)
        return old


class Backoff:
    """How long to wait before the next attempt to connect: ever longer, until one succeeds."""

    def __init__(self) -> None:
        self._failed = 0

    def pause(self) -> float:
        """Seconds until the next attempt, after one that failed."""
        self._failed += 1
        return _PAUSES[min(self._failed, len(_PAUSES)) - 1]

    def connected(self) -> None:
        """One succeeded."""
        self._failed = 0


def server_error(text: str) -> ProtocolError:
    """The error that a text message of the server carries."""
    try:
        error = msgspec.json.decode(text)["error"]
        number = error.get("frame_id")
        return ProtocolError(str(error["message"]), str(error["code"]), number if isinstance(number, int) else None)
    except (msgspec.MsgspecError, KeyError, TypeError, AttributeError):
        return ProtocolError("the server sent a text message that is not an error", "bad_reply")
