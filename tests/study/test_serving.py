"""A study's server, from outside: who may do what, what a hostile page gets, and what a full disk does."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest

from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.guard.access import Access
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import Request
from glsplat.net.reply import parse_reply
from glsplat.net.server import Server, ServerConfig
from glsplat.skinning.pose import Pose
from glsplat.study.serving.lead import HEADER, StudyLead
from glsplat.study.serving.light import dim
from glsplat.study.serving.live import GONE, Live, resumed_at
from glsplat.study.session import Event
from glsplat.study.store import SESSION, TRACKING, Store, read_log
from tests.net.conftest import FakeBackend
from tests.net.wire import UNLIMITED
from tests.study.designs import planned

PAGE, OTHER = "0123456789abcdef", "fedcba9876543210"
TOKEN = "0123456789abcdef"
SAMPLE = {"head": [0, 1.6, 0, 0, 0, 0, 1], "left": [-0.3, 1, 0, 0, 0, 0, 1], "right": [0.3, 1, 0, 0, 0, 0, 1]}
EYES = {
    "eyes": [{"viewmat": [1, 0, 0, 0, 0, -1, 0, 1.6, 0, 0, -1, 0, 0, 0, 0, 1], "K": [32, 32, 16, 16]}] * 2,
    "size": [32, 32],
}


class Solver:
    """Keeps what it is asked."""

    def __init__(self) -> None:
        self.requests: list[Request] = []

    def solve(self, request: Request, now: float) -> Solved:
        self.requests.append(request)
        return Solved(Pose.zero(55), request.cameras)


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
        state = await self.state()
        for item in state["items"]:
            value = {"choice": item["labels"][:1], "text": ["words"]}.get(item["kind"], [item.get("from")])[0]
            assert (await self.do("answer", step=state["step"], item=item["name"], value=value))[0] == 200
        assert (await self.do("submit", step=state["step"]))[0] == 200

    async def begin(self) -> None:
        """Past consent."""
        await self.do("enter")
        assert (await self.do("consent", step="001-consent", accepted=True))[0] == 200

    def log(self) -> list[str]:
        return [event.kind for event in read_log(self.live.store.folder / SESSION).events]

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
) -> AsyncIterator[Client]:
    study, plan = planned(folder)
    live = Live(study, plan, 1, Store(folder / "data", 1), clock, wall)
    lead, solver = StudyLead(live, {"fast": "a", "slow": "b"}), Solver()
    offered = [AvatarInfo(name=name, solver=lambda height, span: solver) for name in ("a", "b")]
    config = ServerConfig(port=0, access=Access(token=TOKEN), limits=limits)
    server = Server(FakeBackend(), config, offered, lead=lead)
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


async def until(true: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)


def test_nobody_without_their_own_secret(tmp_path: Path) -> None:
    async def test(client: Client) -> None:
        for path in ("state", "do", "watch", "command", "picture"):
            needed = "participant" if path in ("state", "do") else "experimenter"
            other = "experimenter" if needed == "participant" else "participant"
            for secret in ("", "x", "é", client.lead.secrets[other], client.lead.secrets[needed][:-1]):
                status, said = await client.post(path, {"do": "enter", "page": PAGE}, secret=secret)
                assert (status, said["error"]["code"]) == (403, "not_allowed")
        await until(client.log)  # the session is opened beside the first requests
        assert client.log() == ["open", "begin"]
        async with client.http.post(f"http://127.0.0.1:{client.server.port}/study/do", json={}) as answer:
            assert answer.status == 401  # the server's own token comes first

    run(tmp_path, test)


def test_a_quick_participant_does_not_keep_the_experimenter_out(tmp_path: Path) -> None:
    """Of one address: what comes with a secret costs as much as a file of the page, what guesses one a whole visit."""

    async def test(client: Client) -> None:
        await client.begin()
        for count in range(60):
            assert (await client.post("command", {"do": "note", "text": f"{count}"}, "experimenter"))[0] == 200
            assert (await client.post("state", {"page": PAGE, "after": -1}))[0] == 200
        guesses = 0
        while (await client.post("watch", {}, secret="x"))[0] == 403:
            guesses += 1
        assert guesses < 50 - 0.1 * 120

    run(tmp_path, test, limits=Limits(visits=0.001))


@pytest.mark.parametrize(
    "message",
    [b"", b"[]", b"null", b"{", b"\xff", b"[" * 40_000, b'{"do": 1}', b'{"do": "enter"}', b'{"do": "enter", "page": 7}',
     b'{"do": "enter", "page": "../../etc/passwd"}', b'{"do": "enter", "page": "short"}', b'{"do": "submit"}'],
)  # fmt: skip
def test_no_message(tmp_path: Path, message: bytes) -> None:
    async def test(client: Client) -> None:
        status, said = await client.post("do", message)
        assert status in (400, 409) and said["error"]["message"]
        assert client.log() == ["open", "begin"]

    run(tmp_path, test)


def test_a_hostile_page_changes_nothing(tmp_path: Path) -> None:
    """Wrong steps, answers out of range, of other kinds, after the end, a megabyte, and all of it twice."""

    async def test(client: Client) -> None:
        await client.begin()
        before = client.log()
        step = "002-nasa-tlx"
        wrong = [
            *[
                ("answer", {"step": step, "item": "mental", "value": v}, 422)
                for v in (-5, 3, 105, "5", None, True, [5], {"x": 5})
            ],
            ("answer", {"step": step, "item": "__class__", "value": 5}, 422),
            ("answer", {"step": step, "item": ["mental"], "value": 5}, 422),
            ("answer", {"step": "011-own", "item": "sex", "value": "one"}, 409),
            ("answer", {"step": "../002-nasa-tlx", "item": "mental", "value": 5}, 409),
            ("submit", {"step": step}, 422),
            ("ready", {"step": step}, 409),
            ("consent", {"step": step, "accepted": True}, 409),
            ("consent", {"step": "001-consent", "accepted": "yes"}, 400),
            ("pause", {"step": step}, 400),
            ("abort", {"step": step}, 400),
        ]
        for what, more, expected in wrong * 2:
            status, said = await client.do(what, **more)
            assert status == expected and set(said["error"]) == {"code", "message"}, (what, more)
        assert (await client.do("consent", step="001-consent", accepted=False))[0] == 200  # it is past: nothing changes
        assert (await client.do("answer", OTHER, step=step, item="mental", value=5))[0] == 409
        for size in (50_000, 1_000_000):
            try:
                status, _ = await client.do("answer", step=step, item="mental", value="x" * size)
            except aiohttp.ClientError:
                status = 0  # cut off
            assert status in (0, 400, 413)
        for text in ("x" * 10_001, "", 5, None, ["x"]):
            assert (await client.post("command", {"do": "note", "text": text}, "experimenter"))[0] == 422
        for what in ("delete", None, ["note"], {"a": 1}):
            assert (await client.post("command", {"do": what}, "experimenter"))[0] == 400
        assert client.log() == before
        await client.answer_all()
        assert client.log()[-2:] == ["submit", "begin"]

    run(tmp_path, test)


def test_two_at_once_are_one_after_the_other(tmp_path: Path) -> None:
    """A hundred answers and submits at the same moment: each is written once, none after the step."""

    async def test(client: Client) -> None:
        await client.begin()
        items = [item["name"] for item in (await client.state())["items"]]
        doing = [client.do("answer", step="002-nasa-tlx", item=item, value=50) for item in items * 10]
        await asyncio.gather(*doing)
        await asyncio.gather(*[client.do("submit", step="002-nasa-tlx") for _ in range(20)])
        kinds = client.log()
        assert kinds.count("answer") == 6 and kinds.count("submit") == 1

    run(tmp_path, test)


def test_of_two_pages_the_newer_counts(tmp_path: Path) -> None:
    async def test(client: Client) -> None:
        assert (await client.post("state", {"page": PAGE}))[1]["error"]["code"] == "enter"
        await client.begin()
        assert (await client.do("enter", OTHER))[0] == 200
        for path in ("state", "do"):
            status, said = await client.post(path, {"page": PAGE, "do": "submit", "step": "002-nasa-tlx"})
            assert (status, said["error"]["code"]) == (409, "elsewhere")
        assert (await client.do("enter"))[0] == 200
        assert (await client.do("answer", step="002-nasa-tlx", item="mental", value=5))[0] == 200

    run(tmp_path, test)


def test_a_full_disk_is_not_acknowledged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page is told, the state stays, the experimenter reads why; and once there is room it goes on."""

    async def test(client: Client) -> None:
        await client.begin()
        own = client.live.store._file
        write = os.write

        def full(file: int, data: bytes) -> int:
            if file == own:
                raise OSError(errno.ENOSPC, "No space left on device")
            return write(file, data)

        monkeypatch.setattr(os, "write", full)
        status, said = await client.do("answer", step="002-nasa-tlx", item="mental", value=5)
        assert status == 507 and str(tmp_path) not in json.dumps(said)  # files are the experimenter's business
        state = await client.state()
        assert state["answers"] == {} and state["trouble"] is True
        watched = (await client.post("watch", {}, "experimenter"))[1]
        assert "No space left on device" in watched["trouble"]
        monkeypatch.undo()
        assert (await client.do("answer", step="002-nasa-tlx", item="mental", value=5))[0] == 200
        assert (await client.state())["trouble"] is False
        assert client.log().count("answer") == 1

    run(tmp_path, test)


