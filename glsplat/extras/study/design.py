"""The design of a study, read from ``study.toml``. Immutable values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args

from glsplat.errors import FormatError
from glsplat.extras.study.questionnaires import Questionnaire, questionnaire_of
from glsplat.extras.study.tables import Table, is_number, read_toml

MAX_PARTICIPANTS = 999  # participant numbers have three digits

View = Literal["mirror", "facing", "own"]
_CONDITION_KEYS = ("view", "light", "latency", "hands")
_RESERVED_COLUMNS = "participant condition position measure value step item questionnaire seconds reversed".split()


@dataclass(frozen=True, slots=True)
class Factor:
    """A factor of the design. ``between``: each participant has one level, else all levels."""

    name: str
    levels: tuple[str, ...]
    between: bool = False


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of the design: the avatar with its view, light, latency and control."""

    name: str
    levels: Mapping[str, str]  # by within-subject factor
    avatar: str  # "default", an embedded person, or a file; {participant} stands for sub-007
    view: View = "mirror"
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factor on the baked light, linear RGB
    latency: float = 0.0  # milliseconds added to each picture
    hands: bool = True  # False: only the head drives the avatar

    def file(self, participant: str) -> str:
        """Return the avatar's file for one participant."""
        return self.avatar.replace("{participant}", participant)


@dataclass(frozen=True, slots=True)
class Task:
    """A participant's activity for ``seconds`` after reading or hearing ``text``."""

    name: str
    text: str
    seconds: float
    speak: bool = True
    ready: bool = True  # wait until the participant is ready, else for ``reading`` seconds
    reading: float = 6.0
    countdown: int = 3  # seconds


@dataclass(frozen=True, slots=True)
class Order:
    """Order of conditions (plan.py). ``block``: a factor whose levels stay together."""

    scheme: Literal["williams", "random", "fixed"] = "williams"
    block: str = ""


