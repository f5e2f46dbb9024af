"""What the gateway does with pixels, whatever draws them: video, and observers that change pictures."""

from __future__ import annotations

import threading

import pytest

from glsplat.extras.workers.pool import WorkerPool
from glsplat.net.client import Client
from glsplat.net.feature import Feature
from glsplat.net.pace.fair_queue import FairQueue
from glsplat.net.server import ServerConfig
from glsplat.net.worker.process import ProcessLauncher, process_worker
from tests.extras.workers.fakes import GUARD, camera, until
from tests.extras.workers.sleeper import STEP, Sleeper

pytestmark = pytest.mark.check


class Dimming(Feature):
    """Halves the pictures of its clients."""

    def client_opened(self, client, asked):
        client.observe(self)

    def request_received(self, request):
        pass

    def picture_drawn(self, images):
        images[..., :3] //= 2

    def reply_sent(self, messages):
        pass


@pytest.mark.parametrize("pooled", [False, True])
async def test_an_observer_changes_pictures(serve, pooled):
    drawer = WorkerPool([ProcessLauncher(Sleeper)]) if pooled else process_worker(Sleeper, 64)
    async with serve(drawer, ServerConfig(port=0), features=[Dimming()]) as server:
        async with Client(server.url, timeout=GUARD) as client:
            (image,) = (await client.render([camera(16)])).images()
    assert abs(float(image[:, :24].mean()) - 16 * STEP / 2) < 2


@pytest.mark.parametrize("pooled", [False, True])
async def test_video(serve, pooled):
    pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")
    drawer = WorkerPool([ProcessLauncher(Sleeper)], video=True) if pooled else process_worker(Sleeper, 64)
    async with serve(drawer, ServerConfig(port=0, video=True)) as server:
        assert "vp9" in server.session()["video"]
        async with Client(server.url, video=True, timeout=GUARD) as video, Client(server.url, timeout=GUARD) as plain:
            for number in (1, 2, 3):
                reply = await video.render([camera(16)])
                assert reply.info["video"]["number"] == number and reply.video[0].shape[:2] == (64, 64)
                assert abs(float(reply.images()[0][:, :24].mean()) - 16 * STEP) < 6
            assert "video" not in (await plain.render([camera(16)])).info


async def test_coding_is_charged_where_the_client_is(serve, monkeypatch):
    """A client that moves while its video is coded leaves no debt with the worker that it has left."""
    video = pytest.importorskip("glsplat.extras.far_links.video")
    pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")
    coding, go, charged = threading.Event(), threading.Event(), []
    encode, charge = video.VideoStream.encode, FairQueue.charge

    def held(self, *given):
        coding.set()
        assert go.wait(GUARD)
        return encode(self, *given)

    def charge_(self, address, key, *given):
        charged.append((address, key) in self)
        charge(self, address, key, *given)

    monkeypatch.setattr(video.VideoStream, "encode", held)
    monkeypatch.setattr(FairQueue, "charge", charge_)
    drawer = WorkerPool([ProcessLauncher(Sleeper)] * 2, video=True)
    async with serve(drawer, ServerConfig(port=0, video=True)) as server:
        async with Client(server.url, video=True, timeout=GUARD) as client:
            for moves in (False, True):
                coding.clear()
                go.clear()
                await client.send([camera(16)])
                assert await until(coding.is_set)
                assert await until(lambda: not drawer.drawing_for)
                if moves:
                    (stream,) = server.clients.values()
                    (to,) = (one for one in drawer._render_loops if not one.clients)
                    drawer._move(stream, to)
                    assert (stream.address, stream) in to._turns
                go.set()
                assert (await client.receive()).reply.video
    assert charged == [True] * 3  # drawn, coded; drawn
