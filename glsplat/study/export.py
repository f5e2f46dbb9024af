"""From the participants' folders to tidy tables: a CSV each with a sidecar in JSON that says what its columns are.

Rows are participant x condition x measure; what is missing has no row. The sidecars follow BIDS (1.9, tabular files):
a key a column with Description, Units and Levels, and one key ``Study`` for analyses.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from glsplat.errors import FormatError
from glsplat.io.files import naming, replace_file
from glsplat.study.design import Study
from glsplat.study.plan import Plan, label
from glsplat.study.questionnaires import Answer
from glsplat.study.session import Session
from glsplat.study.steps import Step, steps_of
from glsplat.study.store import FRAMES, SESSION, Log, folders, read_log

__all__ = ["BEFORE", "Exported", "export"]

BEFORE = ".before"
"""Behind the measures of questionnaires that come before the first condition."""

Row = dict[str, Any]
_RUNNING = ("phase", "running")


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: rows by file, and what has to be known of the data."""

    rows: Mapping[str, int]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Person:
    number: int
    log: Log
    session: Session
    group: Mapping[str, str]
    frames: tuple[Row, ...]

    @property
    def label(self) -> str:
        return label(self.number)


def export(
    study: Study, plan: Plan, data: Path, out: Path, progress: Callable[[int, int], None] = lambda done, of: None
) -> Exported:
    """Write participants.csv, answers.csv, scores.csv and frames.csv with their sidecars into the folder ``out``.

    Raises FormatError naming the file that cannot be read or written.
    """
    people: list[_Person] = []
    found = folders(data)
    for done, (number, folder) in enumerate(found.items(), 1):
        if number <= len(plan.orders):
            log = read_log(folder / SESSION)
            with naming(folder / SESSION):
                session = Session(study, steps_of(study, plan, number), log.events)
            people.append(_Person(number, log, session, plan.groups[number - 1], tuple(_frames(folder / FRAMES))))
        progress(done, len(found))
    factors = [factor.name for factor in study.factors]
    place = ["participant", "position", "condition", *factors]
    tables: dict[str, tuple[list[str], list[Row]]] = {
        "participants": (
            [
                "participant",
                *(f.name for f in study.factors if f.between),
                "state",
                "steps",
                "of",
                "seconds",
                "restarts",
                "notes",
            ],
            [_person(one) for one in people],
        ),
        "answers": (
            ["participant", "step", *place[1:], "questionnaire", "item", "value", "reversed", "seconds"],
            [row for one in people for row in _answers(study, one)],
        ),
        "scores": ([*place, "measure", "value"], [row for one in people for row in _scores(study, one)]),
        "frames": (
            [*place, "task", "attempt", "samples", "fps", "age_ms", "age_p95_ms"],
            [row for one in people for row in _shown(study, one)],
        ),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"{out}: cannot be made ({error.strerror or error})") from None
    columns = _columns(study)
    for name, (keys, rows) in tables.items():
        replace_file(out / f"{name}.csv", [_csv(keys, rows)])
        sidecar: dict[str, Any] = {key: columns[key] for key in keys}
        if name == "scores":
            sidecar["Study"] = _described(study, plan)
        replace_file(out / f"{name}.json", [json.dumps(sidecar, indent=1).encode() + b"\n"])
    return Exported({name: len(rows) for name, (_, rows) in tables.items()}, tuple(_remarks(people, plan)))


def _person(one: _Person) -> Row:
    events = one.log.events
    opened = sum(event.kind == "open" for event in events)
    return {
        "participant": one.label,
        **one.group,
        "state": one.session.state.ended or "under way",
        "steps": one.session.state.at,
        "of": len(one.session.steps),
        "seconds": events[-1].t if events else None,
        "restarts": max(0, opened - 1),
        "notes": sum(event.kind == "note" for event in events),
    }


def _place(study: Study, one: _Person, step: Step) -> Row:
    levels = study.condition(step.condition).levels if step.condition else {}
    position = step.position or None
    return {"participant": one.label, "position": position, "condition": step.condition or None, **levels, **one.group}


def _questioned(one: _Person) -> Iterator[tuple[Step, Mapping[str, Answer], bool]]:
    """Questionnaires with their answers, in the order of steps, and whether they are finished."""
    for at, step in enumerate(one.session.steps):
        if step.kind == "questionnaire" and step.name in one.session.state.given:
            yield step, one.session.state.given[step.name], True
        elif step.kind == "questionnaire" and at == one.session.state.at:
            yield step, one.session.state.answers, False


def _answers(study: Study, one: _Person) -> Iterator[Row]:
    took = {(e.step, e.values["item"]): e.values["seconds"] for e in one.log.events if e.kind == "answer"}
    for step, answers, _ in _questioned(one):
        questionnaire = study.questionnaires[step.questionnaire]
        for item in questionnaire.items:
            if item.name in answers:
                yield _place(study, one, step) | {
                    "step": step.name,
                    "questionnaire": questionnaire.name,
                    "item": item.name,
                    "value": answers[item.name],
                    "reversed": int(item.reversed),
                    "seconds": took.get((step.name, item.name)),
                }


def _scores(study: Study, one: _Person) -> Iterator[Row]:
    """Of finished questionnaires; where one comes before and after, its measure says so."""
    first = next(at for at, step in enumerate(one.session.steps) if step.condition)
    before = {step.name for step in one.session.steps[:first]}
    for step, answers, finished in _questioned(one):
        questionnaire = study.questionnaires[step.questionnaire]
        for score in questionnaire.scores:
            value = score.of(questionnaire, answers) if finished else None
            if value is not None:
                measure = f"{questionnaire.name}.{score.name}" + BEFORE * (step.name in before)
                yield _place(study, one, step) | {"measure": measure, "value": round(value, 6)}


