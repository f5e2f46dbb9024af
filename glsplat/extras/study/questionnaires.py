"""Questionnaires: items with scales, and scores over the answers. Read from TOML files.

The wording of many instruments is not free. Their files here have structure, scoring and source; the texts come from
a licensed copy (``[text.NAME]`` of the study file).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from importlib.resources import as_file
from pathlib import Path
from typing import Any, Literal, get_args

from glsplat.errors import FormatError
from glsplat.extras.study.tables import Table, is_number, read_toml

Answer = float | str  # a number on a scale, an option of a choice, or free text

Kind = Literal["points", "slider", "choice", "text"]
MAX_ANSWER = 4000  # characters of free text
MAX_POINTS = 11  # that fit side by side


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of an item: ``points`` and ``slider`` are numbers from ``low`` to ``high`` in steps of ``step``."""

    kind: Kind
    low: float = 1
    high: float = 7
    step: float = 1
    labels: tuple[str, ...] = ()  # of both ends, or of each point; the options of a choice

    def check(self, value: Any) -> str:
        """Return why ``value`` is not a valid answer; "" if it is."""
        if self.kind == "text":
            good = isinstance(value, str) and len(value) <= MAX_ANSWER and is_text(value)
            return "" if good else f"expected words of at most {MAX_ANSWER} characters"
        if self.kind == "choice":
            return "" if isinstance(value, str) and value in self.labels else f"expected one of {self.labels}"
        if not is_number(value) or not self.low <= value <= self.high:
            return f"expected a number from {self.low:g} to {self.high:g}"
        steps = (value - self.low) / self.step
        return "" if abs(steps - round(steps)) < 1e-9 else f"expected {self.low:g} plus a multiple of {self.step:g}"


@dataclass(frozen=True, slots=True)
class Item:
    """One question. A ``reversed`` one is scored as low + high - value."""

    name: str
    text: str  # "": not set yet
    scale: Scale
    reversed: bool = False
    required: bool = True

    def scored(self, value: float) -> float:
        """Return the value used in scores."""
        return self.scale.low + self.scale.high - value if self.reversed else value


@dataclass(frozen=True, slots=True)
class Score:
    """A score: ``factor`` times the sum or the mean of weighted items."""

    name: str
    items: tuple[str, ...]
    how: Literal["mean", "sum"] = "mean"
    weights: tuple[float, ...] = ()  # by item; empty: all 1
    factor: float = 1.0
    text: str = ""  # description

    def of(self, questionnaire: Questionnaire, answers: Mapping[str, Answer]) -> float | None:
        """Return the score; None if an item was not answered."""
        total = 0.0
        for name, weight in zip(self.items, self.weights or (1.0,) * len(self.items), strict=True):
            value = answers.get(name)
            if not isinstance(value, int | float):
                return None
            total += weight * questionnaire[name].scored(value)
        return self.factor * (total / len(self.items) if self.how == "mean" else total)

    def reversed_items(self, questionnaire: Questionnaire) -> tuple[str, ...]:
        """Return the items whose answers lower the score: either reversed, or with a negative weight."""
        weights = zip(self.items, self.weights or (1.0,) * len(self.items), strict=True)
        return tuple(item for item, weight in weights if questionnaire[item].reversed != (weight < 0))


@dataclass(frozen=True, slots=True)
class Questionnaire:
    """Ordered items, and scores over them."""

    name: str
    title: str
    source: str
    licence: str
    intro: str
    items: tuple[Item, ...]
    scores: tuple[Score, ...]

    def __getitem__(self, item: str) -> Item:
        return next(one for one in self.items if one.name == item)

    @property
    def items_without_text(self) -> tuple[str, ...]:
        """Names of items without a text."""
        return tuple(item.name for item in self.items if not item.text.strip())

    def with_texts(self, texts: Table) -> Questionnaire:
        """Return a copy with texts by item. Raises FormatError for unknown items."""
        texts.known(*(item.name for item in self.items))
        given = {name: texts.text(name, most=1000) for name in texts.keys}
        return replace(self, items=tuple(replace(one, text=given.get(one.name, one.text)) for one in self.items))


