"""A session that is under way: time, restarts, full disks, and what a condition changes of a picture."""

from __future__ import annotations

import asyncio
import errno
import json
import os
from collections.abc import Sequence
from pathlib import Path

import aiohttp
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.study.serving.lead import dim
from glsplat.extras.study.serving.live import PAGE_TIMEOUT_S, resumed_at
from glsplat.extras.study.session import Event
from glsplat.extras.study.store import SESSION, TRACKING, Log, Store
from glsplat.net.reply import parse_reply
from tests.extras.study.serving.client import PAGE, Client, Clock, run, until

SAMPLE = {"head": [0, 1.6, 0, 0, 0, 0, 1], "left": [-0.3, 1, 0, 0, 0, 0, 1], "right": [0.3, 1, 0, 0, 0, 0, 1]}
EYES = {
    "eyes": [{"viewmat": [1, 0, 0, 0, 0, -1, 0, 1.6, 0, 0, -1, 0, 0, 0, 0, 1], "K": [32, 32, 16, 16]}] * 2,
    "size": [32, 32],
}


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
        status, said = await client.do("answer", step="002-questionnaire", item="mental", value=5)
        assert status == 507 and str(tmp_path) not in json.dumps(said)  # files are the experimenter's business
        state = await client.state()
        assert state["answers"] == {} and state["trouble"] is True
        watched = (await client.post("watch", {}, "experimenter"))[1]
        assert "No space left on device" in watched["trouble"]
        monkeypatch.undo()
        assert (await client.do("answer", step="002-questionnaire", item="mental", value=5))[0] == 200
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
        clock.now += PAGE_TIMEOUT_S + 1  # silence
        await until(lambda: client.live.session.state.phase == "instruction")
        assert client.live.session.state.attempt == 2
        clock.now += 10_000
        await asyncio.sleep(0.3)
        assert client.live.session.step.alias == state["step"] and client.log()[-1] == "lost"

    run(tmp_path, test, clock=clock)


def test_a_clock_that_leaps() -> None:
    """The wall clock says how long a server was away; where it was set meanwhile, time still does not run backwards."""
    opened = Event(0.0, "x", "open", {"wall": "2027-01-15T08:00:00+00:00"})
    for away, expected in ((3600, 3600), (0, 100), (-1e6, 100), (1e12, 100), (float("nan"), 100)):
        assert resumed_at(100.0, opened, 1800000000 + away) == expected


def test_a_restart_goes_on_in_time(tmp_path: Path) -> None:
    async def test(client: Client) -> None:
        await client.do("enter")

    run(tmp_path, test, clock=Clock(), wall=lambda: 1.8e9)
    run(tmp_path, test, clock=Clock(), wall=lambda: 1.8e9 + 60)
    run(tmp_path, test, clock=Clock(), wall=lambda: 1.8e9 - 60)  # set back
    opened = [e.t for e in Log(tmp_path / "data/sub-001" / SESSION) if e.kind == "open"]
    assert opened == [0, 60, 60]


@pytest.mark.check
def test_a_condition_is_applied_to_the_client(tmp_path: Path) -> None:
    """The avatar whatever was asked for; hands to the solver or not, recorded all the same; put out at its end."""

    async def test(client: Client) -> None:
        await client.begin()
        await client.answer_all()
        order = client.live.session.steps
        for condition in (order[2].condition, order[6].condition):
            avatar, hands = {"fast": ("avatar-fast", True), "slow": ("avatar-slow", False)}[condition]
            client.solver.requests.clear()
            async with client.socket(f"?study={PAGE}&avatar=avatar-fast&room=nowhere") as ws:
                await ws.send_json({"v": 1, "frame_id": 1, "tracking": SAMPLE, "t": 5, **EYES})
                reply = parse_reply((await ws.receive(20)).data)
                pixels = reply.images()[0].reshape(-1, 3)
                grey = np.median(pixels[pixels.max(1) > 25], axis=0) / 51.0  # what the backend draws
                light = np.array([1, 1, 1] if condition == "fast" else [0.5, 0.25, 1.0])
                assert np.abs(grey - light ** (1 / 2.2)).max() < 0.15
                (stream,) = client.server.clients.values()
                assert stream.shown.name == avatar
                sample = client.solver.requests[-1].tracking
                assert (sample.left is not None, sample.right is not None) == (hands, hands) and sample.head
                status, picture = await client.post("picture", {}, "experimenter")
                assert status == 200 and picture[:2] == b"\xff\xd8"
                async with asyncio.timeout(30):
                    while (await client.state())["kind"] == "task":
                        if client.live.session.state.phase == "instruction":
                            await client.do("ready", step=client.live.session.step.alias)
                        clock.now += 3  # of the page's silence fewer than PAGE_TIMEOUT_S
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


def test_light_is_a_factor_of_light() -> None:
    """Bytes by the display's curve, alpha and full channels untouched; premultiplied edges keep their colour."""
    images = np.random.default_rng(3).integers(0, 256, (2, 5, 7, 4), np.uint8)
    before = images.copy()
    dim(images, (0.5, 1.0, 0.0))
    assert (images[..., 1] == before[..., 1]).all() and (images[..., 3] == before[..., 3]).all()
    assert (images[..., 2] == 0).all()
    assert np.abs(images[..., 0] / 255 - (0.5 * (before[..., 0] / 255) ** 2.2) ** (1 / 2.2)).max() <= 0.5 / 255 + 1e-12


def test_a_disk_that_was_full_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    append, full = Store.append, [True]

    def tried(self: Store, events: Sequence[Event]) -> None:
        if full[0]:
            raise FormatError(f"{self.folder}: No space left on device")
        append(self, events)

    monkeypatch.setattr(Store, "append", tried)

    async def test(client: Client) -> None:
        for _ in range(2):
            status, said = await client.do("enter")
            assert status == 507 and str(tmp_path) not in str(said)
        assert "No space left" in str((await client.post("watch", {}, "experimenter"))[1])
        full[0] = False
        await client.begin()
        assert client.log().count("open") == 1 and client.log()[-1] == "begin"

    run(tmp_path, test)
