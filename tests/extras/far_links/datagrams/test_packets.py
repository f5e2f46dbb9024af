"""Pictures in datagrams: the erasure code, losses, made-up packets."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from glsplat.extras.far_links.datagrams.erasure import parity_of, restored
from glsplat.extras.far_links.datagrams.packets import (
    HEAD,
    LARGEST,
    PIECE,
    REQUEST,
    Assembler,
    groups_of,
    packets_of,
    parity_for,
)

SIZES = (1, PIECE - 1, PIECE, PIECE + 1, 63_000, 160 * PIECE, 160 * PIECE + 1, 500_000)


def lossy(packets: list[bytes], nbytes: int, parity: int, chance: Random, more: int = 0) -> list[bytes]:
    """Return what is left where each group loses as many as its parity makes up for (and ``more``), shuffled."""
    pieces, groups = groups_of(nbytes)
    left = []
    for group in range(groups):
        own = [p for i, p in enumerate(packets) if (i if i < pieces else i - pieces) % groups == group]
        left += chance.sample(own, len(own) - min(parity + more, len(own)))
    chance.shuffle(left)
    return left


@pytest.mark.parametrize(("count", "parity"), [(1, 1), (5, 3), (160, 95), (200, 55)])
def test_any_pieces_make_up_for_as_many(count: int, parity: int) -> None:
    rng = np.random.default_rng(count)
    pieces = rng.integers(0, 256, (count, 40), np.uint8)
    more = parity_of(pieces, parity)
    for trial in range(5):
        lost = rng.choice(count + parity, parity, replace=False)
        there = pieces.copy()
        missing = sorted(int(i) for i in lost if i < count)
        there[missing] = 0
        restored(there, missing, {row: more[row] for row in range(parity) if count + row not in lost})
        assert np.array_equal(there, pieces), trial


@pytest.mark.parametrize("nbytes", SIZES)
@pytest.mark.parametrize("parity", [0, 1, 7])
def test_a_picture_is_whole_once_and_without_what_was_lost(nbytes: int, parity: int) -> None:
    chance = Random(nbytes + parity)
    message = chance.randbytes(nbytes)
    whole = Assembler()
    found = [whole.add(p) for p in lossy(packets_of(9, message, parity), nbytes, parity, chance)]
    assert [one for one in found if one] == [(9, message)]
    assert whole.add(packets_of(9, message, parity)[0]) is None


def test_one_more_lost_is_too_much() -> None:
    chance, message = Random(3), Random(4).randbytes(63_000)
    whole = Assembler()
    assert not any(whole.add(p) for p in lossy(packets_of(1, message, 3), 63_000, 3, chance, more=1))


def test_the_newest_wins() -> None:
    whole = Assembler()
    old, new = packets_of(1, b"old" * 800, 0), packets_of(2, b"new" * 800, 0)
    assert [whole.add(p) for p in [*old[:2], *new, *old[2:]]].count((2, b"new" * 800)) == 1
    assert not any(whole.add(p) for p in old)


def test_what_is_made_up_is_nothing() -> None:
    """Lies about sizes, numbers and kinds: nothing is kept without bound."""
    chance, whole = Random(5), Assembler(REQUEST, 65_536)
    good = packets_of(70_000, b"x" * 3000, 0, REQUEST)
    made_up = [b"", b"\0", good[0][:-1], HEAD.pack(REQUEST, 255, 0, 70_000, 3000) + b"x" * PIECE]
    made_up += [HEAD.pack(REQUEST, 0, 0, 70_000, LARGEST) + b"x" * PIECE, HEAD.pack(0, 0, 0, 70_000, 5) + b"x" * 5]
    made_up += [HEAD.pack(REQUEST, 0, 60_000, 70_000, 3000) + b"x" * PIECE]
    made_up += [
        HEAD.pack(REQUEST, chance.randrange(96), chance.randrange(60), chance.randrange(60_000), 60_000) + b"y" * PIECE
        for _ in range(5000)
    ]
    for datagram in made_up:
        found = whole.add(datagram)
        assert found is None or found[0] < 70_000
    assert len(whole._unfinished) <= 8
    assert [one for one in map(whole.add, good) if one] == [(70_000, b"x" * 3000)]


def test_a_request_that_has_to_be_restored_is_none() -> None:
    """Restoring costs a server more than drawing."""
    message = Random(6).randbytes(60_000)
    datagrams = packets_of(1, message, 60, REQUEST)
    strict, usual = Assembler(REQUEST, 65_536, parity=0), Assembler(REQUEST, 65_536)
    assert not any(strict.add(one) for one in datagrams)
    assert any(usual.add(one) for one in datagrams[-60:])


@pytest.mark.parametrize("loss", [0.001, 0.01, 0.03, 0.1])
@pytest.mark.parametrize("pieces", [8, 25, 56, 160])
def test_nearly_all_pictures_are_whole(loss: float, pieces: int) -> None:
    rng = np.random.default_rng(1)
    parity = parity_for(pieces, loss)
    lost = rng.binomial(pieces + parity, loss, 20_000)
    most = max(2, round(0.4 * pieces))
    assert (lost > parity).mean() < 0.005 or parity == most
    assert 0 <= parity <= most and (parity < most or loss >= 0.03)
    assert parity_for(pieces, loss / 4) <= parity


@pytest.mark.parametrize(
    ("pieces", "loss", "parity"), [(50, 0.0, 0), (8, 0.0003, 0), (50, 0.5, 20), (1, 0.9, 2), (56, 0.001, 1)]
)
def test_redundancy_at_its_bounds(pieces: int, loss: float, parity: int) -> None:
    assert parity_for(pieces, loss) == parity