def test_time_passes_while_the_page_is_there(tmp_path: Path) -> None:
    clock = Clock()

    async def test(client: Client) -> None:
        await client.begin()
        await client.answer_all()
        state = await client.state()
        assert (state["kind"], state["phase"]) == ("task", "instruction")
        await client.do("ready", step=state["step"])
        assert client.live.session.state.phase == "countdown"
        clock.now += 3.1
        await until(lambda: client.live.session.state.phase == "running")
        clock.now += GONE + 1  # silence
        await until(lambda: client.live.session.state.phase == "instruction")
        assert client.live.session.state.attempt == 2
        clock.now += 10_000
        await asyncio.sleep(0.3)
        assert client.live.session.step.name == state["step"] and client.log()[-1] == "lost"

    run(tmp_path, test, clock=clock)


@pytest.mark.parametrize(("away", "expected"), [(3600, 3600), (0, 100), (-1e6, 100), (1e12, 100), (float("nan"), 100)])
def test_a_clock_that_leaps(away: float, expected: float) -> None:
    """The wall clock says how long a server was away; where it was set meanwhile, time still does not run backwards."""
    log = [Event(0.0, "x", "open", {"wall": "2027-01-15T08:00:00+00:00"}), Event(100.0, "x", "note", {"text": "x"})]
    assert resumed_at(log, 1800000000 + away) == expected


