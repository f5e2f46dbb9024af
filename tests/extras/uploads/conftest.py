"""A running server that takes photographs, and what a client says to it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from glsplat.avatar import Avatar
from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.routes import Uploads
from glsplat.net.backend import AvatarInfo
from glsplat.net.guard.access import Access
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.extras.uploads.makers import PICTURE, make
from tests.net.conftest import FakeBackend
from tests.net.wire import UNLIMITED

TOKEN = "0123456789abcdef"
HEADERS = {"Authorization": f"Bearer {TOKEN}"}
GUARD = 120.0  # seconds that only keep a test from hanging
LIMITS = replace(UNLIMITED, uploads=1e9, uploads_burst=1e9)
UNLIMITED_SESSION = SessionConfig(rate=1e9, burst=10**9, handshake=GUARD)


@dataclass
class Client:
    """A client with the token."""

    http: aiohttp.ClientSession
    server: Server
    folder: Path

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    async def post(self, data: Any = PICTURE, query: str = "?consent=yes", **more: Any) -> tuple[int, Any]:
        """Status, and the JSON or the line of the answer."""
        headers = HEADERS | more.pop("headers", {})
        if isinstance(data, bytes):
            headers = {"Content-Type": "image/jpeg"} | headers
        async with self.http.post(f"{self.origin}/avatars{query}", data=data, headers=headers, **more) as answer:
            return answer.status, (await answer.json() if answer.status == 202 else await answer.text())

    async def ask(self, method: str, path: str, headers: dict[str, str] = HEADERS) -> tuple[int, Any]:
        async with self.http.request(method, f"{self.origin}{path}", headers=headers) as answer:
            there = answer.content_type == "application/json"
            return answer.status, (await answer.json() if there else await answer.text())

    async def until(self, name: str, *states: str) -> dict[str, Any]:
        """What is told of a job once it is in one of ``states``."""
        end = time.monotonic() + GUARD
        while True:
            _, told = await self.ask("GET", f"/avatars/{name}")
            if isinstance(told, dict) and told["state"] in states:
                return told
            assert time.monotonic() < end, told
            await asyncio.sleep(0.02)

    async def job(self, data: Any, *states: str, **more: Any) -> dict[str, Any]:
        """What is told of a new job once it is in one of ``states``."""
        status, told = await self.post(data, **more)
        assert status == 202, told
        return await self.until(told["name"], *states)

    async def made(self, data: Any = PICTURE, **more: Any) -> str:
        """The name of an avatar that was made."""
        told = await self.job(data, "done", "failed", **more)
        assert told["state"] == "done"
        return str(told["name"])

    async def offered(self) -> list[str]:
        return [one["name"] for one in (await self.ask("GET", "/session"))[1]["avatars"]]

    async def received(self, count: int) -> None:
        """Until the pictures of so many jobs are on their way."""
        await until(lambda: self.counts()["receiving"] == count)

    def counts(self) -> Mapping[str, int]:
        return self.server.stats()["uploads"]

    def kept(self) -> list[str]:
        """Everything that lies in the folder."""
        return sorted(path.name for path in self.folder.iterdir())


async def until(true: Callable[[], object]) -> None:
    """It comes true."""
    end = time.monotonic() + GUARD
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


def described(name: str, avatar: Avatar) -> AvatarInfo:
    return AvatarInfo(name=name, skeleton=avatar.skeleton, made=name.startswith("photo-"))


Takes = Callable[..., AbstractAsyncContextManager[Client]]


@pytest.fixture
def takes(tmp_path: Path) -> Takes:
    """``async with takes(**of UploadConfig) as client``."""

    @asynccontextmanager
    async def serving(limits: Any = LIMITS, token: str | None = TOKEN, **options: Any) -> AsyncIterator[Client]:
        folder = tmp_path / "avatars"
        folder.mkdir(exist_ok=True)
        config = ServerConfig(port=0, access=Access(token=token), limits=limits, session=UNLIMITED_SESSION)
        # what makes need not give way to others: on a slow machine it would never end
        uploads = Uploads(UploadConfig(folder=folder, make=make, **{"nice": 0} | options), described)
        server = server_of(FakeBackend(), config, features=[uploads])
        await server.start()
        try:
            async with aiohttp.ClientSession() as http:
                yield Client(http, server, folder)
        finally:
            await server.stop()

    return serving
