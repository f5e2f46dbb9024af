"""What passes count and keep: bytes, boxes, reach, targets, and owners in a cache."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import moderngl
import numpy as np
import pytest

from glsplat.gl.context import Context
from glsplat.renderer.mesh_pass import reach_of
from glsplat.renderer.owned import LruCache
from glsplat.renderer.stage import ItemBuffers
from glsplat.renderer.stats import union
from glsplat.renderer.targets import MAX_SIZES, TargetPool
from glsplat.shaders import Programs
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from tests.api.variants import sheet
from tests.skinning.faces import expressive


@dataclass
class Owner:
    nbytes: int
    released: bool = False

    def release(self) -> None:
        self.released = True


def test_the_box_of_two_boxes() -> None:
    assert union((10, 40, 5, 6), (12, 20, 9, 4)) == (10, 20, 11, 26)
    assert union((10, 20, 5, 6), (3, 40, 9, 4)) == (3, 20, 12, 24)
    assert union((0, 0, 0, 0), (3, 4, 5, 6)) == union((3, 4, 5, 6), (9, 9, 0, 3)) == (3, 4, 5, 6)


@pytest.mark.parametrize(("most_bytes", "kept"), [(100, True), (99, False)])
def test_a_cache_keeps_as_many_bytes_as_it_may(most_bytes: int, kept: bool) -> None:
    """Bytes of what is in use do not count."""
    cache: LruCache[str, Owner] = LruCache(8, most_bytes)
    first = cache.get("first", lambda: Owner(100))
    cache.get("second", lambda: Owner(1000))
    assert first.released != kept and len(cache) == 1 + kept


def test_the_reach_of_joints_is_to_the_farthest_vertex_that_rides_them() -> None:
    """A weight of zero does not ride, and nothing rides the last joint."""
    joints = np.array([[0.0, 0, 0], [0, 3, 0], [0, 9, 0]])
    skeleton = Skeleton.from_joints(("root", "arm", "tip"), [-1, 0, 1], joints)
    mesh = replace(sheet(), skeleton=skeleton)
    ids = np.array([[0, 2], [0, 1], [1, 0], [1, 2]])
    reach = reach_of(mesh, Skin.create(ids, [[1.0, 0], [0.5, 0.5], [1, 0], [1, 0]], 3))
    assert reach == pytest.approx([2**0.5, 17**0.5, -1])


@pytest.mark.gl
def test_bytes_of_an_item(context: Context) -> None:
    """An avatar with expressions has its own buffers and theirs."""
    avatar = expressive(300)
    assert avatar.skin is not None and avatar.shapes is not None
    with context.ctx:
        parts = [
            ItemBuffers(context, Programs(context.ctx), avatar.splats, avatar.skin, 4, False, shapes)
            for shapes in (None, avatar.shapes)
        ]
        plain, whole = (part.nbytes for part in parts)
        for part in parts:
            part.release()
    assert plain == 300 * (11 * 4 + avatar.skin.joints.itemsize * 4 + avatar.skin.weights.itemsize * 4)
    assert whole - plain >= avatar.shapes.texels().nbytes


@pytest.fixture
def pool(context: Context) -> Iterator[TargetPool]:
    with context.ctx:
        made = TargetPool(context, "f4")
        yield made
        made.release()
        assert made.nbytes == 0 and context.ctx.error == "GL_NO_ERROR"


@pytest.mark.gl
def test_a_size_used_again_is_not_made_again(pool: TargetPool) -> None:
    first, other = pool.float_target((8, 4), 2), pool.float_target((9, 4), 2)
    assert pool.float_target((8, 4), 2) is first and pool.float_target((9, 4), 2) is other
    assert pool.float_target((8, 4), 1) is not first
    assert first.shape == (2, 4, 8, 4)
    assert pool.byte_target((8, 4), 2) is pool.byte_target((8, 4), 2)
    assert pool.nbytes == (2 * 8 * 4 + 2 * 9 * 4 + 8 * 4) * 16 + 2 * 8 * 4 * 4


@pytest.mark.gl
def test_the_size_unused_for_longest_goes(pool: TargetPool) -> None:
    made = [pool.float_target((8 + i, 4), 1) for i in range(MAX_SIZES)]
    pool.float_target((8, 4), 1)  # the first was used again, so the second goes
    pool.byte_target((99, 4), 1)
    pool.float_target((99, 4), 1)
    assert pool.float_target((8, 4), 1) is made[0]
    assert isinstance(made[1].texture.mglo, moderngl.InvalidObject)
    assert not isinstance(made[2].texture.mglo, moderngl.InvalidObject)


@pytest.mark.gl
def test_large_sizes_are_not_kept(pool: TargetPool) -> None:
    pool._sizes.most_bytes = 1000
    small, large = pool.float_target((4, 4), 1), pool.float_target((64, 64), 1)
    assert (
        pool.float_target((4, 4), 1) is small and pool.float_target((64, 64), 1) is large
    )  # nothing made: nothing goes
    pool.float_target((5, 4), 1)
    assert isinstance(large.texture.mglo, moderngl.InvalidObject) and pool.nbytes <= 1000 + 5 * 4 * 16
