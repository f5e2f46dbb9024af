"""Grids of inverse depth: what they hold, what is made up, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import ProtocolError
from glsplat.net.codec.encoded import DepthGrid, grid_of, read_grids
from glsplat.net.reply import pack_reply, parse_reply


def test_depths_come_back_within_their_steps():
    metres = np.random.default_rng(3).uniform(0.4, 5.0, (7, 5))
    grid = grid_of(1 / metres)
    assert (grid.columns, grid.rows, len(grid.data)) == (5, 7, 35)
    step = (1 / metres.min() - 1 / metres.max()) / 255
    assert np.abs(1 / grid.metres() - 1 / metres).max() <= 0.5001 * step


def test_where_nothing_is_it_goes_on_from_what_is_beside():
    inverse = np.full((6, 6), np.nan)
    inverse[1, 1], inverse[4, 4] = 2.0, 0.5
    metres = grid_of(inverse).metres()
    assert metres[1, 1] == pytest.approx(0.5) and metres[4, 4] == pytest.approx(2.0)
    assert metres[0, 0] == pytest.approx(0.5) and metres[5, 5] == pytest.approx(2.0)
    assert 0.5 <= metres.min() and metres.max() <= 2.0
    assert 0.5 < metres[1, 4] < 2.0  # as far from both
    assert np.isnan(inverse).sum() == 34  # what was given is left as it is


@pytest.mark.parametrize("inverse", [np.full((4, 3), np.nan), np.full((4, 3), 0.25)], ids=["nothing", "one plane"])
def test_flat_ones(inverse):
    metres = grid_of(inverse).metres()
    assert metres.shape == (4, 3) and np.ptp(metres) == 0 and np.isfinite(metres).all()


def test_a_reply_brings_them_behind_its_json():
    grids = (grid_of(np.linspace(0.2, 2, 12).reshape(3, 4)), grid_of(np.full((3, 4), 1.0)))
    said = {"depth": DepthGrid.fields(grids), "size": [8, 8]}
    pictures = [b"\xff\xd8a", b"\xff\xd8b"]
    data = pack_reply(7, (0, 1), pictures, said, None, [grid.data for grid in grids])
    reply = parse_reply(data)
    assert [one.data for one in reply.depth] == [one.data for one in grids]
    assert np.allclose(reply.depth[0].metres(), grids[0].metres(), atol=1e-4)
    assert parse_reply(pack_reply(7, (0, 1), pictures, {"size": [8, 8]})).depth == ()
    with pytest.raises(ProtocolError, match="depth of a reply"):
        parse_reply(data[:-1])


@pytest.mark.parametrize(
    "fields",
    [
        {"grid": [4, 3], "inverse": [[0.1, 1.0], [0.1, 1.0]]},
        *({"grid": grid, "inverse": [[0.1, 1.0]]} for grid in ([1, 12], [12, 100000], [4])),
        *({"grid": [4, 3], "inverse": [range_]} for range_ in ([-1.0, 1.0], [0.1, float("inf")], [0.1, float("nan")])),
        {"grid": "4 3", "inverse": 1},
        {"grid": [4, 3]},
        7,
    ],
)
def test_what_does_not_fit_is_refused(fields):
    with pytest.raises((KeyError, TypeError, ValueError)):
        read_grids(fields, bytes(12))


def test_what_is_a_thousand_kilometres_away_is_read_again():
    far = grid_of(np.full((3, 4), 1e-7))
    (again,) = read_grids(DepthGrid.fields((far,)), far.data)
    assert again.metres() == pytest.approx(np.full((3, 4), 1e7), rel=1e-5)
