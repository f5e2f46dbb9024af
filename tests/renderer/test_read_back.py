"""Pictures on their way from the GPU: the same bytes as those that are waited for, and no buffer that stays in use."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.errors import ContextLostError
from glsplat.renderer.read_back import PackBuffers
from glsplat.splats import Splats

SIZE = (120, 72)


@pytest.fixture
def buffers(gl):
    made = PackBuffers(gl)
    yield made
    made.release()


def figure() -> Splats:
    """Return a cloud of about a person's size."""
    rng = np.random.default_rng(2)
    means = rng.normal(size=(300, 3)) * (0.12, 0.3, 0.12) + (0, 1, 0)
    arrays = means, rng.normal(size=(300, 4)), np.full((300, 3), 0.05), np.full(300, 0.8), rng.normal(size=(300, 1, 3))
    return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def eyes(distance: float = 2.2, turn: float = 0.0) -> list[Camera]:
    pose = np.linalg.inv(look_at((0, 1.2, distance), (turn, 1, 0)) * [[1], [-1], [-1], [1]])
    return stereo_cameras(pose, size=SIZE)


def crossed() -> list[Camera]:
    """Return a pair that looks two ways: two passes of one view each."""
    places = ((0, 1.2, 2), (2, 1.2, 0))
    return [Camera(look_at(place, (0, 1, 0)), pinhole(*SIZE), *SIZE) for place in places]


VIEWS = {
    "a box": eyes(),
    "the whole picture": eyes(0.25),
    "a corner": eyes(3, turn=1.2),
    "nothing": eyes(turn=90),
    "two passes": crossed(),
    "one view": eyes()[:1],
}


def test_a_transfer_brings_the_bytes_of_a_picture(renderer_of, buffers):
    """Two at once, of which the second is drawn before the first is collected."""
    renderer = renderer_of(figure(), SIZE, views=2, output="uint8")
    expected = {name: renderer.render(views) for name, views in VIEWS.items()}
    before = None
    for name, views in [*VIEWS.items(), *VIEWS.items()]:
        transfer = buffers.transfer()
        images = renderer.prepare(views).render(transfer=transfer)
        assert buffers.used == (1 if before is None else 2)
        if before is not None:
            _check(*before, expected)
        before = transfer, name, images
    _check(*before, expected)
    assert buffers.used == 0 and len(buffers._free) == 2


def _check(transfer, name, images, expected) -> None:
    while not transfer.ready(1.0):
        pass
    transfer.collect()
    transfer.drop()
    np.testing.assert_array_equal(images, expected[name], err_msg=name)


def test_a_dropped_picture_releases_its_buffer(renderer_of, buffers):
    renderer = renderer_of(figure(), SIZE, views=2, output="uint8")
    for _ in range(5):
        transfer = buffers.transfer()
        renderer.prepare(eyes()).render(transfer=transfer)
        transfer.drop()
        transfer.drop()
        assert buffers.used == 0 and len(buffers._free) == 1


def test_a_larger_picture_gets_a_larger_buffer(renderer_of, buffers):
    renderer = renderer_of(figure(), SIZE, views=2, output="uint8")
    for side in (64, 200, 64):
        renderer.resize(side, side)
        views = stereo_cameras(np.linalg.inv(eyes()[0].viewmat) * [[1, -1, -1, 1]], size=(side, side))
        expected, transfer = renderer.render(views), buffers.transfer()
        images = renderer.prepare(views).render(transfer=transfer)
        _check(transfer, "", images, {"": expected})
    assert [buffer.size for buffer in buffers._free] == [2 * 200 * 200 * 4 + 4]


@pytest.mark.parametrize("fault", ["old pixels", "no memory"])
def test_a_lost_context_shows_no_older_picture(renderer_of, buffers, monkeypatch, fault):
    renderer = renderer_of(figure(), SIZE, views=2, output="uint8")
    first = buffers.transfer()
    renderer.prepare(eyes()).render(transfer=first)
    _check(first, "", images := renderer.render(eyes()), {"": images})
    lost = buffers.transfer()
    with monkeypatch.context() as patch:
        if fault == "old pixels":
            patch.setattr("moderngl.Framebuffer.read_into", lambda *_, **__: None)
        else:
            patch.setattr(buffers, "map", lambda *_: None)
        renderer.prepare(eyes()).render(transfer=lost)
        with pytest.raises(ContextLostError, match="does not respond"):
            lost.collect()
    lost.drop()
    assert buffers.used == 0


def test_released_buffers_are_not_used_again(renderer_of, gl):
    renderer = renderer_of(figure(), SIZE, views=2, output="uint8")
    buffers = PackBuffers(gl)
    transfer = buffers.transfer()
    renderer.prepare(eyes()).render(transfer=transfer)
    buffers.release()
    transfer.drop()
    assert buffers.used == 0 and not buffers._free
