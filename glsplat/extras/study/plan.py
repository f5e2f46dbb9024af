"""The plan: each participant's order of conditions, written once before the first participant."""

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

PLAN = "plan.json"
"""File name in the data folder."""

_VERSION = 1
MAX_PLAN_BYTES = 16 << 20


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
