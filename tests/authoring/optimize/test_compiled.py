"""numba: told when it is not there, never imported before it is needed, and useful where nothing may be written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from glsplat.authoring.optimize.compiled import available, compiled
from tests.authoring.optimize.without import without_numba

ROOT = Path(__file__).parents[3]


def added(values: np.ndarray, times: int) -> float:
    total = 0.0
    for value in values:
        total += value * times
    return total


def test_it_is_told_whether_it_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    assert available()
    without_numba(monkeypatch)
    assert not available()


@pytest.mark.parametrize("written", [True, False])
def test_functions_are_compiled_where_nothing_may_be_cached(monkeypatch: pytest.MonkeyPatch, written: bool) -> None:
    asked: list[bool] = []

    def njit(*words: Any, **options: Any) -> Any:
        if options.get("nogil"):  # numba compiles functions of its own, too
            asked.append(options.get("cache", False))
        if options.get("cache") and not written:
            raise RuntimeError("cannot cache function 'added': no locator available for file")
        return real(*words, **options)

    real = numba.njit
    monkeypatch.setattr(numba, "njit", njit)
    function = compiled(added)
    assert function(np.arange(5.0), 3) == 30 and function.signatures  # type: ignore[attr-defined]
    assert asked == ([True] if written else [True, False])


WITHOUT = """
import sys
sys.modules["numba"] = None  # an import of it fails
import apps.cli, apps.avatar.making
import glsplat.evaluate.comparison.own_methods, glsplat.authoring.reconstruct.video
from glsplat.authoring.optimize.compiled import available
assert not available()
raise SystemExit(apps.cli.main(["avatar", "reduce", "no.glb", "-o", "out.glb", "--splats", "200"]))
"""


@pytest.mark.check
@pytest.mark.check
def test_all_that_can_do_without_it_does(tmp_path: Path) -> None:
    words = [sys.executable, "-c", WITHOUT]
    at = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env=at, check=False)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "pip install 'glsplat[make]'" in done.stderr
