"""A whole study by scripts in Chromium with the fake headset, from plan to tables; by hand, some 20 minutes.

    python -m tools.study.whole FOLDER [--participants 24] [--real 2]

Answers are drawn from known effects. On the way two servers are killed (in a task, in a questionnaire) and one browser
is closed (in a task). It fails where an answer is lost, is there twice or is another one, and prints what is recovered.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from glsplat.extras.study.design import read_study
from glsplat.extras.study.export import export
from glsplat.extras.study.plan import checked_plan, label, make_plan, write_plan
from tests import needs
from tests.browser.conftest import _FLAGS
from tests.browser.opened import FAKE_XR, WATCH, Opened
from tests.browser.study.scripted import Scripted, Service, wire

EFFECTS = {"self": 0.6, "other": -0.6, "ours": 0.9, "video": -0.2, "image": -0.7}  # points of ownership
MIDDLE, SPREAD, PERSON = 4.0, 0.7, 0.6  # the mean, and standard deviations within and between people


def drawn(participant: int, condition: str, item: str, rng: np.random.Generator, person: float) -> float:
    """What somebody thinks: points 1 to 7, or a slider in steps of 5."""
    effect = sum(EFFECTS[part] for part in condition.split("-")) if condition else 0.0
    value = MIDDLE + effect + person + rng.normal(0, SPREAD)
    if item == "liked" or not condition:
        return float(np.clip(round(value * 100 / 7 / 5) * 5, 0, 100))
    points = float(np.clip(round(value), 1, 7))
    return 8 - points if item == "strange" else points


class Mind:
    """One participant's answers, each drawn once."""

    def __init__(self, participant: int) -> None:
        self.rng = np.random.default_rng([41, participant])
        self.participant, self.person = participant, float(self.rng.normal(0, PERSON))
        self.names: dict[str, str] = {}  # of steps in the log, by what the page calls them
        self.given: dict[tuple[str, str], float] = {}

    def __call__(self, step: str, item: dict[str, Any]) -> float:
        step = self.names[step]
        key = (step, item["name"])
        if key not in self.given:
            condition = step[4:].removesuffix("-asked") if step.endswith("-asked") else ""
            self.given[key] = drawn(self.participant, condition, item["name"], self.rng, self.person)
        return self.given[key]


def session(
    study: Path, participant: int, opened: Callable[[str], tuple[Any, Opened]], real: bool, trouble: str
) -> tuple[Mind, float]:
    """One participant from consent to end, with one ``trouble`` on the way."""
    begun = time.monotonic()
    mind = Mind(participant)
    service = Service(study, participant, _real if real else None)
    service.start()
    mind.names = service.names()
    try:
        _go_through(service, mind, opened, trouble)
    finally:
        service.stop()
    return mind, time.monotonic() - begun


def _go_through(service: Service, mind: Mind, opened: Callable[[str], tuple[Any, Opened]], trouble: str) -> None:
    assert service.links is not None
    context, page = opened(service.links["participant"])
    done = False

    def hook(now: dict[str, Any]) -> bool:
        state = now["state"]
        if done or not trouble or state["number"] < 6:
            return False
        running = state.get("phase") == "running"
        asked = state.get("kind") == "questionnaire" and len(state["answers"]) == 1
        return running if trouble in ("kill-task", "browser") else asked

    script = Scripted(page, mind, True, hook)
    script.enter()
    if not script.run(600):
        done = True
        if trouble == "browser":
            context.close()
            context, page = opened(service.links["participant"])
            script = Scripted(page, mind, True)
            script.enter()
        else:
            service.kill()
            page.wait(1.0)
            service.start()
        print(f"  {label(service.participant)}: {trouble}", flush=True)
        assert script.run(600)
    context.close()


def _real(service: Service) -> list[str]:
    """The command that people use."""
    words = [
        "-m",
        "apps.cli",
        "study",
        "run",
        "--data",
        str(service.data),
        str(service.study),
        str(service.participant),
    ]
    (service.data / "server.toml").write_text("without-consent = true")
    return [*words, "--port", str(service.port), "--json", "--config", str(service.data / "server.toml")]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--participants", type=int, default=24)
    parser.add_argument("--real", type=int, default=2, help="first participants who get real pictures")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    path = wire(args.folder, args.participants)
    study, data = read_study(path), args.folder / "data"
    write_plan(data, make_plan(study))
    troubles = {5: "kill-task", 11: "kill-answers", 17: "browser"}
    minds = {}
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=_FLAGS)

        def opened(address: str) -> tuple[Any, Opened]:
            context = browser.new_context(viewport={"width": 800, "height": 500})
            for script in (FAKE_XR, WATCH):
                context.add_init_script(script)
            page = Opened(context.new_page())
            page.page.goto(address)
            return context, page

        for number in range(1, args.participants + 1):
            minds[number], seconds = session(path, number, opened, number <= args.real, troubles.get(number, ""))
            print(f"{label(number)}: {len(minds[number].given)} answers, {seconds:.0f} s", flush=True)
        browser.close()
    out = args.folder / "tables"
    done = export(study, checked_plan(data, study), data, out)
    print(json.dumps({"rows": done.rows, "remarks": done.remarks}))
    return compare(out, minds)


def compare(out: Path, minds: dict[int, Mind]) -> int:
    """0 where every answer is there once, as it was given."""
    with open(out / "answers.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    found = {(row["participant"], row["step"], row["item"]): float(row["value"]) for row in rows}
    given = {(label(n), *key): value for n, mind in minds.items() for key, value in mind.given.items()}
    lost, odd = given.keys() - found.keys(), [key for key in given.keys() & found.keys() if given[key] != found[key]]
    twice = len(rows) - len(found)
    print(f"{len(given)} answers given, {len(rows)} rows, {len(lost)} lost, {twice} twice, {len(odd)} changed")
    with open(out / "scores.csv", newline="") as file:
        scores = [row for row in csv.DictReader(file) if row["measure"] == "asked.ownership"]
    for factor in ("type", "method"):
        for level in dict.fromkeys(row[factor] for row in scores):
            values = [float(row["value"]) for row in scores if row[factor] == level]
            around = MIDDLE + EFFECTS[level]
            print(f"  ownership, {level}: {np.mean(values):.2f} of {len(values)}, drawn around {around:.2f}")
    return int(bool(lost or odd or len(rows) != len(found) or len(rows) != len(given)))


if __name__ == "__main__":
    sys.exit(main())
