"""A room of a server without its sockets: all that a message goes through until what it comes to is drawn and sent."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from types import SimpleNamespace
from typing import Any

from glsplat.extras.browser.poses.responder import PoseResponder
from glsplat.extras.rooms.rooms import Rooms
from glsplat.net.backend import AvatarInfo, RenderJob
from glsplat.net.client_stream import ClientStream
from glsplat.net.codec.encode import Encoded
from glsplat.net.local_loop import LocalLoop
from glsplat.net.messages import Decoder, Request, WireOptions
from glsplat.net.options import client_options
from glsplat.net.reply import Reply, pack_reply, parse_reply
from glsplat.net.rights import Rights
from glsplat.net.session import Close, Session, SessionConfig, Warn
from tests.net.conftest import FakeBackend

__all__ = ["Meeting", "RefusedError"]

_PICTURE = b"\xff\xd8 a picture"


class RefusedError(Exception):
    """What a client is told instead of a picture or bodies."""


class _Here(Executor):
    """Works at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        fn(*args, **kwargs)
        return Future()


class Meeting:
    """The room "lab". ``draw`` is given each picture's job; ``now`` is the time in seconds, which tests move."""

    def __init__(self, offers: Mapping[str, AvatarInfo], draw: Callable[[RenderJob], object]) -> None:
        self.now = 100.0
        self.rooms = Rooms({"lab": 6})
        self.ended: list[int] = []  # numbers of clients whose connection the room has ended
        gate = SimpleNamespace(rights=Rights())
        close = lambda number, reason: self.ended.append(number)  # noqa: E731
        self.rooms._server = SimpleNamespace(clock=lambda: self.now, gate=gate, close_client=close)  # type: ignore[assignment]
        self._offers, self._draw, self._numbers = offers, draw, 0
        self._loop = LocalLoop(FakeBackend(), clock=lambda: self.now)
        self._loop._solve_thread = _Here()  # type: ignore[assignment]
        self._answers = PoseResponder(lambda name: name.encode().ljust(32), lambda name: "", clock=lambda: self.now)

    def enter(self, query: Mapping[str, str]) -> ClientStream:
        """As Server does. Raises ProtocolError."""
        asked = client_options(query, WireOptions(size=(16, 16)), SessionConfig(), list(self._offers))
        one = self._offers[asked.avatar]
        self._numbers += 1
        session = Session(Decoder(asked.wire, one.skeleton, one.parts), asked.session, self.now)
        solver = None if one.solver is None else one.solver(asked.height, asked.span)
        channel = self._loop.open(self._numbers, session, solver, "", one)
        self.rooms.client_opened(channel, asked)
        if channel.solving is not None:
            channel.solving._cpu = lambda: self.now
        return channel

    def leave(self, channel: ClientStream, goodbye: bool) -> None:
        """Its connection ends, with a close or without."""
        self._loop.remove(channel)
        self.rooms.client_closed(channel, goodbye)

    def ask(self, channel: ClientStream, message: Mapping[str, Any]) -> Reply | None:
        """What comes back of a message; None for an acknowledgement. Raises RefusedError, PoseError, and for faults."""
        outcome = channel.session.receive(json.dumps(message), self.now)
        if isinstance(outcome, (Warn, Close)):
            raise RefusedError(outcome.text)
        if outcome is None:
            return None
        assert isinstance(outcome, Request)
        self._loop.received(channel, outcome)
        return self._posed(channel) if outcome.poses else self._pictured(channel)

    def _pictured(self, channel: ClientStream) -> Reply:
        frame = self._loop._next_frame(channel)
        request, session = frame.request, channel.session
        try:
            job = self._loop._job(frame)
            self._draw(job)
        except BaseException:
            session.failed(request, "", "")
            raise
        pictures = [_PICTURE] * len(request.eyes)
        assert request.frame_id is not None
        data = pack_reply(request.frame_id, request.eyes, pictures, frame.info(Encoded(pictures, None, 0.0)))
        session.sending(request)
        session.sent(request, len(data))
        return parse_reply(data)

    def _posed(self, channel: ClientStream) -> Reply:
        frame = self._answers._answer(channel)
        if frame.poses is None:
            channel.session.failed(frame.request, *frame.error)
            raise RefusedError(*frame.error)
        (data,) = self._answers.pack(frame)
        channel.session.sent(frame.request, len(data))
        return parse_reply(data)
