"""Workers of a machine of any speed."""

from __future__ import annotations

import pytest

from glsplat.extras.workers import placement, pool
from glsplat.net.worker import connection
from tests.extras.workers.fakes import patient


@pytest.fixture(autouse=True)
def _patience(monkeypatch):
    patient(monkeypatch)


@pytest.fixture
def equal(monkeypatch):
    """All pictures cost the same, however long they took: places go by the number of clients."""
    monkeypatch.setattr(pool, "PlacedClient", lambda number, key, _: placement.PlacedClient(number, key, 0.01))


@pytest.fixture
def silences(monkeypatch):
    """Why links were ended for which the worker had said nothing; short deadlines, so that this comes soon."""
    monkeypatch.setattr(connection, "_BUSY_S", 0.5)
    monkeypatch.setattr(connection, "_SILENT_S", 0.4)
    found, end = [], connection.WorkerConnection.end

    def listen(self, why, blames=False):
        if "did not" in why:
            found.append(why)
        end(self, why, blames)

    monkeypatch.setattr(connection.WorkerConnection, "end", listen)
    return found
