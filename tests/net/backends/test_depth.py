"""Depth on the wire: against the renderer's own depth at full size, in the user's metres."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from functools import partial

import aiohttp
import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.net.backend import RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.backends.scene_renderer import depth_grids
from glsplat.net.codec.encoded import GRID_SIDE, grid_of
from glsplat.net.reply import parse_reply
from glsplat.net.wire_schema import PictureOptions
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.worker import ThreadWorker
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.net.running import working
from tests.net.wire import HANG, native

SIZE = (320, 256)
PAIR = stereo_cameras(head_matrix((0.2, 1.1, 1.5), (0, 0, 0, 1)), size=SIZE)
REACHING = Pose.from_smplx({"body_pose": np.eye(21 * 3)[47].reshape(21, 3) * 1.2})


def job(depth: bool = True, **more: object) -> RenderJob:
    return RenderJob(cameras=PAIR, pose=REACHING, options=PictureOptions(depth=depth), **more)  # type: ignore[arg-type]


@pytest.mark.gl
def test_it_is_how_far_away_the_picture_is():
    """Where the avatar covers: at most 3 cm off in the median, at the coarsest level."""
    with Renderer(default_avatar(), size=SIZE, views=2) as renderer:
        images, depths = renderer.render(PAIR, REACHING, depth=True)
        grids = depth_grids(renderer, PAIR, REACHING)
    rows, columns = (np.linspace(0, length - 1, GRID_SIDE).round().astype(int) for length in (SIZE[1], SIZE[0]))
    for image, true, grid in zip(images, depths, grids, strict=True):
        inside = image[..., 3] > 0.9 * image[..., 3].max()
        at = np.ix_(rows, columns)
        off = np.abs(grid.metres() - true[at])[inside[at]]
        assert inside[at].sum() > 30
        assert np.median(off) <= 0.03 and np.percentile(off, 95) <= 0.06, np.percentile(off, [50, 80, 95])


@pytest.mark.gl
@pytest.mark.parametrize("own_process", [False, pytest.param(True, marks=pytest.mark.check)])
async def test_the_pictures_are_what_they_are_without_it(own_process):
    make = partial(RendererBackend, default_avatar(), SIZE)
    async with working(process_worker(make, 512) if own_process else ThreadWorker(make())) as worker:
        shown = []
        for depth in (False, True, False):
            rendered = await worker.draw(job(depth))
            assert len(rendered.depth) == (2 if depth else 0) and ("depth" in rendered.timings) == depth
            shown.append((rendered.images.tobytes(), rendered.levels, rendered.covered, rendered.coarsest))
            if rendered.done is not None:
                rendered.done()
        assert shown[0] == shown[1] == shown[2]


async def test_it_is_sent_to_clients_that_ask(serve, fake_backend):
    """And no other gets a byte more."""

    class Deep(fake_backend):
        def render(self, request):
            rendered = super().render(request)
            grid = grid_of(np.full((GRID_SIDE, GRID_SIDE), 0.8))
            return replace(rendered, depth=(grid,) * len(rendered.images)) if request.options.depth else rendered

    async with serve(Deep()) as server, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url) as ws:
            answers = []
            asked = [{}, {"depth": True}, {"depth": False}, {"depth": 1}]
            for number, more in enumerate(asked, 1):
                await ws.send_str(native(number, **{"ack": number - 1, **more}))
                answers.append((await asyncio.wait_for(ws.receive(), HANG)).data)
            plain, deep, without, refused = answers
    assert parse_reply(plain).depth == parse_reply(without).depth == ()
    assert "depth" not in parse_reply(plain).info
    assert len(parse_reply(deep).depth) == 2 and np.allclose(parse_reply(deep).depth[1].metres(), 1.25, atol=1e-4)
    assert json.loads(refused)["error"]["code"] == "bad_field"
