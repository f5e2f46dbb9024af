"""Targets of a few sizes are kept, and no more."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import pytest

from glsplat.gl.context import Context
from glsplat.passes import target_pool
from glsplat.passes.target_pool import SIZES, TargetPool

pytestmark = pytest.mark.gl


@pytest.fixture
def pool(context: Context) -> Iterator[TargetPool]:
    with context.ctx:
        made = TargetPool(context, "f4")
        yield made
        made.release()
        assert made.nbytes == 0 and context.ctx.error == "GL_NO_ERROR"


def test_a_size_used_again_is_not_made_again(pool: TargetPool) -> None:
    first, other = pool.float_target((8, 4), 2), pool.float_target((9, 4), 2)
    assert pool.float_target((8, 4), 2) is first and pool.float_target((9, 4), 2) is other
    assert pool.float_target((8, 4), 1) is not first
    assert first.shape == (2, 4, 8, 4)
    assert pool.byte_target((8, 4), 2) is pool.byte_target((8, 4), 2)
    assert pool.nbytes == (2 * 8 * 4 + 2 * 9 * 4 + 8 * 4) * 16 + 2 * 8 * 4 * 4


def test_the_size_unused_for_longest_goes(pool: TargetPool) -> None:
    made = [pool.float_target((8 + i, 4), 1) for i in range(SIZES)]
    pool.float_target((8, 4), 1)  # the first was used again, so the second goes
    pool.byte_target((99, 4), 1)
    pool.float_target((99, 4), 1)
    assert pool.float_target((8, 4), 1) is made[0]
    assert isinstance(made[1].texture.mglo, moderngl.InvalidObject)
    assert not isinstance(made[2].texture.mglo, moderngl.InvalidObject)


def test_large_sizes_are_not_kept(pool: TargetPool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target_pool, "KEPT_BYTES", 1000)
    small, large = pool.float_target((4, 4), 1), pool.float_target((64, 64), 1)
    assert (
        pool.float_target((4, 4), 1) is small and pool.float_target((64, 64), 1) is large
    )  # nothing made: nothing goes
    pool.float_target((5, 4), 1)
    assert isinstance(large.texture.mglo, moderngl.InvalidObject) and pool.nbytes <= 1000 + 5 * 4 * 16
