"""The plan: each participant's order of conditions, written once before the first participant, and the steps.

Williams (1949), Australian Journal of Scientific Research A 2, 149-168: each condition occurs once per row, equally
often in each position and equally often after each other one. An even number k needs k rows, an odd one 2k.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from glsplat.errors import FormatError
from glsplat.extras.study.design import Study
from glsplat.io.files import open_regular

PLAN = "plan.json"  # file name in the data folder

_VERSION = 1
MAX_PLAN_BYTES = 16 << 20


def williams(count: int) -> list[list[int]]:
    """Return rows of the numbers 0 to count - 1, balanced for position and predecessor.

    >>> glsplat.extras.study.plan.williams(4)
    [[0, 3, 1, 2], [1, 0, 2, 3], [2, 1, 3, 0], [3, 2, 0, 1]]
    """
    first = [0]
    for step in range(1, count):
        first.append((first[-1] + step * (-1 if step % 2 else 1)) % count)
    rows = [[(number + row) % count for number in first] for row in range(count)]
    return rows if count % 2 == 0 or count == 1 else rows + [row[::-1] for row in rows]


def orders_of(study: Study) -> list[tuple[str, ...]]:
    """Return the condition names in order, for each participant. Deterministic for a study.

    Balanced within each group of participants if their number permits, else over all of them.
    """
    rng = np.random.default_rng([study.seed, 1])
    blocks = _blocks(study)
    rows = _rows(study, blocks)
    out: list[tuple[str, ...]] = []
    names = [_shuffled(rng, block) if study.order.scheme == "williams" else block for block in blocks]
    groups = [tuple(group.values()) for group in groups_of(study)]
    by_group = study.participants % (len(rows) * len(set(groups))) == 0
    decks: dict[tuple[str, ...], list[int]] = {}  # rows that a group has left in this round
    for group in groups:
        if study.order.scheme == "random":
            shown = [names[number] for number in rng.permutation(len(names))]
            out.append(tuple(name for block in shown for name in _shuffled(rng, block)))
            continue
        deck = decks.setdefault(group if by_group else (), [])
        if not deck:
            deck += rng.permutation(len(rows)).tolist() if study.order.scheme == "williams" else range(len(rows))
        out.append(tuple(names[block][place] for block, place in rows[deck.pop(0)]))
    return out


def groups_of(study: Study) -> list[dict[str, str]]:
    """Return the between-subject levels of each participant: equally many of each, in random order."""
    factors = [factor for factor in study.factors if factor.between]
    cells = list(product(*(factor.levels for factor in factors)))
    rng = np.random.default_rng([study.seed, 2])
    out: list[dict[str, str]] = []
    while len(out) < study.participants:
        for number in rng.permutation(len(cells)):
            out.append({factor.name: level for factor, level in zip(factors, cells[number], strict=True)})
    return out[: study.participants]


def cycle(study: Study) -> int:
    """Return the number of participants after which orders are balanced; 1 for random and fixed orders."""
    return len(_rows(study, _blocks(study))) if study.order.scheme == "williams" else 1


def _blocks(study: Study) -> list[list[str]]:
    """Return the conditions by block."""
    block = study.order.block
    if not block:
        return [[one.name for one in study.conditions]]
    levels = next(factor.levels for factor in study.factors if factor.name == block)
    found = [[one.name for one in study.conditions if one.levels[block] == level] for level in levels]
    return [names for names in found if names]


def _rows(study: Study, blocks: list[list[str]]) -> list[list[tuple[int, int]]]:
    """Return orders as (block, number in block). Each order of blocks is combined with all rows within blocks."""
    if study.order.scheme != "williams":
        return [[(block, place) for block, names in enumerate(blocks) for place in range(len(names))]]
    inner = [williams(len(names)) for names in blocks]
    turns = int(np.lcm.reduce([len(rows) for rows in inner]))
    return [
        [(block, place) for at, block in enumerate(outer) for place in inner[block][(turn + at) % len(inner[block])]]
        for outer in williams(len(blocks))
        for turn in range(turns)
    ]


def _shuffled(rng: np.random.Generator, names: Sequence[str]) -> list[str]:
    return [names[number] for number in rng.permutation(len(names))]


@dataclass(frozen=True, slots=True)
class Plan:
    """``orders`` and ``groups`` of participants 1, 2, ...; ``study`` is the whole design."""

    digest: str
    made: str  # UTC
    orders: tuple[tuple[str, ...], ...]
    groups: tuple[Mapping[str, str], ...]
    study: Mapping[str, Any]


def label(participant: int) -> str:
    """Return a participant's pseudonym, also the folder's name: sub-007 (BIDS)."""
    return f"sub-{participant:03d}"


def make_plan(study: Study) -> Plan:
    """Return the plan of a study. Raises FormatError if items have no text."""
    if study.items_without_text:
        first, count = study.items_without_text[0], len(study.items_without_text)
        name, _, item = first.partition(".")
        raise FormatError(
            f"{study.path}: {count} items have no text yet, the first is {first}: put it under [text.{name}] as "
            f'{item} = "..." (glsplat study check lists all)'
        )
    made = datetime.now(UTC).replace(microsecond=0).isoformat()
    return Plan(study.digest, made, tuple(orders_of(study)), tuple(groups_of(study)), study.to_json())


def write_plan(folder: Path, plan: Plan) -> Path:
    """Write the plan into the data folder. Raises FormatError if there is a plan already."""
    path = folder / PLAN
    fields = {
        "version": _VERSION,
        "digest": plan.digest,
        "made": plan.made,
        "participants": {
            label(number): {"order": order, "group": dict(group)}
            for number, (order, group) in enumerate(zip(plan.orders, plan.groups, strict=True), 1)
        },
        "study": plan.study,
    }
    text = json.dumps(fields, indent=1).encode()
    if len(text) > MAX_PLAN_BYTES:
        raise FormatError(
            f"{path}: a plan has at most {MAX_PLAN_BYTES >> 20} MiB, not {len(text) >> 20}; shorten the texts"
        )
    partial = folder / f".{PLAN}.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with open(partial, "xb") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.link(partial, path)  # unlike a renaming, this fails where the name is taken
    except FileExistsError:
        raise FormatError(
            f"{path}: there is already a plan, which is not overwritten; for another study choose another --data"
        ) from None
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        partial.unlink(missing_ok=True)
    return path


def read_plan(folder: Path) -> Plan:
    """Return the plan in a data folder. Raises FormatError naming it."""
    path = folder / PLAN
    if not path.exists():
        raise FormatError(f"{path}: there is no plan yet; make one with glsplat study plan")
    with open_regular(path) as (file, size):
        if size > MAX_PLAN_BYTES:
            raise FormatError(f"{path}: expected a plan of at most {MAX_PLAN_BYTES >> 20} MiB, not {size >> 20}")
        data = file.read()
    try:
        fields = json.loads(data)
        people = fields["participants"]
        numbers = [label(number) for number in range(1, len(people) + 1)]
        if fields["version"] != _VERSION or list(people) != numbers:
            raise ValueError("another version, or participants out of order")
        orders = tuple(tuple(map(str, people[one]["order"])) for one in numbers)
        groups = tuple({str(k): str(v) for k, v in people[one]["group"].items()} for one in numbers)
        return Plan(str(fields["digest"]), str(fields["made"]), orders, groups, dict(fields["study"]))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path}: not a plan ({type(error).__name__}: {error})") from None


def checked_plan(folder: Path, study: Study) -> Plan:
    """Return the plan if it was made from this design. Raises FormatError naming the first difference."""
    plan = read_plan(folder)
    if plan.digest != study.digest:
        where = _difference(dict(plan.study), study.to_json(), "") or "its contents"
        raise FormatError(
            f"{study.path}: {where} has changed since the plan was made ({folder / PLAN}, {plan.made}): "
            "restore it, or start a new study with another --data"
        )
    return plan


def _difference(old: Any, new: Any, path: str) -> str:
    """Return the path to the first different value; "" if all are equal."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(key for key in new if key not in old)]:
            if key not in old or key not in new:
                return f"{path}.{key}".strip(".")
            if found := _difference(old[key], new[key], f"{path}.{key}"):
                return found
        return ""
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = zip(old, new, strict=True)
        return next((f for n, (a, b) in enumerate(pairs, 1) if (f := _difference(a, b, f"{path} {n}"))), "")
    return "" if old == new else path.strip(".")


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a session. Its ``name`` depends only on the plan."""

    name: str
    kind: Literal["consent", "questionnaire", "task", "rest"]
    position: int = 0  # of the condition in the participant's order, from 1; 0 outside conditions
    condition: str = ""
    task: str = ""
    questionnaire: str = ""

    @property
    def alias(self) -> str:
        """Name on the participant's page: number and kind, without the condition."""
        return f"{self.name.partition('-')[0]}-{self.kind}"


def steps_of(study: Study, plan: Plan, participant: int) -> tuple[Step, ...]:
    """Return all steps of a participant, numbered from 1."""
    found: list[Step] = []

    def add(kind: Literal["consent", "questionnaire", "task", "rest"], what: str, **more: str | int) -> None:
        condition = more.get("condition", "")
        parts = [f"{len(found) + 1:03d}", *([str(condition)] if condition else []), what]
        found.append(Step("-".join(parts), kind, **more))  # type: ignore[arg-type]

    add("consent", "consent")
    for name in study.before:
        add("questionnaire", name, questionnaire=name)
    for position, condition in enumerate(plan.orders[participant - 1], 1):
        if position > 1 and study.rest:
            add("rest", "rest")
        for task in study.tasks:
            add("task", task.name, position=position, condition=condition, task=task.name)
        for name in study.each:
            add("questionnaire", name, position=position, condition=condition, questionnaire=name)
    for name in study.after:
        add("questionnaire", name, questionnaire=name)
    return tuple(found)
