"""A study in Chromium: scripts go through it in VR and on the flat page, servers are killed, browsers closed."""

from __future__ import annotations

import csv
import json
import resource
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from glsplat.extras.study.design import read_study
from glsplat.extras.study.export import export
from glsplat.extras.study.plan import checked_plan, label, make_plan, write_plan
from glsplat.extras.study.store import SESSION, Log
from tests.browser.conftest import OpenPage
from tests.browser.opened import Opened
from tests.browser.study.scripted import Scripted, Service, wire
from tests.browser.vr import pose, steer

GONE = [r"Failed to load resource", r"WebSocket", r"ERR_CONNECTION"]  # what a browser says of a server that is killed


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = wire(tmp_path, seconds=0.5)
    write_plan(tmp_path / "data", make_plan(read_study(path)))
    return path


@pytest.fixture
def service(study: Path) -> Iterator[Service]:
    one = Service(study, 1)
    one.start()
    yield one
    one.stop()


class Mind:
    """Answers that tell steps and items apart."""

    def __init__(self, participant: int) -> None:
        self.participant = participant
        self.names: dict[str, str] = {}  # of steps in the log, by what the page calls them
        self.given: dict[tuple[str, str], float] = {}

    def __call__(self, step: str, item: dict[str, Any]) -> float:
        number = int(step[:3]) * 7 + len(item["name"]) + self.participant
        value = item["from"] + item["step"] * (number % (round((item["to"] - item["from"]) / item["step"]) + 1))
        return self.given.setdefault((self.names.get(step, step), item["name"]), float(value))


def table(folder: Path, name: str) -> list[dict[str, str]]:
    with open(folder / f"{name}.csv", newline="") as file:
        return list(csv.DictReader(file))


def test_from_plan_to_tables(open_page: OpenPage, study: Path) -> None:
    """Two people: one in VR whose server is killed in a task, one on the flat page whose browser is closed.

    Each condition has the view that the server says; pictures of the second one are shown later by its latency.
    """
    cells, views = (("self", "ours"), ("other", "video")), ("facing", "mirror", "mirror")
    study = wire(study.parent, participants=2, seconds=2.0, cells=cells, views=views)
    data = study.parent / "shorter"
    write_plan(data, make_plan(read_study(study)))
    minds = {number: Mind(number) for number in (1, 2)}
    held: dict[str, float] = {}  # milliseconds from arrival to display, by view

    def conditions(page: Opened, now: dict[str, Any]) -> bool:
        if now["state"].get("phase") == "running":
            stats = page.stats()
            assert now["state"]["condition"] == {"view": stats["view"], "latency": 100 * (stats["view"] == "mirror")}
            if None not in (stats["ageMs"], stats["rttMs"]):
                held[stats["view"]] = stats["ageMs"] - stats["rttMs"]
        return now["state"]["number"] >= 5 and len(now["state"].get("answers", {})) == 1

    for number, mind in minds.items():
        service = Service(study, number, data=data)
        service.start()
        mind.names = service.names()
        assert service.links is not None
        page = open_page(service.links["participant"], allow=GONE)

        script = Scripted(page, mind, vr=number == 1, pinch=True)
        script.enter()
        if number == 1:
            script.hook = lambda now: now["state"]["number"] >= 4 and now["state"].get("phase") == "running"
            assert not script.run(90)
            service.kill()
            page.wait(0.5)
            service.start()
        else:
            script.hook = partial(conditions, page)
            assert not script.run(90)
            page.page.close()
            script.page = open_page(service.links["participant"], allow=GONE)
            script.enter()
        script.hook = lambda now: False
        assert script.run(90)
        service.stop()
    assert held["mirror"] > 80 and held["facing"] < held["mirror"] - 30
    done = export(read_study(study), checked_plan(data, read_study(study)), data, study.parent / "tables")
    assert not done.remarks
    rows = table(study.parent / "tables", "answers")
    given = {(label(n), *key): value for n, mind in minds.items() for key, value in mind.given.items()}
    assert len(rows) == len(given) == 2 * (2 * 3 + 6)
    assert {(r["participant"], r["step"], r["item"]): float(r["value"]) for r in rows} == given
    people = table(study.parent / "tables", "participants")
    assert [(one["state"], one["restarts"]) for one in people] == [("done", "1"), ("done", "0")]
    frames = [row for row in table(study.parent / "tables", "frames") if row["participant"] == label(1)]
    assert len(frames) == 2
    tracked = [json.loads(line) for line in (data / label(1) / "tracking.jsonl").read_text().splitlines()]
    assert tracked and {line["kind"] for line in tracked} == {"tracking"}
    assert all(line["values"]["head"][1] == pytest.approx(1.65) for line in tracked)