def _shown(study: Study, one: _Person) -> Iterator[Row]:
    """Frame rate and age of pictures for each task that was done, in its last attempt."""
    steps = {step.name: step for step in one.session.steps}
    spans: dict[str, tuple[float, float, int]] = {}
    begun: dict[str, float] = {}
    for event in one.log.events:
        if (event.kind, event.values.get("phase")) == _RUNNING:
            begun[event.step] = event.t
        elif event.kind == "done" and event.step in begun:
            spans[event.step] = (begun[event.step], event.t, event.values["attempt"])
    for name, (start, end, attempt) in spans.items():
        lines = [line for line in one.frames if line["step"] == name and start <= line["t"] <= end]
        values = {
            key: [v for line in lines if (v := line["values"].get(key)) is not None]
            for key in ("fps", "age_ms", "age_p95_ms")
        }
        yield (
            _place(study, one, steps[name])
            | {"task": steps[name].task, "attempt": attempt, "samples": len(lines)}
            | {key: round(median(found), 2) if found else None for key, found in values.items()}
        )


def _frames(path: Path) -> Iterator[Row]:
    """The lines of a file that is written without waiting for the disk: what is torn or odd is left out."""
    if not path.exists():
        return
    for line in path.read_bytes().splitlines():
        try:
            fields = json.loads(line)
            if isinstance(fields["values"], dict) and isinstance(fields["t"], int | float):
                yield fields
        except (ValueError, KeyError, TypeError, RecursionError):
            continue


def _remarks(people: Sequence[_Person], plan: Plan) -> Iterator[str]:
    missing = len(plan.orders) - len(people)
    if missing:
        yield f"{missing} of {len(plan.orders)} participants have no data yet"
    for one in people:
        if one.session.state.ended != "done":
            state = one.session.state.ended or "under way"
            yield f"{one.label}: {state} at step {one.session.state.at + 1} of {len(one.session.steps)}"
        if one.log.torn:
            yield f"{one.label}: {one.log.torn} bytes at the end were torn off by a crash, and never acknowledged"


def _csv(keys: Sequence[str], rows: Iterable[Row]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, keys, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    """Empty for None; words that a spreadsheet would take for a formula keep a ' in front."""
    if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r"):
        return f"'{value}"
    return "" if value is None else value


def _described(study: Study, plan: Plan) -> dict[str, Any]:
    measures: dict[str, Any] = {}
    for name, one in study.questionnaires.items():
        for score in one.scores:
            scale = one[score.items[0]].scale
            measure = {
                "items": [f"{name}.{item}" for item in score.items],
                "reversed": [f"{name}.{item}" for item in score.against(one)],
                "range": [scale.low, scale.high],
                "how": score.how,
                "text": score.text or score.name,
            }
            if name in study.each or name in study.after:
                measures[f"{name}.{score.name}"] = measure
            if name in study.before:
                measures[f"{name}.{score.name}{BEFORE}"] = measure
    factors = {f.name: {"levels": list(f.levels), "kind": "between" if f.between else "within"} for f in study.factors}
    return {"name": study.name, "title": study.title, "planned": len(plan.orders), "digest": plan.digest} | {
        "factors": factors,
        "measures": measures,
    }


def _columns(study: Study) -> dict[str, dict[str, Any]]:
    questionnaires = {name: f"{one.title}. {one.source}" for name, one in study.questionnaires.items()}
    conditions = {
        one.name: f"{one.avatar}, {one.view}, light {one.light}, {one.latency:g} ms added" for one in study.conditions
    }
    return {
        "participant": {"Description": "pseudonym; the folder of the data"},
        "position": {"Description": "of the condition in the participant's order, from 1; empty outside conditions"},
        "condition": {"Description": "what was seen and driven", "Levels": conditions},
        **{
            factor.name: {
                "Description": f"factor {'between' if factor.between else 'within'} participants",
                "Levels": {level: level for level in factor.levels},
            }
            for factor in study.factors
        },
        "state": {
            "Description": "of the session",
            "Levels": {
                "done": "all steps",
                "declined": "no consent",
                "aborted": "by the experimenter",
                "under way": "not at its end",
            },
        },
        "steps": {"Description": "finished"},
        "of": {"Description": "steps in all"},
        "restarts": {"Description": "times that a server took the session up again"},
        "notes": {"Description": "of the experimenter; their words are in session.jsonl"},
        "step": {"Description": "of the session, numbered"},
        "questionnaire": {"Description": "name of the instrument", "Levels": questionnaires},
        "item": {"Description": "name of the item; its text is in plan.json"},
        "value": {
            "Description": "the answer as given, or the score; scores count reversed items as low + high - value"
        },
        "reversed": {"Description": "1: scores count low + high - value"},
        "seconds": {"Description": "until the answer, or of the session", "Units": "s"},
        "measure": {"Description": "questionnaire.score; its items are under Study.measures"},
        "task": {"Description": "name of the task", "Levels": {task.name: task.text for task in study.tasks}},
        "attempt": {"Description": "the one that counts, from 1; earlier ones were cut short or repeated"},
        "samples": {"Description": "reports of the page during the task, one a second"},
        "fps": {"Description": "pictures a second shown, median of the reports", "Units": "1/s"},
        "age_ms": {"Description": "of pictures when they are shown, the added latency included, median", "Units": "ms"},
        "age_p95_ms": {"Description": "95 % quantile of the age, median of the reports", "Units": "ms"},
    }
