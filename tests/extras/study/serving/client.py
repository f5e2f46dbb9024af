"""A study's server for tests: its page, its experimenter, and time that they let pass."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp

from glsplat.extras.study.serving.lead import HEADER, StudyLead
from glsplat.extras.study.serving.live import Live
from glsplat.extras.study.store import SESSION, Log
from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.guard.access import Access
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import Request
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.skinning.pose import Pose
from tests.extras.study.designs import planned
from tests.net.conftest import FakeBackend
from tests.net.wire import UNLIMITED

__all__ = ["OTHER", "PAGE", "Client", "Clock", "run", "served", "until"]

PAGE, OTHER = "0123456789abcdef", "fedcba9876543210"
TOKEN = "0123456789abcdef"


class Solver:
    """Keeps what it is asked."""

    def __init__(self) -> None:
        self.requests: list[Request] = []

    def solve(self, request: Request, now: float) -> Solved:
        self.requests.append(request)
        return Solved(Pose.zero(55))


class Client:
    """A page, the experimenter, or somebody else."""

    def __init__(self, http: aiohttp.ClientSession, server: Server, lead: StudyLead, solver: Solver) -> None:
        self.http, self.server, self.lead, self.live, self.solver = http, server, lead, lead.live, solver

    async def post(
        self, path: str, message: Any, who: str = "participant", secret: str | None = None
    ) -> tuple[int, Any]:
        """Status and JSON, or text."""
        headers = {HEADER: self.lead.secrets[who] if secret is None else secret, "Authorization": f"Bearer {TOKEN}"}
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        url = f"http://127.0.0.1:{self.server.port}/study/{path}"
        async with self.http.post(url, data=data, headers=headers) as answer:
            if answer.content_type == "image/jpeg":
                return answer.status, await answer.read()
            there = answer.content_type == "application/json"
            return answer.status, (await answer.json() if there else await answer.text())

    async def do(self, what: str, page: str = PAGE, **more: Any) -> tuple[int, Any]:
        return await self.post("do", {"do": what, "page": page, **more})

    async def state(self) -> Any:
        return (await self.post("state", {"page": PAGE}))[1]

    async def answer_all(self) -> None:
        await self.answer_all_but()

    async def answer_all_but(self, *names: str) -> None:
        """Answer and hand in the questionnaire; ``names`` have their answers."""
        state = await self.state()
        for item in state["items"]:
            if item["name"] in names:
                continue
            value = {"choice": item["labels"][:1], "text": ["words"]}.get(item["kind"], [item.get("from")])[0]
            assert (await self.do("answer", step=state["step"], item=item["name"], value=value))[0] == 200
        assert (await self.do("submit", step=state["step"]))[0] == 200

    async def begin(self) -> None:
        """Past consent."""
        await self.do("enter")
        assert (await self.do("consent", step="001-consent", accepted=True))[0] == 200

    def log(self) -> list[str]:
        return [event.kind for event in Log(self.live.store.folder / SESSION)]

    @asynccontextmanager
    async def socket(self, query: str) -> AsyncIterator[aiohttp.ClientWebSocketResponse]:
        url = f"ws://127.0.0.1:{self.server.port}/ws{query}"
        async with self.http.ws_connect(url, headers={"Authorization": f"Bearer {TOKEN}"}) as ws:
            yield ws


class Clock:
    """Time that tests let pass."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@asynccontextmanager
async def serving(
    folder: Path,
    clock: Callable[[], float] = time.monotonic,
    wall: Callable[[], float] = time.time,
    limits: Limits = UNLIMITED,
    participant: int = 1,
    **more: Any,  # of ServerConfig
) -> AsyncIterator[Client]:
    study, plan = planned(folder)
    live = Live(study, plan, participant, folder / "data", clock, wall)
    lead, solver = StudyLead(live, {"fast": "avatar-fast", "slow": "avatar-slow"}), Solver()
    offered = [AvatarInfo(name=name, solver=lambda height, span: solver) for name in ("avatar-fast", "avatar-slow")]
    config = ServerConfig(port=0, access=Access(token=TOKEN), limits=limits, **more)
    server = server_of(FakeBackend(), config, offered, [lead])
    await server.start()
    try:
        async with aiohttp.ClientSession() as http:
            yield Client(http, server, lead, solver)
    finally:
        await server.stop()


def run(folder: Path, test: Callable[[Client], Awaitable[None]], **options: Any) -> None:
    async def whole() -> None:
        async with serving(folder, **options) as client:
            await test(client)

    asyncio.run(whole())


def served(**options: Any) -> Callable[[Callable[[Client], Awaitable[None]]], Callable[[Path], None]]:
    """Make a test of a coroutine function that takes a client of a server with these ``options``."""

    def made(test: Callable[[Client], Awaitable[None]]) -> Callable[[Path], None]:
        def whole(tmp_path: Path) -> None:
            run(tmp_path, test, **options)

        whole.__name__, whole.__doc__, whole.__module__ = test.__name__, test.__doc__, test.__module__
        return whole

    return made


async def until(true: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)
