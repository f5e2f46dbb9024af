"""Datagrams over sockets of this machine, whose way there and back takes next to nothing."""

from __future__ import annotations

import pytest

from tests.net.wire import HANG


@pytest.fixture
def every_link_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """And a machine may be as slow as it is."""
    from glsplat.extras.far_links.datagrams import path, way  # here: aioquic may not be installed

    monkeypatch.setattr(way, "LONG", 0.0)
    monkeypatch.setattr(path, "_SILENT_S", HANG)
    monkeypatch.setattr(path, "_HANDSHAKE_S", HANG)
