"""Functions of Python and of the page that are twins: both give the answers of one file of vectors.

A folder of tests that has twins has a module ``test_twins.py`` with a table ``TWINS``, and beside it ``twins.test.js``,
the page's side, and ``vectors.json``, which Python's side wrote:

    python -m tests.twins tests/extras/speech      # after a change of what the twins are to give

A module with ``VECTORS``, a folder, has a file a name there instead: vectors that are published.
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

__all__ = ["Twin", "both_sides", "check_answers", "read_vectors", "text_of"]

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


def both_sides(
    folder: Path, twins: Mapping[str, Twin], vectors: Path | None = None
) -> tuple[Callable[[str], None], Callable[[Path], None]]:
    """Return the two tests of a folder: Python's side name by name, and the page's side in Node."""

    @pytest.mark.parametrize("name", twins)
    def python_side(name: str) -> None:
        _check_python(read_vectors(vectors or folder / "vectors.json"), twins, name)

    @pytest.mark.check
    def page_side(tmp_path: Path) -> None:
        _check_page(folder, read_vectors(vectors or folder / "vectors.json"), tmp_path)

    return python_side, page_side


def read_vectors(path: Path) -> dict[str, Any]:
    """Return the vectors of a file, or of a folder with a file a name: ``tolerance`` and ``cases`` by name."""
    if path.is_dir():
        return {one.stem: json.loads(one.read_text(encoding="utf-8")) for one in sorted(path.glob("*.json"))}
    return dict(json.loads(path.read_text(encoding="utf-8")))


def check_answers(vectors: Mapping[str, Any], name: str, answers: Sequence[Any]) -> None:
    """Fail unless these are the answers of the vectors of that name."""
    tolerance, cases = vectors[name]["tolerance"], vectors[name]["cases"]
    assert cases and len(answers) == len(cases)
    for number, (case, answer) in enumerate(zip(cases, answers, strict=True)):
        _same(answer, case["out"], tolerance, f"{name} {number}")


def _check_python(vectors: Mapping[str, Any], twins: Mapping[str, Twin], name: str) -> None:
    """Fail unless Python gives the answers of the vectors of that name."""
    assert vectors.keys() == twins.keys() and vectors[name]["tolerance"] == twins[name].tolerance
    check_answers(vectors, name, [_plain(twins[name].answer(**case["in"])) for case in vectors[name]["cases"]])


def _check_page(folder: Path, vectors: Mapping[str, Any], tmp_path: Path) -> None:
    """Run ``node --test`` for the page's side, and fail with what it prints unless all tests pass."""
    require("node")
    write_modules(tmp_path)
    shutil.copy(Path(__file__).with_suffix(".js"), tmp_path)
    shutil.copy(folder / "twins.test.js", tmp_path)
    (tmp_path / "vectors.json").write_text(json.dumps(vectors), encoding="utf-8")
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
    texts = {}
    for name, twin in module.TWINS.items():
        cases = [{"in": (given := _plain(one)), "out": _plain(twin.answer(**given))} for one in twin.inputs()]
        lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases)
        texts[name] = f'{{"tolerance": {twin.tolerance}, "cases": [\n{lines}\n]}}'
    if vectors := getattr(module, "VECTORS", None):
        for name, text in texts.items():
            (vectors / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")
        return
    whole = ",\n".join(f'"{name}": {text}' for name, text in texts.items())
    (folder / "vectors.json").write_text(f"{{\n{whole}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        _write(Path(argument))