def test_a_restart_goes_on_in_time(tmp_path: Path) -> None:
    async def test(client: Client) -> None:
        await client.do("enter")

    run(tmp_path, test, clock=Clock(), wall=lambda: 1.8e9)
    run(tmp_path, test, clock=Clock(), wall=lambda: 1.8e9 + 60)
    run(tmp_path, test, clock=Clock(), wall=lambda: 1.8e9 - 60)  # set back
    opened = [e.t for e in read_log(tmp_path / "data/sub-001" / SESSION).events if e.kind == "open"]
    assert opened == [0, 60, 60]


def test_only_the_participants_page_is_shown_anything(tmp_path: Path) -> None:
    async def test(client: Client) -> None:
        async def refused(query: str) -> int:
            try:
                async with client.socket(query):
                    return 101
            except aiohttp.WSServerHandshakeError as error:
                return error.status

        assert await refused("") == await refused(f"?study={PAGE}") == 403
        await client.begin()
        assert await refused(f"?study={PAGE}") == 403  # a questionnaire before all conditions
        await client.answer_all()
        assert await refused("") == await refused(f"?study={OTHER}") == 403
        assert await refused(f"?study={PAGE}") == 101

    run(tmp_path, test)


def test_a_condition_is_applied_to_the_client(tmp_path: Path) -> None:
    """The avatar whatever was asked for; hands to the solver or not, recorded all the same; put out at its end."""

    async def test(client: Client) -> None:
        await client.begin()
        await client.answer_all()
        order = client.live.session.steps
        for condition in (order[2].condition, order[6].condition):
            avatar, hands = {"fast": ("a", True), "slow": ("b", False)}[condition]
            client.solver.requests.clear()
            async with client.socket(f"?study={PAGE}&avatar=a&room=nowhere") as ws:
                await ws.send_json({"v": 1, "frame_id": 1, "tracking": SAMPLE, "t": 5, **EYES})
                reply = parse_reply((await ws.receive(20)).data)
                pixels = reply.images()[0].reshape(-1, 3)
                grey = np.median(pixels[pixels.max(1) > 25], axis=0) / 51.0  # what the backend draws
                light = np.array([1, 1, 1] if condition == "fast" else [0.5, 0.25, 1.0])
                assert np.abs(grey - light ** (1 / 2.2)).max() < 0.15
                (channel,) = client.server._channels.values()
                assert channel.shown.name == avatar
                sample = client.solver.requests[-1].tracking
                assert (sample.left is not None, sample.right is not None) == (hands, hands) and sample.head
                status, picture = await client.post("picture", {}, "experimenter")
                assert status == 200 and picture[:2] == b"\xff\xd8"
                async with asyncio.timeout(30):
                    while (await client.state())["kind"] == "task":
                        if client.live.session.state.phase == "instruction":
                            await client.do("ready", step=client.live.session.step.name)
                        clock.now += 3  # of the page's silence fewer than GONE
                        await asyncio.sleep(0.15)
                await client.answer_all()
                ended = await ws.receive(20)
                assert ended.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSING)
                assert ws.close_code == 1001
            if client.live.session.step.kind == "rest":
                clock.now += 2.1
                await client.state()
                await until(lambda: client.live.session.step.kind == "task")

    clock = Clock()
    run(tmp_path, test, clock=clock)
    lines = [json.loads(line) for line in (tmp_path / "data/sub-001" / TRACKING).read_text().splitlines()]
    assert len(lines) == 2 and {line["kind"] for line in lines} == {"tracking"}
    assert all(line["values"]["left"] == [-0.3, 1, 0, 0, 0, 0, 1] for line in lines)


def test_secrets_stay_over_a_restart(tmp_path: Path) -> None:
    found = []

    async def test(client: Client) -> None:
        found.append(client.lead.secrets)

    run(tmp_path, test)
    run(tmp_path, test)
    assert found[0] == found[1] and found[0]["participant"] != found[0]["experimenter"]
    assert (tmp_path / "data/sub-001/keys.json").stat().st_mode & 0o077 == 0


def test_light_is_a_factor_of_light() -> None:
    """Bytes by the display's curve, alpha and full channels untouched; premultiplied edges keep their colour."""
    images = np.random.default_rng(3).integers(0, 256, (2, 5, 7, 4), np.uint8)
    before = images.copy()
    dim(images, (0.5, 1.0, 0.0))
    assert (images[..., 1] == before[..., 1]).all() and (images[..., 3] == before[..., 3]).all()
    assert (images[..., 2] == 0).all()
    assert np.abs(images[..., 0] / 255 - (0.5 * (before[..., 0] / 255) ** 2.2) ** (1 / 2.2)).max() <= 0.5 / 255 + 1e-12
