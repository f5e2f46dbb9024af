"""A well-behaved client: asks at its pace, acknowledges, answers pings, comes back politely if it is turned away."""

from __future__ import annotations

import asyncio
import struct
import time
from dataclasses import dataclass, field
from statistics import median
from typing import Any, NamedTuple

from glsplat.errors import ProtocolError
from glsplat.net.reply import parse_reply
from tests.net.attacks.requests import request
from tests.net.attacks.sockets import Target, frame, handshake

__all__ = ["GoodClient", "Service"]


class Service(NamedTuple):
    """What a client got in some span of time."""

    rate: float  # pictures a second
    age: float  # median milliseconds from a picture's request to its arrival; infinite if none came
    losses: int = 0  # connections that ended or were refused

    def against(self, undisturbed: Service) -> tuple[float, float]:
        """Rate and age as ratios."""
        return self.rate / max(undisturbed.rate, 1e-9), self.age / undisturbed.age


@dataclass
class GoodClient:
    """A task runs ``run``, ``over`` measures. ``hertz`` None: the next request when a picture has come."""

    target: Target
    size: int = 128
    hertz: float | None = 5.0
    want: str | None = None  # "pose": it draws itself
    arrivals: list[tuple[float, float]] = field(default_factory=list)  # monotonic seconds, age in ms
    losses: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    async def over(self, seconds: float) -> Service:
        """What it gets in the seconds to come."""
        start = time.monotonic()
        await asyncio.sleep(seconds)
        end = time.monotonic()
        return self.between(start, end)

    def between(self, start: float, end: float) -> Service:
        """What it got from one moment to another."""
        ages = [age for at, age in self.arrivals if start <= at < end]
        lost = sum(start <= at < end for at in self.losses)
        return Service(len(ages) / (end - start), median(ages) if ages else float("inf"), lost)

    async def run(self) -> None:
        """Until cancelled. A lost connection is made anew after a quarter of a second."""
        while True:
            try:
                await self._visit()
            except (OSError, EOFError, ProtocolError, TimeoutError) as error:
                self.losses.append(time.monotonic())
                self.errors.append(f"{type(error).__name__}: {error}")
            await asyncio.sleep(0.25)

    async def _visit(self) -> None:
        reader, writer = await asyncio.open_connection(
            self.target.host, self.target.port, local_addr=(self.target.source, 0)
        )
        talk = _Talk(reader, writer)
        asking: asyncio.Task[None] | None = None
        try:
            async with asyncio.timeout(60):
                writer.write(handshake(self.target))
                head = await reader.readuntil(b"\r\n\r\n")
            if b" 101 " not in head.partition(b"\r\n")[0]:
                raise ProtocolError(head.partition(b"\r\n")[0].decode("latin-1"), "refused")
            asking = asyncio.create_task(self._ask(talk))
            while True:
                async with asyncio.timeout(60):
                    data = await talk.message()
                at = time.monotonic()
                reply = parse_reply(data)
                talk.newest = reply.frame_id
                self.arrivals.append((at, (at - talk.asked[reply.frame_id]) * 1e3))
                talk.answered.set()
        finally:
            if asking is not None:
                asking.cancel()
            writer.transport.abort()

    async def _ask(self, talk: _Talk) -> None:
        frame_id, start = 0, time.monotonic()
        while True:
            frame_id += 1
            pose = {"root_pose": [0, frame_id / 30, 0]}
            talk.asked[frame_id] = time.monotonic()
            talk.writer.write(frame(0x1, self._request(frame_id, pose, talk.newest)))
            if self.hertz is None:
                talk.answered.clear()
                await talk.answered.wait()
            else:
                await asyncio.sleep(max(0.0, start + frame_id / self.hertz - time.monotonic()))

    def _request(self, frame_id: int, pose: dict[str, Any], newest: int) -> bytes:
        return request(frame_id, (self.size,) * 2, pose=pose, ack=newest, want=self.want)


class _Talk:
    """One WebSocket of the good client."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.newest = 0  # frame_id that arrived last
        self.asked: dict[int, float] = {}
        self.answered = asyncio.Event()

    async def message(self) -> bytes:
        """The next binary message. Raises ProtocolError for the server's errors and for its close."""
        while True:
            first, second = await self.reader.readexactly(2)
            length = second & 127
            if length >= 126:
                size = 2 if length == 126 else 8
                (length,) = struct.unpack("!H" if size == 2 else "!Q", await self.reader.readexactly(size))
            data = await self.reader.readexactly(length)
            match first & 15:
                case 0x2:
                    return data
                case 0x9:
                    self.writer.write(frame(0xA, data))
                case 0x1:
                    raise ProtocolError(data.decode()[:200], "error")
                case 0x8:
                    raise ProtocolError(f"closed {data[:2].hex()} {data[2:].decode(errors='replace')}", "closed")