def test_a_newer_page_takes_over_speaks_instructions_once_and_is_stopped(
    study: Path, service: Service, open_page: OpenPage
) -> None:
    assert service.links is not None
    heard = "window.heard = []; speechSynthesis.speak = (said) => window.heard.push(said.text);"
    first = open_page(service.links["participant"], allow=[r"409"])
    first.until("window.glsplat?.study?.().state")
    page = open_page(service.links["participant"], init=heard)
    first.until("window.glsplat.study().elsewhere")
    assert "another page" in first.js("document.querySelector('#status').textContent")
    script = Scripted(page, Mind(1), vr=False, hook=lambda now: now["state"].get("kind") == "task")
    script.enter()
    assert page.js("window.heard") == []  # the consent is read
    script.run(30)
    watch = open_page(service.links["experimenter"])
    watch.until("window.glsplat.study()?.number === 2 && window.glsplat.study().present")
    watch.page.click("#pause")
    page.until("window.glsplat.study().state.paused")
    watch.page.fill("#note", "the cable was loose")
    watch.page.click("#note-form button")
    watch.until("document.querySelectorAll('#notes li').length === 1")
    watch.page.click("#pause")
    script.hook = lambda now: now["state"].get("phase") == "running"
    script.run(30)
    assert page.js("window.heard") == ["Wave with your right arm."]
    script.hook = lambda now: now["state"].get("kind") == "questionnaire"
    script.run(30)
    watch.until("!document.querySelector('#picture').hidden && document.querySelector('#picture').naturalWidth > 0")
    watch.page.click("summary:has-text('Abort')")
    watch.page.fill("#reason", "the participant felt sick")
    watch.page.click("#abort-form button")
    page.until("window.glsplat.study().state.ended === 'aborted'")
    log = list(Log(study.parent / "data" / label(1) / SESSION))
    assert [e.kind for e in log if e.kind in ("pause", "note", "continue", "abort")] == [
        "pause", "note", "continue", "abort",
    ]  # fmt: skip


def test_by_keyboard_in_a_narrow_window_and_on_a_full_disk(study: Path, service: Service, open_page: OpenPage) -> None:
    """320 pixels: nothing is wider than the window, and every step can be done by Tab, Space, arrows and Enter."""
    assert service.links is not None and service.process is not None
    page = open_page(service.links["participant"], size=(320, 640), allow=GONE)
    page.until("document.querySelector('#agree')")
    keyboard = page.page.keyboard
    page.page.focus("#agree")
    keyboard.press("Enter")
    page.until("document.activeElement.id === 'ready'")  # the focus follows
    keyboard.press("Enter")
    page.until("window.glsplat.study().item === 'owned'", 20)
    assert page.js("document.documentElement.scrollWidth") <= 320
    unlabelled = "[...document.querySelectorAll('#step input')].filter((i) => !i.labels?.length && !i.ariaLabel).length"
    assert page.js(unlabelled) == 0
    tops = "new Set([...document.querySelectorAll('.points label')].map((e) => e.getBoundingClientRect().top)).size"
    assert page.js(tops) == 1  # seven points are one line, the ends' words below its ends
    page.page.focus("input[name=answer]")
    keyboard.press("Space")
    keyboard.press("ArrowRight")
    assert page.js("document.querySelector('input[name=answer]:checked').value") == "2"
    page.page.focus("#next")
    keyboard.press("Enter")
    page.until("window.glsplat.study().item === 'strange' && !window.glsplat.study().saving")
    log = list(Log(study.parent / "data" / label(1) / SESSION))
    assert [e.values["value"] for e in log if e.kind == "answer"][-1] == 2
    # the answer stays on the page, which says so and tries again; a page that is reloaded meanwhile still has it
    script = Scripted(page, Mind(1), vr=False)
    path = study.parent / "data" / label(1) / SESSION
    before, unlimited = path.read_bytes(), (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (len(before), resource.RLIM_INFINITY))
    assert script.press("value:3")
    page.until("document.querySelector('#saved')?.textContent.startsWith('Not saved yet')")
    page.page.reload()
    page.until("window.glsplat?.study?.().state && window.glsplat.study().saving")
    assert page.js("document.querySelector('input[name=answer]:checked')?.value ?? window.glsplat.study().item") in (
        "3",
        "liked",
    )
    assert path.read_bytes() == before
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, unlimited)
    page.until("!window.glsplat.study().saving")
    assert list(Log(path))[-1].values == {"item": "strange", "value": 3, "seconds": pytest.approx(0, abs=60)}


def test_nobody_looks_out_of_their_own_head(tmp_path: Path, open_page: OpenPage) -> None:
    """In the view of one's own body the head is left out, which the backend shows as red."""
    study = wire(tmp_path, seconds=3, cells=(("self", "ours"), ("other", "ours")), views=("own", "own", "own"))
    write_plan(tmp_path / "data", make_plan(read_study(study)))
    service = Service(study, 1)
    service.start()
    assert service.links is not None
    page = open_page(service.links["participant"], allow=GONE)
    script = Scripted(page, Mind(1), hook=lambda now: now["state"].get("phase") == "running")
    script.enter()
    script.run(60)
    look_down = pose([0, 1.65, 0], pitch=-60)
    steer(page, head=look_down)

    def red() -> bool:
        page.frames(2)
        eye = page.eye("left")[..., :3].reshape(-1, 3).astype(int)
        return bool((eye[:, 0] - eye[:, 1:].max(1) > 100).mean() > 0.02)

    page.meanwhile(red, 30)
    service.stop()
