"""A well-behaved client: asks at its pace, acknowledges, answers pings, comes back politely if it is turned away."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import aiohttp

from glsplat.errors import ProtocolError
from glsplat.net.reply import parse_reply
from tests.net.attacks.requests import request
from tests.net.attacks.sockets import Target

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
            except (OSError, aiohttp.ClientError, ProtocolError, TimeoutError) as error:
                self.losses.append(time.monotonic())
                self.errors.append(f"{type(error).__name__}: {error}")
            await asyncio.sleep(0.25)

    async def _visit(self) -> None:
        url = f"http://{self.target.host}:{self.target.port}/ws"
        connector = aiohttp.TCPConnector(local_addr=(self.target.source, 0))
        async with (
            aiohttp.ClientSession(connector=connector) as http,
            http.ws_connect(url, autoping=False, max_msg_size=0) as ws,
        ):
            talk = _Talk(ws, _LONG if self.datagrams else 0.0)
            tasks = [asyncio.create_task(self._ask(talk))]
            try:
                while True:
                    message = await ws.receive(60)
                    if message.type == aiohttp.WSMsgType.BINARY:
                        if (offer := self._arrived(talk, message.data)) is not None:
                            tasks.append(asyncio.create_task(self._open(talk, offer)))
                    elif message.type == aiohttp.WSMsgType.PING:
                        tasks.append(asyncio.create_task(talk.pong(message.data)))
                    else:
                        raise ProtocolError(f"{message.type.name} {message.data!r:.200} {message.extra}", "closed")
            finally:
                for task in tasks:
                    task.cancel()

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
        from tests.extras.far_links.datagrams.client import open_path  # here: aioquic may not be installed

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
            await talk.ws.send_str(self._request(frame_id, pose, talk).decode())
            if self.hertz is None:
                talk.answered.clear()
                await talk.answered.wait()
            else:
                await asyncio.sleep(max(0.0, start + frame_id / self.hertz - time.monotonic()))

    def _request(self, frame_id: int, pose: dict[str, Any], talk: _Talk) -> bytes:
        told = {"datagrams": True, "arrival": {"age": talk.age} if talk.newest else None} if self.datagrams else {}
        return request(frame_id, (self.size,) * 2, pose=pose, ack=talk.newest, want=self.want, **told)


@dataclass
class _Talk:
    """One WebSocket of the good client."""

    ws: aiohttp.ClientWebSocketResponse
    late: float  # seconds by which pings are answered late
    newest: int = 0  # frame_id that arrived last
    age: float = 0.0  # ms of that picture
    asked: dict[int, float] = field(default_factory=dict)
    answered: asyncio.Event = field(default_factory=asyncio.Event)

    async def pong(self, data: bytes) -> None:
        await asyncio.sleep(self.late)
        await self.ws.pong(data)
