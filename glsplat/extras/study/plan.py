"""The plan: who has which order, written before the first participant comes, and never changed after."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from glsplat.errors import FormatError
from glsplat.extras.study.design import Study
from glsplat.extras.study.orders import groups_of, orders_of
from glsplat.io.files import open_regular

__all__ = ["PLAN", "Plan", "checked_plan", "label", "make_plan", "read_plan", "write_plan"]

PLAN = "plan.json"
"""Its name in the data folder."""

_VERSION = 1
_LARGEST = 16 << 20  # bytes, read and written


@dataclass(frozen=True, slots=True)
class Plan:
    """``orders`` and ``groups`` by participant, the first is number 1. ``study`` is the whole design, for later."""

    digest: str
    made: str  # UTC
    orders: tuple[tuple[str, ...], ...]
    groups: tuple[Mapping[str, str], ...]
    study: Mapping[str, Any]


def label(participant: int) -> str:
    """A participant's pseudonym, and the name of the folder: sub-007 (BIDS)."""
    return f"sub-{participant:03d}"


def make_plan(study: Study, now: datetime | None = None) -> Plan:
    """The plan of a study. Raises FormatError while items want their texts."""
    if study.untold:
        first, count = study.untold[0], len(study.untold)
        name, _, item = first.partition(".")
        raise FormatError(
            f"{study.path}: {count} items have no text yet, the first is {first}: put it under [text.{name}] as "
            f'{item} = "..." (glsplat study check lists all)'
        )
    made = (now or datetime.now(UTC)).replace(microsecond=0).isoformat()
    return Plan(study.digest, made, tuple(orders_of(study)), tuple(groups_of(study)), study.to_json())


def write_plan(folder: Path, plan: Plan) -> Path:
    """Write the plan into the data folder, which is made. Raises FormatError where one is there: it stays."""
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
    if len(text) > _LARGEST:
        raise FormatError(f"{path}: a plan has at most {_LARGEST >> 20} MiB, not {len(text) >> 20}; shorten the texts")
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
            f"{path}: there is a plan already, and it stays; for another study choose another --data"
        ) from None
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        partial.unlink(missing_ok=True)
    return path


def read_plan(folder: Path) -> Plan:
    """The plan of a data folder. Raises FormatError naming it."""
    path = folder / PLAN
    if not path.exists():
        raise FormatError(f"{path}: there is no plan yet; make it by glsplat study plan")
    with open_regular(path) as (file, size):
        if size > _LARGEST:
            raise FormatError(f"{path}: expected a plan of at most {_LARGEST >> 20} MiB, not {size >> 20}")
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
        raise FormatError(f"{path}: this is no plan ({type(error).__name__}: {error})") from None


def checked_plan(folder: Path, study: Study) -> Plan:
    """The plan, if it was made of this very study. Raises FormatError that names what is different."""
    plan = read_plan(folder)
    if plan.digest != study.digest:
        where = _difference(dict(plan.study), study.to_json(), "") or "its contents"
        raise FormatError(
            f"{study.path}: {where} is not what it was when the plan was made ({folder / PLAN}, {plan.made}): "
            "put it back, or begin a new study with another --data"
        )
    return plan


def _difference(old: Any, new: Any, way: str) -> str:
    """The way to the first value that differs; "" if none does."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(key for key in new if key not in old)]:
            if key not in old or key not in new:
                return f"{way}.{key}".strip(".")
            if found := _difference(old[key], new[key], f"{way}.{key}"):
                return found
        return ""
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = zip(old, new, strict=True)
        return next((f for n, (a, b) in enumerate(pairs, 1) if (f := _difference(a, b, f"{way} {n}"))), "")
    return "" if old == new else way.strip(".")
