"""Export the participants' folders as tidy CSV tables, each with a JSON sidecar that describes its columns.

A row is participant x condition x measure; missing values have no row. Logs are read line by line; memory holds only
what the tables need. Sidecars follow BIDS (1.9, tabular files): per column Description, Units and Levels, and one key
``Study`` for analyses.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from glsplat.errors import FormatError
from glsplat.extras.study.design import Study
from glsplat.extras.study.plan import Plan, Step, label, steps_of
from glsplat.extras.study.questionnaires import Answer
from glsplat.extras.study.session import Event, Session
from glsplat.extras.study.store import FRAMES, SESSION, Log, folders, lines_of
from glsplat.io.files import naming, open_regular, replace_file

BEFORE = ".before"  # suffix of the measures of questionnaires before the first condition

Row = dict[str, Any]
_RUNNING = ("phase", "running")
_FIGURES = ("fps", "age_ms", "age_p95_ms")  # of the page's reports


@dataclass(frozen=True, slots=True)
class Exported:
    """Rows by file, and remarks about the data."""

    rows: Mapping[str, int]
    remarks: tuple[str, ...]


@dataclass(slots=True)
class _Person:
    """Data of a participant for the tables; ``add`` takes each event of the log in order."""

    number: int
    session: Session
    group: Mapping[str, str]
    last: float | None = None  # seconds of the last event
    opened: int = 0  # times that a server opened the session
    notes: int = 0
    torn: int = 0  # bytes at the log's end
    answer_times: dict[tuple[str, str], float | None] = field(default_factory=dict)  # seconds, by step and item
    begun: dict[str, float] = field(default_factory=dict)  # last start of a task, by step
    spans: dict[str, _Span] = field(default_factory=dict)  # finished tasks, by step

    @property
    def label(self) -> str:
        return label(self.number)

    def add(self, event: Event) -> None:
        self.session.replay(event)
        self.last = event.t
        self.opened += event.kind == "open"
        self.notes += event.kind == "note"
        if event.kind == "answer":
            self.answer_times[event.step, event.values["item"]] = event.values["seconds"]
        elif (event.kind, event.values.get("phase")) == _RUNNING:
            self.begun[event.step] = event.t
        elif event.kind == "done" and event.step in self.begun:
            self.spans[event.step] = _Span(self.begun[event.step], event.t, event.values["attempt"])


@dataclass(slots=True)
class _Span:
    """A task's last attempt, and the page's reports during it."""

    start: float  # seconds
    end: float
    attempt: int
    samples: int = 0
    values: Mapping[str, list[float]] = field(default_factory=lambda: {key: [] for key in _FIGURES})


def export(
    study: Study, plan: Plan, data: Path, out: Path, progress: Callable[[int, int], None] = lambda done, of: None
) -> Exported:
    """Write participants.csv, answers.csv, scores.csv and frames.csv with their sidecars into ``out``.

    Raises FormatError naming the file.
    """
    people: list[_Person] = []
    found = folders(data)
    for done, (number, folder) in enumerate(found.items(), 1):
        if number <= len(plan.orders):
            people.append(_read(study, plan, number, folder))
        progress(done, len(found))
    between = [factor.name for factor in study.factors if factor.between]
    place = ["participant", "position", "condition", *(factor.name for factor in study.factors)]
    answered = ["questionnaire", "item", "value", "reversed", "seconds"]
    tables: dict[str, tuple[list[str], list[Row]]] = {
        "participants": (
            ["participant", *between, "state", "steps", "of", "seconds", "restarts", "notes"],
            [_person(one) for one in people],
        ),
        "answers": (
            ["participant", "step", *place[1:], *answered],
            [row for one in people for row in _answers(study, one)],
        ),
        "scores": ([*place, "measure", "value"], [row for one in people for row in _scores(study, one)]),
        "frames": (
            [*place, "task", "attempt", "samples", *_FIGURES],
            [row for one in people for row in _frame_rows(study, one)],
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
            sidecar["Study"] = _study_fields(study, plan)
        replace_file(out / f"{name}.json", [json.dumps(sidecar, indent=1).encode() + b"\n"])
    return Exported({name: len(rows) for name, (_, rows) in tables.items()}, tuple(_remarks(people, plan)))


def _read(study: Study, plan: Plan, number: int, folder: Path) -> _Person:
    one = _Person(number, Session(study, steps_of(study, plan, number)), plan.groups[number - 1])
    log = Log(folder / SESSION)
    with naming(log.path):
        for event in log:
            one.add(event)
    one.torn = log.torn
    for line in _frames(folder / FRAMES):
        span = one.spans.get(line["step"])
        if span is not None and span.start <= line["t"] <= span.end:
            span.samples += 1
            for key, found in span.values.items():
                if isinstance(value := line["values"].get(key), int | float):
                    found.append(value)
    return one


def _person(one: _Person) -> Row:
    return {
        "participant": one.label,
        **one.group,
        "state": one.session.state.ended or "under way",
        "steps": one.session.state.at,
        "of": len(one.session.steps),
        "seconds": one.last,
        "restarts": max(0, one.opened - 1),
        "notes": one.notes,
    }


def _place(study: Study, one: _Person, step: Step) -> Row:
    levels = study.condition(step.condition).levels if step.condition else {}
    position = step.position or None
    return {"participant": one.label, "position": position, "condition": step.condition or None, **levels, **one.group}


def _questionnaires(one: _Person) -> Iterator[tuple[Step, Mapping[str, Answer], bool]]:
    """Yield questionnaires with answers in the order of steps, and whether they are finished."""
    for at, step in enumerate(one.session.steps):
        if step.kind == "questionnaire" and step.name in one.session.state.given:
            yield step, one.session.state.given[step.name], True
        elif step.kind == "questionnaire" and at == one.session.state.at:
            yield step, one.session.state.answers, False


def _answers(study: Study, one: _Person) -> Iterator[Row]:
    for step, answers, _ in _questionnaires(one):
        questionnaire = study.questionnaires[step.questionnaire]
        for item in questionnaire.items:
            if item.name in answers:
                yield _place(study, one, step) | {
                    "step": step.name,
                    "questionnaire": questionnaire.name,
                    "item": item.name,
                    "value": answers[item.name],
                    "reversed": int(item.reversed),
                    "seconds": one.answer_times.get((step.name, item.name)),
                }


def _scores(study: Study, one: _Person) -> Iterator[Row]:
    """Yield the scores of finished questionnaires; measures before the first condition end with BEFORE."""
    first = next(at for at, step in enumerate(one.session.steps) if step.condition)
    before = {step.name for step in one.session.steps[:first]}
    for step, answers, finished in _questionnaires(one):
        questionnaire = study.questionnaires[step.questionnaire]
        for score in questionnaire.scores:
            value = score.of(questionnaire, answers) if finished else None
            if value is not None:
                measure = f"{questionnaire.name}.{score.name}" + BEFORE * (step.name in before)
                yield _place(study, one, step) | {"measure": measure, "value": round(value, 6)}


def _frame_rows(study: Study, one: _Person) -> Iterator[Row]:
    """Yield frame rate and picture age for the last attempt of each finished task."""
    steps = {step.name: step for step in one.session.steps}
    for name, span in one.spans.items():
        yield (
            _place(study, one, steps[name])
            | {"task": steps[name].task, "attempt": span.attempt, "samples": span.samples}
            | {key: round(median(found), 2) if found else None for key, found in span.values.items()}
        )


def _frames(path: Path) -> Iterator[Row]:
    """Yield the valid lines of a file that is written without syncing."""
    if not path.exists():
        return
    with open_regular(path) as (file, _):
        for line in lines_of(file):
            try:
                fields = json.loads(line)
                good = isinstance(fields["values"], dict) and isinstance(fields["t"], int | float)
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
            if good and isinstance(fields.get("step"), str):
                yield fields


def _remarks(people: Sequence[_Person], plan: Plan) -> Iterator[str]:
    missing = len(plan.orders) - len(people)
    if missing:
        yield f"{missing} of {len(plan.orders)} participants have no data yet"
    for one in people:
        if one.session.state.ended != "done":
            state = one.session.state.ended or "under way"
            yield f"{one.label}: {state} at step {one.session.state.at + 1} of {len(one.session.steps)}"
        if one.torn:
            yield f"{one.label}: {one.torn} bytes at the end were torn off by a crash, and never acknowledged"


def _csv(keys: Sequence[str], rows: Iterable[Row]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, keys, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    """Return a cell's value: "" for None; a ' protects text that a spreadsheet would take for a formula."""
    if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r"):
        return f"'{value}"
    return "" if value is None else value


def _study_fields(study: Study, plan: Plan) -> dict[str, Any]:
    measures: dict[str, Any] = {}
    for name, one in study.questionnaires.items():
        for score in one.scores:
            scale = one[score.items[0]].scale
            measure = {
                "items": [f"{name}.{item}" for item in score.items],
                "reversed": [f"{name}.{item}" for item in score.reversed_items(one)],
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
    ends = {"done": "all steps", "declined": "no consent", "aborted": "by the experimenter"}
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
        "state": {"Description": "of the session", "Levels": ends | {"under way": "not at its end"}},
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
