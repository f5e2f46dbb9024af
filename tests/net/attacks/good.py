"""A well-behaved client: asks at its pace, acknowledges, answers pings, comes back politely if it is turned away."""

from __future__ import annotations

import asyncio
import struct
import time
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Any, NamedTuple

from glsplat.errors import ProtocolError
from glsplat.net.reply import parse_reply
from tests.net.attacks.requests import request
from tests.net.attacks.sockets import Target, frame, handshake

__all__ = ["GoodClient", "Service"]

_LONG = 0.02  # seconds there and back


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
    datagrams: bool = False  # takes the second way that it is offered, as over a long link
    arrivals: list[tuple[float, float]] = field(default_factory=list)  # monotonic seconds, age in ms
    losses: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    by_datagrams: list[float] = field(default_factory=list)  # those of the arrivals that came that way

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
        opening: asyncio.Task[None] | None = None
        talk.late = _LONG if self.datagrams else 0.0
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
                if (offer := self._arrived(talk, data)) is not None:
                    opening = asyncio.create_task(self._open(talk, offer))
        finally:
            for task in filter(None, (asking, opening)):
                task.cancel()
            writer.transport.abort()

    def _arrived(self, talk: _Talk, data: bytes, by_datagrams: bool = False) -> dict[str, str] | None:
        """Note a picture; the second way that it offers."""
        at, reply = time.monotonic(), parse_reply(data)
        if reply.frame_id > talk.newest:
            talk.newest, talk.age = reply.frame_id, (at - talk.asked[reply.frame_id]) * 1e3
            self.arrivals.append((at, talk.age))
            if by_datagrams:
                self.by_datagrams.append(at)
            talk.answered.set()
        offer: dict[str, str] | None = reply.info.get("datagrams")
        return offer

    async def _open(self, talk: _Talk, offer: dict[str, str]) -> None:
        """Take an offer; the server sees a link as long as that of the WebSocket."""
        from tests.net.datagrams.client import open_path  # here: aioquic may not be installed

        def take(data: bytes) -> None:
            self._arrived(talk, data, by_datagrams=True)

        path: Any = None
        try:
            path = await open_path(f"ws://{self.target.host}:{self.target.port}/ws", offer, take)
            path.send = partial(asyncio.get_running_loop().call_later, talk.late, path.send)
            await path.ended
        except (OSError, TimeoutError):  # as in a browser: all goes on over the WebSocket
            pass
        finally:
            if path is not None:
                path.close()

    async def _ask(self, talk: _Talk) -> None:
        frame_id, start = 0, time.monotonic()
        while True:
            frame_id += 1
            pose = {"root_pose": [0, frame_id / 30, 0]}
            talk.asked[frame_id] = time.monotonic()
            talk.writer.write(frame(0x1, self._request(frame_id, pose, talk)))
            if self.hertz is None:
                talk.answered.clear()
                await talk.answered.wait()
            else:
                await asyncio.sleep(max(0.0, start + frame_id / self.hertz - time.monotonic()))

    def _request(self, frame_id: int, pose: dict[str, Any], talk: _Talk) -> bytes:
        told = {"datagrams": True, "arrival": {"age": talk.age} if talk.newest else None} if self.datagrams else {}
        return request(frame_id, (self.size,) * 2, pose=pose, ack=talk.newest, want=self.want, **told)


class _Talk:
    """One WebSocket of the good client."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.newest = 0  # frame_id that arrived last
        self.age = 0.0  # ms of that picture
        self.late = 0.0  # seconds by which pings are answered late
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
                    asyncio.get_running_loop().call_later(self.late, self.writer.write, frame(0xA, data))
                case 0x1:
                    raise ProtocolError(data.decode()[:200], "error")
                case 0x8:
                    raise ProtocolError(f"closed {data[:2].hex()} {data[2:].decode(errors='replace')}", "closed")
