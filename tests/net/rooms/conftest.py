"""Rooms on a machine of any speed: time is what a test says it is."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from glsplat.net import conversation, server
from glsplat.net.rooms import person


@pytest.fixture
def nobody_fades(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the others' pictures take."""
    monkeypatch.setattr(person, "SILENT", 1e6)


class Hands:
    """A clock that is turned by hand."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.of: Callable[[], float] = lambda: self.now

    def __call__(self) -> float:
        return self.of()


@pytest.fixture
def hands(monkeypatch: pytest.MonkeyPatch) -> Hands:
    """What the server reads; a render loop is given it once it is there."""
    clock = Hands()
    for module in (conversation, server):
        monkeypatch.setattr(module, "clock", clock)
    return clock
