"""Stage times, and the size of pictures that a server can draw often enough."""

from __future__ import annotations

import asyncio

import pytest

from glsplat.net.internal_client import Fitted, fit
from glsplat.net.pace.stages import StageTimes
from glsplat.net.server import ServerConfig
from tests.net.conftest import FakeBackend


@pytest.mark.parametrize(
    ("seconds", "expected"),  # for a megapixel, both eyes
    [(0.02, (1024, True)), (0.1, (768, True)), (0.2, (512, True)), (1.0, (512, False))],
)
def test_the_largest_that_is_fast_enough_counts(seconds, expected):
    asked = []

    async def draw(side):
        asked.append(side)
        slow = 5.0 if asked.count(side) == 1 else 1.0  # the first of a size makes what the others find
        return slow * seconds * (side / 1024) ** 2

    found = asyncio.run(fit(draw))
    assert (found.side, found.enough) == expected
    assert found.rate == pytest.approx(1 / (seconds * (found.side / 1024) ** 2))
    assert asked[:3] == [512] * 3 and sum((side / 512) ** 2 for side in asked) * seconds < 12 / 15 * 4


def test_a_server_says_what_it_found(serve):
    async def main(fitting):
        async with serve(FakeBackend(delay=0.0), config=ServerConfig(port=0, fit=fitting)) as server:
            before = server.session()
            if server.fitting is not None:
                await server.fitting
            return before, server.fitted, server.session(), server.stats()["totals"]["sent"]

    before, fitted, offer, sent = asyncio.run(main(True))
    assert before["size"] == (1024, 1024)  # whoever comes at once is not kept waiting
    assert isinstance(fitted, Fitted) and offer["size"] == (fitted.side,) * 2
    assert offer["rate"] == round(fitted.rate, 1) and sent == 0  # nobody was sent anything
    assert asyncio.run(main(False))[0]["size"] == (1024, 1024)


def test_frames_are_counted_and_the_last_ones_summed_up():
    times = StageTimes(3)
    for ms in (1000.0, 1.0, 2.0, 6.0):
        times.add({"draw": ms})
    times.add({"encode": 0.5})
    assert times.frames == 5 and times.lately(60)
    summary = times.summary()
    assert summary["draw"]["median"] == 2.0 and summary["encode"] == {"median": 0.5, "p95": 0.5}
