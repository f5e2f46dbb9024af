"""A client of a server that offers datagrams."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import aiohttp

from glsplat.net.reply import parse_reply
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.extras.far_links.datagrams.client import open_path
from tests.net.wire import native, until

CONFIG = ServerConfig(port=0, session=SessionConfig(adapt=True), webtransport=True)


class Viewer:
    """A client: asks, acknowledges, says when pictures arrive, and opens what it is offered where it is told to."""

    def __init__(self, server: Server, ws: aiohttp.ClientWebSocketResponse, wants: bool) -> None:
        self.server, self.ws, self.wants = server, ws, wants
        self.newest = 0
        self.frames: list[tuple[int, bool]] = []  # ids, and whether by datagrams
        self.offers: list[dict[str, str]] = []
        self.infos: list[dict[str, Any]] = []
        self.asks: dict[str, Any] = {}
        self.errors: list[str] = []
        self.path: Any = None
        self._number, self._asks = 0, asyncio.Event()
        self._asks.set()
        self._tasks = [asyncio.create_task(self._read()), asyncio.create_task(self._ask())]

    def take(self, data: bytes, by_datagrams: bool) -> None:
        reply = parse_reply(data)
        self.newest = max(self.newest, reply.frame_id)
        self.frames.append((reply.frame_id, by_datagrams))
        self.infos.append(reply.info)
        if (offer := reply.info.get("datagrams")) is not None:
            self.offers.append(offer)

    async def open(self) -> Any:
        await until(lambda: self.offers)
        self.path = await open_path(self.server.url, self.offers[-1], lambda data: self.take(data, True))
        return self.path

    def by_datagrams(self) -> int:
        return sum(by for _, by in self.frames)

    async def more(self, count: int, by_datagrams: bool = False) -> None:
        """Until so many more have come, the last of them that way."""
        before = len(self.frames)
        await until(lambda: sum(by == by_datagrams for _, by in self.frames[before:]) >= count)

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self.path is not None:
            self.path.close()

    async def _read(self) -> None:
        async for message in self.ws:
            if message.type == aiohttp.WSMsgType.BINARY:
                self.take(message.data, False)
            else:
                self.errors.append(str(message.data))

    def pause(self) -> None:
        """Ask for nothing until ``go_on``."""
        self._asks.clear()

    def go_on(self) -> None:
        """Ask for one after the other."""
        self._asks.set()

    async def once(self) -> None:
        """Ask for one picture."""
        self._number += 1
        told: dict[str, Any] = {"ack": self.newest}
        told |= {"arrival": {"age": 20.0}} if self.newest else {}
        told |= {"datagrams": True} if self.wants else {}
        await self.ws.send_str(native(self._number, **told, **self.asks))

    async def _ask(self) -> None:
        while await self._asks.wait():
            await self.once()
            await asyncio.sleep(0.01)


@asynccontextmanager
async def viewing(server: Server, wants: bool = True) -> AsyncIterator[Viewer]:
    async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        viewer = Viewer(server, ws, wants)
        try:
            yield viewer
        finally:
            await viewer.close()


def ways(server: Server) -> Any:
    return server.stats()["clients"][0]["datagrams"]
