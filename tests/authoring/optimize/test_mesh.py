"""An avatar fitted to the mesh it was made from: by the compiled descent, or by its slow twin without numba."""

from __future__ import annotations

from typing import Any

import pytest

from glsplat.authoring.optimize import mesh as module
from glsplat.authoring.optimize.mesh import STEPS, fitted_to_mesh
from glsplat.authoring.optimize.pictures import ViewConfig
from glsplat.authoring.refine import RefineConfig
from tests.authoring.optimize.figures import kept, mesh, start
from tests.authoring.optimize.without import without_numba

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
    assert told[0] == "drawing what to fit to" and told[-1].startswith("fitting splats, error ")


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