@dataclass(frozen=True, slots=True)
class Study:
    """A design. Equal designs have equal ``digest``s, regardless of their file's path."""

    name: str
    title: str
    participants: int
    seed: int
    consent: str
    factors: tuple[Factor, ...]
    order: Order
    conditions: tuple[Condition, ...]
    tasks: tuple[Task, ...]
    before: tuple[str, ...]  # questionnaires, by name
    each: tuple[str, ...]  # after each condition
    after: tuple[str, ...]
    questionnaires: Mapping[str, Questionnaire]
    rest: float = 0.0  # least seconds between two conditions
    path: Path = field(default=Path("study.toml"), compare=False)

    @property
    def within(self) -> tuple[Factor, ...]:
        """Within-subject factors."""
        return tuple(factor for factor in self.factors if not factor.between)

    @property
    def items_without_text(self) -> tuple[str, ...]:
        """Items without a text, as questionnaire.item."""
        return tuple(f"{name}.{item}" for name, one in self.questionnaires.items() for item in one.items_without_text)

    @property
    def missing_cells(self) -> tuple[tuple[str, ...], ...]:
        """Combinations of within-subject levels without a condition; ART requires full factorial designs."""
        there = {tuple(one.levels.values()) for one in self.conditions}
        return tuple(cell for cell in product(*(factor.levels for factor in self.within)) if cell not in there)

    def condition(self, name: str) -> Condition:
        """Return a condition by its name."""
        return next(one for one in self.conditions if one.name == name)

    def to_json(self) -> dict[str, Any]:
        """Return the whole design as JSON."""
        found: dict[str, Any] = json.loads(json.dumps(_plain(self)))
        return found

    @property
    def digest(self) -> str:
        """SHA-256 of ``to_json``."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def read_study(path: str | Path) -> Study:
    """Return the design in a file. Raises FormatError naming the file and the key."""
    path = Path(path)
    table = read_toml(path)
    table.known(
        *("name", "title", "participants", "seed", "consent", "factors", "between", "order", "usual", "condition"),
        *("task", "questionnaires", "text", "rest_s"),
    )
    factors = _factors(table)
    within = tuple(one for one in factors if not one.between)
    asked = table.table("questionnaires")
    asked.known("before", "each", "after")
    questionnaires: dict[str, Questionnaire] = {}
    stages = tuple(_read_stage(asked, stage, path.parent, questionnaires) for stage in ("before", "each", "after"))
    texts = table.table("text")
    if unused := [name for name in texts.keys if name not in questionnaires]:
        raise FormatError(
            f"{path}: [text.{unused[0]}] is for a questionnaire that the study does not have; delete it, or name the "
            "questionnaire under [questionnaires]"
        )
    for name in texts.keys:
        questionnaires[name] = questionnaires[name].with_texts(texts.table(name))
    conditions = _conditions(table, within)
    ordering = table.table("order")
    ordering.known("scheme", "block")
    scheme: Any = ordering.choice("scheme", ("williams", "random", "fixed"), "williams")
    order = Order(scheme, ordering.choice("block", ("", *(factor.name for factor in within)), ""))
    tasks = tuple(_task(one) for one in table.tables("task"))
    _check_unique(table, "task", [task.name for task in tasks])
    if not tasks and not stages[1]:
        raise table.error("task", "expected a [[task]], or a questionnaire after each condition; found neither")
    return Study(
        name=table.name("name"),
        title=table.text("title", most=200),
        participants=table.count("participants", 1, MAX_PARTICIPANTS),
        seed=table.count("seed", 0, 2**31 - 1),
        consent=table.text("consent"),
        factors=factors,
        order=order,
        conditions=conditions,
        tasks=tasks,
        before=stages[0],
        each=stages[1],
        after=stages[2],
        questionnaires=questionnaires,
        rest=table.number("rest_s", 0, 3600, 0.0),
        path=path,
    )


def _factors(table: Table) -> tuple[Factor, ...]:
    found: list[Factor] = []
    for key in ("factors", "between"):
        levels = table.table(key)
        for name in levels.keys:
            levels.checked_name(name, name)
            if name in _RESERVED_COLUMNS or any(other.name == name for other in found):
                raise levels.error(name, "this name is taken; choose another one")
            for level in levels.texts(name, 2, 20):
                levels.checked_name(name, level)
            found.append(Factor(name, levels.texts(name, 2, 20), key == "between"))
    if all(one.between for one in found):
        raise table.error("factors", 'expected a factor with its levels, such as type = ["self", "other"]')
    return tuple(found)


def _conditions(table: Table, within: tuple[Factor, ...]) -> tuple[Condition, ...]:
    usual = table.table("usual")
    usual.known(*_CONDITION_KEYS, "avatar")
    found = []
    for one in table.tables("condition"):
        one.known("name", "avatar", *_CONDITION_KEYS, *(factor.name for factor in within))
        levels = {factor.name: one.choice(factor.name, factor.levels) for factor in within}
        view: Any = one.choice("view", get_args(View), usual.choice("view", get_args(View), "mirror"))
        found.append(
            Condition(
                name=one.name("name"),
                levels=levels,
                avatar=one.text("avatar", usual.text("avatar", "default", 300), 300),
                view=view,
                light=_light(one, _light(usual, (1.0, 1.0, 1.0))),
                latency=one.number("latency", 0, 2000, usual.number("latency", 0, 2000, 0.0)),
                hands=one.flag("hands", usual.flag("hands", True)),
            )
        )
    if not 1 <= len(found) <= 20:
        raise table.error("condition", f"expected 1 to 20 [[condition]], found {len(found)}")
    _check_unique(table, "condition", [one.name for one in found])
    cells = [tuple(one.levels.values()) for one in found]
    for cell, condition in zip(cells, found, strict=True):
        if cells.count(cell) > 1:
            raise table.error("condition", f"{condition.name!r} has the same levels as another one; each stands once")
    return tuple(found)


def _light(table: Table, usual: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the light as RGB; the file has one number from 0 to 1, or three."""
    value = table["light"] if "light" in table else list(usual)
    values = value if isinstance(value, list) else [value] * 3
    if len(values) != 3 or not all(is_number(v) and 0 <= v <= 1 for v in values):
        raise table.error("light", f"expected a number from 0 to 1, or [red, green, blue], not {value!r:.60}")
    red, green, blue = map(float, values)
    return red, green, blue


def _task(one: Table) -> Task:
    one.known("name", "text", "seconds", "speak", "ready", "reading", "countdown")
    return Task(
        one.name("name"),
        one.text("text", most=2000),
        one.number("seconds", 0.1, 3600),
        one.flag("speak", True),
        one.flag("ready", True),
        one.number("reading", 0, 120, 6.0),
        one.count("countdown", 0, 60, 3),
    )


def _read_stage(table: Table, stage: str, folder: Path, into: dict[str, Questionnaire]) -> tuple[str, ...]:
    """Read a stage's questionnaires into ``into`` and return their names."""
    names = []
    for entry in table.texts(stage):
        try:
            one = questionnaire_of(entry, folder)
        except FormatError as error:
            raise table.error(stage, str(error)) from None
        if into.setdefault(one.name, one) != one:
            raise table.error(stage, f"there are two questionnaires called {one.name!r}; rename one")
        names.append(one.name)
    return tuple(names)


def _check_unique(table: Table, key: str, names: list[str]) -> None:
    if twice := [name for name in names if names.count(name) > 1]:
        raise table.error(key, f"there are two called {twice[0]!r}; rename one")


def _plain(value: Any) -> Any:
    """Return dataclasses and mappings as JSON values, without paths."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: _plain(getattr(value, name)) for name in value.__dataclass_fields__ if name != "path"}
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, tuple | list) else value
