"""A room of a server without its sockets: all that a message goes through until what it comes to is drawn and sent."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from types import SimpleNamespace
from typing import Any

import numpy as np

from glsplat.extras.browser.responder import PoseResponder
from glsplat.extras.rooms.feature import Rooms
from glsplat.net.backend import AvatarInfo, Rendered, RenderJob
from glsplat.net.client_stream import ClientStream, Drawn, PoseAnswer
from glsplat.net.codec.encoded import Encoded
from glsplat.net.messages import Decoder, Request, WireOptions
from glsplat.net.options import client_options
from glsplat.net.pose_queue import PoseQueue
from glsplat.net.render_loop import RenderLoop
from glsplat.net.reply import Reply, pack_reply, parse_reply
from glsplat.net.rights import Rights
from glsplat.net.session import Close, Session, SessionConfig, Warn
from glsplat.net.worker.worker import ThreadWorker
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
        self._loop = RenderLoop(ThreadWorker(FakeBackend()), clock=lambda: self.now)
        self._answers = PoseResponder(lambda name: name.encode().ljust(32), lambda name: "", clock=lambda: self.now)

    def enter(self, query: Mapping[str, str]) -> ClientStream:
        """As Server does. Raises ProtocolError."""
        asked = client_options(query, WireOptions(size=(16, 16)), SessionConfig(), list(self._offers))
        one = self._offers[asked.avatar]
        self._numbers += 1
        session = Session(Decoder(asked.wire, one.skeleton, one.parts), asked.session, self.now)
        solver = None if one.solver is None else one.solver(asked.height, asked.span)
        solving = None if solver is None else PoseQueue(solver, _Here(), lambda: self.now, lambda: self.now)
        client = ClientStream(self._numbers, session, solving, shown=one)
        self.rooms.client_opened(client, asked)
        return client

    def leave(self, client: ClientStream, goodbye: bool) -> None:
        """Its connection ends, with a close or without."""
        self._loop.remove(client)
        self.rooms.client_closed(client, goodbye)

    def ask(self, client: ClientStream, message: Mapping[str, Any]) -> Reply | None:
        """What comes back of a message; None for an acknowledgement. Raises RefusedError, PoseError, and for faults."""
        outcome = client.session.receive(json.dumps(message), self.now)
        if isinstance(outcome, (Warn, Close)):
            raise RefusedError(outcome.text)
        if outcome is None:
            return None
        assert isinstance(outcome, Request)
        client.received(outcome, self.now)
        return self._posed(client) if outcome.poses else self._pictured(client)

    def _pictured(self, client: ClientStream) -> Reply:
        taken = self._loop._take(client)
        request, session = taken.request, client.session
        try:
            solved, times = taken.solved()
            job = self._loop._job(taken, solved)
            self._draw(job)
        except BaseException:
            session.failed(request, "", "")
            raise
        pictures = [_PICTURE] * len(request.eyes)
        assert request.frame_id is not None
        encoded: Any = None
        drawn = Drawn(taken, job, Rendered(np.empty(0, np.uint8)), encoded, times, "", solved)
        info = drawn.info(Encoded(pictures, None, 0.0), times)
        data = pack_reply(request.frame_id, request.eyes, pictures, info)
        session.sending(request)
        session.sent(request, len(data))
        return parse_reply(data)

    def _posed(self, client: ClientStream) -> Reply:
        answer = self._answers._answer(client)
        if not isinstance(answer, PoseAnswer):
            client.session.failed(answer.request, answer.code, answer.message)
            raise RefusedError(answer.code, answer.message)
        (data,) = self._answers.pack(answer).messages
        client.session.sent(answer.request, len(data))
        return parse_reply(data)
