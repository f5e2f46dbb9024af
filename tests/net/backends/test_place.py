"""Pictures drawn to where they are wanted: the slot of shared memory, whatever lay there before."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.net.backend import Placing, RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.backends.slots import Slots, SlotWriter
from glsplat.renderer import Renderer


def pair(side: int):
    return stereo_cameras(head_matrix((0, 1.2, 2.2), (0, 0, 0, 1)), size=(side, side))


@pytest.mark.gl
def test_a_slot_gets_the_same_picture_without_a_copy():
    backend, slots = RendererBackend(default_avatar(), (96, 96)), Slots(2 * 96 * 96 * 4)
    writer = SlotWriter(slots.path, slots.nbytes)
    slots.unlink()
    backend.open()
    try:
        assert isinstance(backend, Placing)
        for side in (96, 64, 80):  # what is left of a larger picture must not shine through
            request, shape = RenderJob(frame_id=1, cameras=pair(side)), (2, side, side, 4)
            backend.place = None
            expected = backend.render(request).images
            slot = slots.take(int(np.prod(shape)))
            backend.place = writer.place(slot, shape)
            backend.place.fill(77)
            rendered = backend.render(request)
            assert rendered.images is backend.place
            writer.put(slot, rendered, shape)
            np.testing.assert_array_equal(slots.picture(slot, shape), expected)
            slots.give_back(slot)
    finally:
        backend.close()
        slots.close()


@pytest.mark.gl
@pytest.mark.parametrize(
    "out",
    [
        np.empty((2, 32, 32, 3), np.uint8),
        np.empty((2, 32, 32, 4), np.float32),
        np.empty((2, 32, 64, 4), np.uint8)[:, :, ::2],
    ],
    ids=["shape", "type", "strides"],
)
def test_out_is_checked(out):
    with Renderer(default_avatar(), size=(32, 32), config=RenderConfig(output="uint8")) as renderer:
        with pytest.raises(GlsplatError, match=r"out needs a contiguous array \(2, 32, 32, 4\) of uint8"):
            renderer.render(pair(32), out=out)
        given = np.full((2, 32, 32, 4), 9, np.uint8)
        assert renderer.render(pair(32), out=given) is given
        np.testing.assert_array_equal(given, renderer.render(pair(32)))
