"""Workers of a machine of any speed."""

from __future__ import annotations

import pytest

from glsplat.net.workers import farm, link, placement
from glsplat.net.workers import pump as pump_module
from tests.net.workers.fakes import patient


@pytest.fixture(autouse=True)
def _patience(monkeypatch):
    patient(monkeypatch)


@pytest.fixture
def equal(monkeypatch):
    """All pictures cost the same, however long they took: places go by the number of clients."""
    for module in (farm, pump_module):
        monkeypatch.setattr(module, "Client", lambda number, key, cost: placement.Client(number, key, 0.01))


@pytest.fixture
def silences(monkeypatch):
    """Why links were ended for which the worker had said nothing; short deadlines, so that this comes soon."""
    monkeypatch.setattr(link, "_BUSY", 0.5)
    monkeypatch.setattr(link, "_SILENT", 0.4)
    found, end = [], link.Link.end

    def listen(self, why, blames=False):
        if "did not" in why:
            found.append(why)
        end(self, why, blames)

    monkeypatch.setattr(link.Link, "end", listen)
    return found
