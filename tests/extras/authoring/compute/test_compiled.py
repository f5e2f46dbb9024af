"""numba: cached where possible, replaced by NumPy where missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from glsplat.extras.authoring.compute.compiled import compiled
from glsplat.extras.authoring.optimize import mesh_fit as module
from glsplat.extras.authoring.optimize.mesh_fit import STEPS, fitted_to_mesh
from glsplat.extras.authoring.optimize.refine import RefineConfig
from glsplat.extras.authoring.optimize.target_pictures import ViewConfig
from tests.extras.authoring.optimize.figures import kept, mesh, start
from tests.extras.authoring.optimize.without import without_numba

ROOT = Path(__file__).parents[4]


def added(values: np.ndarray, times: int) -> float:
    total = 0.0
    for value in values:
        total += value * times
    return total


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
import glsplat.extras.evaluate.comparison.own_methods, glsplat.extras.authoring.reconstruct.video
from glsplat.extras.authoring.compute.compiled import available
assert not available()
raise SystemExit(apps.cli.main(["avatar", "reduce", "no.glb", "-o", "out.glb", "--splats", "200"]))
"""


@pytest.mark.check
def test_all_that_can_do_without_it_does(tmp_path: Path) -> None:
    words = [sys.executable, "-c", WITHOUT]
    at = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env=at, check=False)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "pip install 'glsplat[make]'" in done.stderr


FEW = {"body": 8, "poses": 1, "each": 1, "size": 96}


@pytest.mark.check
@pytest.mark.gl
def test_a_fit_comes_closer_and_is_the_same_again(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in FEW.items():
        monkeypatch.setitem(ViewConfig.__init__.__kwdefaults__, name, value)
    told: list[str] = []
    once, again = (fitted_to_mesh(start(), mesh(), 5, 60, lambda stage, _: told.append(stage)) for _ in range(2))
    assert kept(once) > kept(start()) + 3
    assert once.splats.means.tobytes() == again.splats.means.tobytes()
    assert told[0] == "drawing target pictures" and told[-1].startswith("fitting splats, error ")


@pytest.mark.parametrize(("asked", "done"), [(STEPS, STEPS // 2), (7, 7)])
def test_without_numba_its_twin_fits(monkeypatch: pytest.MonkeyPatch, asked: int, done: int) -> None:
    without_numba(monkeypatch)
    seen: list[tuple[Any, ...]] = []

    def refine(*words: Any) -> Any:
        seen.append(words)
        return words[0]

    monkeypatch.setattr(module, "refine", refine)
    assert fitted_to_mesh(start(), mesh(), 5, asked) is start()
    assert seen == [(start(), mesh(), 5, RefineConfig(steps=done), None)]
