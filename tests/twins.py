"""Functions of Python and of the page that are twins: both give the answers of one file of vectors.

A folder of tests that has twins has a module ``test_twins.py`` with a table ``TWINS``, and beside it ``twins.test.js``,
the page's side, and ``vectors.json``, which Python's side wrote:

    python -m tests.twins tests/extras/speech      # after a change of what the twins are to give
"""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.in_node import write_modules
from tests.needs import program, require

__all__ = ["Twin", "both_sides", "text_of"]

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Twin:
    """Python's side of a pair."""

    answer: Callable[..., Any]  # takes an input's keys, returns what is plain JSON but for arrays
    inputs: Callable[[], Sequence[Mapping[str, Any]]]
    tolerance: float = 1e-9  # of numbers, relative above 1


def text_of(data: bytes) -> str:
    """Return bytes as vectors have them: base64."""
    return base64.b64encode(data).decode()


def both_sides(folder: Path, twins: Mapping[str, Twin]) -> tuple[Callable[[str], None], Callable[[Path], None]]:
    """Return the two tests of a folder: Python's side name by name, and the page's side in Node."""

    @pytest.mark.parametrize("name", twins)
    def python_side(name: str) -> None:
        _check_python(folder, twins, name)

    @pytest.mark.check
    def page_side(tmp_path: Path) -> None:
        _check_page(folder, tmp_path)

    return python_side, page_side


def _check_python(folder: Path, twins: Mapping[str, Twin], name: str) -> None:
    """Fail unless Python gives the answers of the vectors of that name."""
    vectors = json.loads((folder / "vectors.json").read_text(encoding="utf-8"))
    assert vectors.keys() == twins.keys()
    tolerance, cases = vectors[name]["tolerance"], vectors[name]["cases"]
    assert cases and tolerance == twins[name].tolerance
    for number, case in enumerate(cases):
        _same(_plain(twins[name].answer(**case["in"])), case["out"], tolerance, f"{name} {number}")


def _check_page(folder: Path, tmp_path: Path) -> None:
    """Run ``node --test`` for the page's side, and fail with what it prints unless all tests pass."""
    require("node")
    write_modules(tmp_path)
    shutil.copy(Path(__file__).with_suffix(".js"), tmp_path)
    for name in ("vectors.json", "twins.test.js"):
        shutil.copy(folder / name, tmp_path)
    command = [program("node"), "--test", str(tmp_path / "twins.test.js")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0 and "# fail 0" in done.stdout and "# pass 0" not in done.stdout, done.stdout


def _same(found: Any, wanted: Any, tolerance: float, where: str) -> None:
    if isinstance(wanted, list):
        assert isinstance(found, list) and len(found) == len(wanted), where
        for number, (one, other) in enumerate(zip(found, wanted, strict=True)):
            _same(one, other, tolerance, f"{where}[{number}]")
    elif isinstance(wanted, dict):
        assert isinstance(found, dict) and found.keys() == wanted.keys(), where
        for key, other in wanted.items():
            _same(found[key], other, tolerance, f"{where}.{key}")
    elif isinstance(wanted, float | int) and not isinstance(wanted, bool):
        assert abs(found - wanted) <= tolerance * max(1, abs(wanted)), f"{where}: {found}, not {wanted}"
    else:
        assert found == wanted, f"{where}: {found!r}, not {wanted!r}"


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=np.ndarray.tolist))


def _write(folder: Path) -> None:
    """Write the vectors of a folder of tests."""
    module = import_module(".".join([*folder.resolve().relative_to(ROOT).parts, "test_twins"]))
    lines = []
    for name, twin in module.TWINS.items():
        cases = [{"in": (given := _plain(one)), "out": _plain(twin.answer(**given))} for one in twin.inputs()]
        texts = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases)
        lines.append(f'"{name}": {{"tolerance": {twin.tolerance}, "cases": [\n{texts}\n]}}')
    (folder / "vectors.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        _write(Path(argument))
