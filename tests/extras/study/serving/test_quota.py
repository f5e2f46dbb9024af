"""What a participant's link may append: a rate and a size, said in the answer, and never in the way of the session."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from glsplat.extras.study.serving import live
from glsplat.extras.study.store import FRAMES, SESSION, Log
from tests.extras.study.serving.client import OTHER, PAGE, Client, Clock, run, until

FIGURES = {"fps": 50.0, "age_ms": 30.0, "session": "vr"}


async def answered(client: Client, item: str, value: int) -> int:
    """Status of an answer to an item of the questionnaire in hand."""
    return (await client.do("answer", step=(await client.state())["step"], item=item, value=value))[0]


async def refused(client: Client, what: str, page: str = PAGE, **more: Any) -> tuple[int, str, int | None]:
    """Status, code and Retry-After of a refusal."""
    url = f"http://127.0.0.1:{client.server.port}/study/do"
    headers = {"X-Glsplat-Study": client.lead.secrets["participant"], "Authorization": "Bearer 0123456789abcdef"}
    async with client.http.post(url, json={"do": what, "page": page, **more}, headers=headers) as answer:
        wait = answer.headers.get("Retry-After")
        code = (await answer.json())["error"]["code"] if answer.status >= 400 else ""
        return answer.status, code, None if wait is None else int(wait)


def test_answers_that_come_too_fast_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Changed back and forth without end: 429 with the time to wait; what was acknowledged is what the log has."""
    monkeypatch.setattr(live, "BURST_BYTES", 8000)
    monkeypatch.setattr(live, "RATE_BYTES_S", 100.0)
    clock = Clock()

    async def test(client: Client) -> None:
        await client.begin()
        step = (await client.state())["step"]
        kept, count = [], 0
        while True:
            value = 5 * (count % 2)
            status, code, wait = await refused(client, "answer", step=step, item="mental", value=value)
            if status != 200:
                break
            kept.append(value)
            count += 1
            assert count < 200
        assert (status, code) == (429, "rate") and count > 20
        for _ in range(20):
            again = await refused(client, "answer", step=step, item="effort", value=5)
            assert again == (429, "rate", wait)  # trying costs nothing
        found = [e.values["value"] for e in Log(client.live.store.folder / SESSION) if e.kind == "answer"]
        assert found == kept and (await client.state())["answers"] == {"mental": kept[-1]}
        # the experimenter is not held up by it
        assert (await client.post("command", {"do": "note", "text": "x"}, "experimenter"))[0] == 200
        assert wait is not None and wait > 0
        clock.now += wait
        assert await answered(client, "effort", 5) == 200
        clock.now += 100
        await client.answer_all()

    run(tmp_path, test, clock=clock)


def test_a_full_log_takes_what_leads_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No answer is changed, no task begun anew by another page; the session is finished all the same."""
    monkeypatch.setattr(live, "MAX_LOG_BYTES", 100)
    clock = Clock()

    async def test(client: Client) -> None:
        await client.begin()
        step = (await client.state())["step"]
        assert await answered(client, "mental", 5) == 200
        assert await refused(client, "answer", step=step, item="mental", value=10) == (413, "full", None)
        assert await answered(client, "mental", 5) == 200  # sent again
        assert (await client.state())["answers"] == {"mental": 5}
        await client.answer_all_but("mental")
        state = await client.state()
        assert (state["kind"], state["phase"]) == ("task", "instruction")
        assert (await client.do("enter", OTHER))[0] == 200  # nothing is under way: nothing is written
        assert (await client.do("enter"))[0] == 200
        assert (await client.do("ready", step=state["step"]))[0] == 200
        assert await refused(client, "enter", OTHER) == (413, "full", None)
        assert (await client.state())["phase"] == "countdown"
        for _ in range(40):
            state = await client.state()
            if state["ended"]:
                break
            if state["kind"] == "questionnaire":
                await client.answer_all()
            elif state["kind"] == "task" and state["phase"] == "instruction" and state["ready"]:
                await client.do("ready", step=state["step"])
            else:
                clock.now += 4.5
                client.live.touch()
                await until(lambda: client.live.session.left(client.live.t) != 0)
        assert state["ended"] == "done"

    run(tmp_path, test, clock=clock)


def test_figures_are_written_twice_a_second_at_most(tmp_path: Path) -> None:
    clock = Clock()

    async def test(client: Client) -> None:
        await client.begin()
        await client.answer_all()
        for _ in range(30):
            assert (await client.post("state", {"page": PAGE, "after": -1, "figures": FIGURES}))[0] == 200
        clock.now += 1
        await client.post("state", {"page": PAGE, "after": -1, "figures": FIGURES})

    run(tmp_path, test, clock=clock)
    lines = [json.loads(line) for line in (tmp_path / "data/sub-001" / FRAMES).read_text().splitlines()]
    assert len(lines) == 2 and lines[1]["t"] == lines[0]["t"] + 1
