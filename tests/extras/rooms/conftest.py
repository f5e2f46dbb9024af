"""Rooms on a machine of any speed, and somebody to be in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.extras.rooms import person
from glsplat.gl.context import Context, create_context


@pytest.fixture
def nobody_fades(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the others' pictures take."""
    monkeypatch.setattr(person, "SILENT_S", 1e6)


@pytest.fixture(scope="module")
def somebody() -> Avatar:
    """The embedded avatar at its coarsest."""
    return replace(default_avatar().levels[-1].content, levels=())


@pytest.fixture
def context() -> Iterator[Context]:
    """One of its own: the shared one would stay current for the backends of other tests on this thread."""
    made = create_context()
    yield made
    made.release()