def is_text(value: str) -> bool:
    """Return whether UTF-8 can hold the text; JSON may contain lone surrogates."""
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def embedded() -> tuple[str, ...]:
    """Return the names of the included instruments."""
    folder = resources.files("glsplat.extras.study") / "instruments"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def questionnaire_of(name: str, folder: Path) -> Questionnaire:
    """Return an included questionnaire by name, or a .toml file relative to ``folder``."""
    if name.endswith(".toml"):
        return read_questionnaire(folder / name)
    if name not in embedded():
        there = ", ".join(embedded())
        raise FormatError(f"there is no questionnaire {name!r:.60}; there are {there}, and files ending in .toml")
    with as_file(resources.files("glsplat.extras.study") / "instruments" / f"{name}.toml") as path:
        return read_questionnaire(path)


def read_questionnaire(path: str | Path) -> Questionnaire:
    """Return the questionnaire in a file. Raises FormatError naming file and key."""
    table = read_toml(path)
    table.known("name", "title", "source", "licence", "intro", "scale", "item", "score")
    usual = _scale(table.table("scale"), Scale("points"))
    items: list[Item] = []
    for one in table.tables("item"):
        one.known("name", "text", "reversed", "required", "scale")
        name = one.name("name")
        if any(other.name == name for other in items):
            raise one.error("name", f"there are two items called {name!r}; rename one")
        scale = _scale(one.table("scale"), usual)
        item = Item(
            name,
            one.text("text", "", 1000),
            scale,
            one.flag("reversed", False),
            one.flag("required", scale.kind != "text"),
        )
        if item.reversed and scale.kind not in ("points", "slider"):
            raise one.error("reversed", "only points and sliders can be reversed")
        items.append(item)
    if not items:
        raise table.error("item", "expected [[item]] once or more, found none")
    scores = tuple(_score(one, items) for one in table.tables("score"))
    names = [score.name for score in scores]
    if twice := [name for name in names if names.count(name) > 1]:
        raise table.error("score", f"there are two scores called {twice[0]!r}; rename one")
    return Questionnaire(
        table.name("name"),
        table.text("title", most=200),
        table.text("source", "", 1000),
        table.text("licence", "", 200),
        table.text("intro", "", 2000),
        tuple(items),
        scores,
    )


def _scale(table: Table, usual: Scale) -> Scale:
    table.known("kind", "from", "to", "step", "labels")
    kind: Any = table.choice("kind", get_args(Kind), usual.kind)
    same = kind == usual.kind
    labels = table.texts("labels") if "labels" in table else (usual.labels if same else ())
    if kind == "text":
        return Scale("text")
    if kind == "choice":
        if len(labels) < 2:
            raise table.error("labels", f"a choice needs two options or more, found {len(labels)}")
        return Scale("choice", labels=labels)
    start, end, gap = (usual.low, usual.high, usual.step) if same else (0, 100, 1)
    low = table.number("from", -1e6, 1e6, start)
    high = table.number("to", -1e6, 1e6, end)
    step = table.number("step", 1e-6, 1e6, gap)
    steps = (high - low) / step
    if high <= low or steps > 1000 or abs(steps - round(steps)) > 1e-9:
        raise table.error(
            "step", f"expected {low:g} to {high:g} to be a whole number of steps of {step:g}, at most 1000"
        )
    if kind == "points" and steps + 1 > MAX_POINTS:
        raise table.error("to", f"at most {MAX_POINTS} points fit side by side, not {steps + 1:g}; use a slider")
    if len(labels) not in (0, 2, round(steps) + 1):
        raise table.error(
            "labels", f"expected 2 labels for the ends or {steps + 1:g} for the points, not {len(labels)}"
        )
    return Scale(kind, low, high, step, labels)


def _score(table: Table, items: list[Item]) -> Score:
    table.known("name", "items", "how", "weights", "factor", "text")
    names = table.texts("items", 1)
    numbers = {item.name for item in items if item.scale.kind in ("points", "slider")}
    for name in names:
        if name not in numbers:
            raise table.error("items", f"there is no item {name!r:.60} that is answered by a number")
    weights: Any = table["weights"] if "weights" in table else []
    if not isinstance(weights, list) or not all(map(is_number, weights)) or len(weights) not in (0, len(names)):
        raise table.error("weights", f"expected {len(names)} numbers, one an item, not {weights!r:.60}")
    how: Any = table.choice("how", ("mean", "sum"), "mean")
    factor = table.number("factor", -1e6, 1e6, 1.0)
    return Score(table.name("name"), names, how, tuple(map(float, weights)), factor, table.text("text", "", 300))
