"""Participants that come along, a comparison that takes seconds, and methods as if packages had brought them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from glsplat.data import participants_folder
from glsplat.extras.evaluate.comparison import measure
from glsplat.extras.evaluate.comparison.participant import Participant, participants_in
from glsplat.extras.evaluate.comparison.protocol import Protocol

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


@pytest.fixture(scope="module")
def no_lpips() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "_network", lambda kind: Pixels())
        yield


@pytest.fixture(scope="session")
def people() -> list[Participant]:
    return participants_in(participants_folder())


@pytest.fixture(scope="session")
def short() -> Protocol:
    return Protocol(tasks=("standing", "turning"), views=("front", "left"), size=64, light="none")


def _plug(site: Path, patch: pytest.MonkeyPatch, **classes: str) -> None:
    notes = site / "strangers-1.0.dist-info"
    notes.mkdir(parents=True)
    (site / "strangers_methods.py").write_text(METHODS)
    (notes / "METADATA").write_text("Metadata-Version: 2.1\nName: strangers\nVersion: 1.0\n")
    lines = [f"{name} = strangers_methods:{kind}" for name, kind in classes.items()]
    (notes / "entry_points.txt").write_text("\n".join(["[glsplat.methods]", *lines]))
    patch.syspath_prepend(str(site))


@pytest.fixture
def plugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Installs methods by entry points, for this process and those that it starts: name -> class in METHODS."""
    return partial(_plug, tmp_path / "site", monkeypatch)


@pytest.fixture(scope="session")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """All of METHODS, each by its name in small letters."""
    classes = re.findall(r"class (\w+)", METHODS)
    with pytest.MonkeyPatch.context() as patch:
        _plug(tmp_path_factory.mktemp("plugged") / "site", patch, **{name.lower(): name for name in classes})
        yield
