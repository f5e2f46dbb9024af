"""Participants that come along, a comparison that takes seconds, and methods as if packages had brought them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glsplat.data import participants_folder
from glsplat.evaluate.comparison import measure
from glsplat.evaluate.comparison.participant import Participant, participants_in
from glsplat.evaluate.comparison.protocol import Protocol

METHODS = """
import os
from pathlib import Path
import numpy as np
from dataclasses import replace

class Itself:
    def make(self, participant):
        return participant.mesh

class Smaller:
    def make(self, participant):
        mesh = participant.mesh
        return replace(mesh, vertices=mesh.vertices * 0.97)

class Raising:
    def make(self, participant):
        raise ValueError("no\\nidea")

class Nothing:
    def make(self, participant):
        return 42

class Dying:
    def make(self, participant):
        os._exit(7)
"""


class Pixels:
    """In place of LPIPS, whose weights need not be on this machine: the mean square between pictures."""

    def features(self, picture: np.ndarray) -> np.ndarray:
        return picture.astype(np.float64)

    def distance(self, picture: np.ndarray, truth: np.ndarray) -> float:
        return float(((picture - truth) ** 2).mean())


@pytest.fixture
def no_lpips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "_network", lambda kind: Pixels())


@pytest.fixture(scope="session")
def people() -> list[Participant]:
    return participants_in(participants_folder())


@pytest.fixture
def short() -> Protocol:
    return Protocol(tasks=("standing", "turning"), views=("front", "left"), size=96, light="none")


@pytest.fixture
def plugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Installs methods by entry points, for this process and those that it starts: name -> class in METHODS."""

    def plug(**classes: str) -> None:
        site = tmp_path / "site"
        notes = site / "strangers-1.0.dist-info"
        notes.mkdir(parents=True)
        (site / "strangers_methods.py").write_text(METHODS)
        (notes / "METADATA").write_text("Metadata-Version: 2.1\nName: strangers\nVersion: 1.0\n")
        lines = [f"{name} = strangers_methods:{kind}" for name, kind in classes.items()]
        (notes / "entry_points.txt").write_text("\n".join(["[glsplat.methods]", *lines]))
        monkeypatch.syspath_prepend(str(site))

    return plug
