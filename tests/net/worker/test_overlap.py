"""A picture is begun while the GPU draws the one before: order, latency, errors, and buffers that are released."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import BudgetError, ContextLostError, GlsplatError, ProtocolError
from glsplat.net.backend import Rendered, RenderJob, Submitted
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.client import Client
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.slot_writer import SLOTS
from glsplat.net.worker.worker import ThreadWorker, Worker
from glsplat.renderer.read_back import PackBuffers
from tests.net.running import opened, working
from tests.net.wire import HANG, until
from tests.net.worker.fakes import Overlapped
from tests.net.worker.test_process import expected, request

FRAMES = 20
WORKERS = {"process": lambda: process_worker(Overlapped, 64), "thread": lambda: ThreadWorker(Overlapped())}


@pytest.fixture(params=WORKERS)
def make(request) -> Callable[[], Worker]:
    return WORKERS[request.param]


async def submitted(worker: Worker, job: RenderJob) -> asyncio.Task[Rendered]:
    """Order a picture; return once the next one may be ordered."""
    event = asyncio.Event()
    drawing = asyncio.create_task(worker.draw(job, submitted=event.set))
    async with asyncio.timeout(HANG):
        await event.wait()
    return drawing


async def test_a_picture_is_begun_while_the_gpu_draws_the_one_before(make):
    async with working(make()) as worker, asyncio.timeout(HANG):
        before, was = await submitted(worker, request(60, grey=5)), 5  # it is never ready by itself
        for grey in (10, 20, 30, 40, 50):
            assert not before.done()
            drawing = await submitted(worker, request(60, grey=grey))
            rendered = await before
            np.testing.assert_array_equal(rendered.images, expected(grey=was))
            assert rendered.timings["begun"] == rendered.timings["collected"] + 2
            if rendered.done is not None:
                rendered.done()
            before, was = drawing, grey
        await worker.draw(request(1))
        await before


async def test_a_picture_alone_does_not_wait_for_another(make):
    async with working(make()) as worker, asyncio.timeout(HANG):
        for _ in range(6):
            rendered = await worker.draw(request(1))
            assert rendered.timings["begun"] == rendered.timings["collected"] + 1
            if rendered.done is not None:
                rendered.done()


async def test_a_failure_leaves_the_other_picture(make):
    async with working(make()) as worker, asyncio.timeout(HANG):
        before = await submitted(worker, request(60, grey=10))
        with pytest.raises(GlsplatError, match="out of memory"):
            await worker.draw(request(95))
        lost = await submitted(worker, request(96))
        np.testing.assert_array_equal((await before).images, expected(grey=10))
        after = await submitted(worker, request(1, grey=30))
        with pytest.raises(ContextLostError, match="lost"):
            await lost
        np.testing.assert_array_equal((await after).images, expected(grey=30))


class Ringed(RendererBackend):
    """Reads by buffers as on a GPU, which needs one look longer than it has to."""

    def __init__(self) -> None:
        super().__init__(default_avatar(), (64, 64))

    def open(self) -> str:
        driver = super().open()
        self._buffers = PackBuffers(self._context)
        wait, seen = self._buffers.wait, set()

        def waited(fence: int, flags: int, nanoseconds: int) -> int:
            if fence in seen:
                seen.remove(fence)
                return wait(fence, flags, nanoseconds)
            seen.add(fence)
            return 0x911B  # GL_TIMEOUT_EXPIRED

        self._buffers.wait = waited
        return driver


def pair(side: int, x: float = 0.0) -> RenderJob:
    return RenderJob(cameras=stereo_cameras(head_matrix((x, 1.2, 2.2), (0, 0, 0, 1)), size=(side, side)))


JOBS = [pair(64), pair(96, 0.1), replace(pair(64, 0.2), notice="Hello"), pair(64, 5.0)]


@pytest.fixture(scope="module")
def pictures() -> list[Rendered]:
    """Those of the backend that waits for each."""
    with opened(RendererBackend(default_avatar(), (64, 64))) as backend:
        return [backend.render(job) for job in JOBS]


def check(rendered: Rendered, picture: Rendered) -> None:
    np.testing.assert_array_equal(rendered.images, picture.images)
    assert tuple(rendered.covered) == tuple(picture.covered)
    assert (rendered.levels, rendered.coarsest) == (picture.levels, picture.coarsest)
    if rendered.done is not None:
        rendered.done()


@pytest.mark.gl
async def test_a_process_draws_the_same_pictures(pictures):
    async with working(process_worker(Ringed, 128)) as worker:
        before = None
        for job, picture in zip(JOBS * 2, pictures * 2, strict=True):
            drawing = await submitted(worker, job)
            if before is not None:
                check(await before[0], before[1])
            before = drawing, picture
        check(await before[0], before[1])


@pytest.mark.gl
@pytest.mark.parametrize("how", ["collected", "abandoned", "failed", "lost", "closed"])
def test_no_buffer_stays_in_use(pictures, monkeypatch, how):
    with opened(Ringed()) as backend:
        abandoned: list[bool] = []
        backend.abandoned = lambda: bool(abandoned)
        first, second = backend.submit(JOBS[0]), backend.submit(JOBS[1])
        assert isinstance(first, Submitted) and isinstance(second, Submitted)
        buffers = backend._buffers
        assert buffers.used == 2
        if how == "collected":
            check(first.collect(), pictures[0])
        elif how == "abandoned":
            abandoned.append(True)
            with pytest.raises(BudgetError, match="no longer wanted"):
                first.collect()
            abandoned.clear()
        elif how == "failed":
            first.collect()
            with monkeypatch.context() as patch, pytest.raises(ZeroDivisionError):
                patch.setattr("glsplat.net.backends.scene_renderer.SceneRenderer.places", lambda *_: 1 / 0)
                backend.submit(JOBS[2])
        elif how == "lost":
            with monkeypatch.context() as patch, pytest.raises(ContextLostError):
                patch.setattr(buffers, "map", lambda *_: None)
                first.collect()
        else:  # and opened again, as after a lost context
            backend.close()
            assert buffers.used == 0
            backend.open()
            first, second = backend.submit(JOBS[0]), backend.submit(JOBS[1])
            first.collect()
        assert backend._buffers.used == 1
        check(second.collect(), pictures[1])
        assert backend._buffers.used == 0


async def test_replies_keep_their_order_while_pictures_overlap(serve, cameras, make):
    async with serve(make()) as server, asyncio.timeout(HANG):
        loop, under_way = server.drawer, []
        turn = loop._turn

        def noted(*of):
            under_way.append(len(loop._turning))
            return turn(*of)

        loop._turn = noted

        for got, errors in await asyncio.gather(*(stream(server.url, cameras) for _ in range(2))):
            assert got == sorted(set(got)) and got[-1] == FRAMES and not errors
        assert max(under_way) == 1  # a turn begins with at most one other under way
        await until(lambda: not loop._turning and not loop.clients)


class Overtaking(ThreadWorker):
    """Returns each first picture of two after the second."""

    def __init__(self, backend) -> None:
        super().__init__(backend)
        self.second = asyncio.Event()

    async def draw(self, job, pixels=False, submitted=lambda: None):
        rendered = await super().draw(job, pixels)
        submitted()
        if job.frame_id % 2:
            await self.second.wait()
        (self.second.clear if job.frame_id % 2 else self.second.set)()
        return rendered


async def test_a_picture_that_is_ready_first_waits_for_the_one_before(serve, fake_backend, cameras):
    async with serve(Overtaking(fake_backend())) as server, Client(server.url, window=2, timeout=HANG) as client:
        for first in (1, 3, 5):
            assert await client.send(cameras) == first
            await until(lambda: server.drawer._turning)
            await client.send(cameras)
            assert [(await client.receive()).reply.frame_id for _ in range(2)] == [first, first + 1]


async def stream(url: str, cameras) -> tuple[list[int], list[str]]:
    """Send FRAMES requests; return the frame_ids of the replies, and the errors."""
    got, errors = [0], []
    async with Client(url, window=3, timeout=HANG) as client:

        async def receive() -> None:
            while got[-1] < FRAMES:
                try:
                    got.append((await client.receive()).reply.frame_id)
                except ProtocolError as error:
                    errors.append(str(error))

        receiving = asyncio.create_task(receive())
        for _ in range(FRAMES):
            await client.send(cameras)
            await asyncio.sleep(0.002)
        await receiving
    return got[1:], errors


@pytest.mark.parametrize("own_process", [True, False])
async def test_a_lost_context_with_two_pictures_under_way(serve, cameras, own_process):
    """That of the older one is noticed when it is collected; the newer one is answered before the worker restarts."""
    worker = process_worker(Losing, 64) if own_process else ThreadWorker(Losing())
    async with serve(worker) as server, asyncio.timeout(HANG):
        async with Client(server.url, window=3, timeout=HANG) as client:
            await client.send(cameras)
            await until(lambda: server.drawer._turning)
            await client.send(cameras)
            with pytest.raises(ProtocolError, match="could not be drawn"):
                await client.receive()
            assert (await client.receive()).reply.frame_id == 2
            assert (await client.render(cameras)).frame_id == 3
        assert server.drawer.rebuilds == 1 and not server.drawer._turning


class Losing(Overlapped):
    """Loses its context with the first picture, once another one is begun."""

    def submit(self, request) -> Submitted:
        wanted = {1: 60, 2: 1}.get(request.frame_id, request.frame_id)
        drawn = super().submit(replace(request, frame_id=wanted))
        return drawn if request.frame_id != 1 else Submitted(drawn.ready, self._lose)

    def _lose(self) -> Rendered:
        raise ContextLostError("lost")


async def test_a_client_that_leaves_with_a_picture_under_way(serve, cameras, make):
    async with serve(make()) as server, asyncio.timeout(HANG):
        loop, begun = server.drawer, asyncio.Event()
        turn = loop._turn

        def noted(*of):
            begun.set()
            return turn(*of)

        loop._turn = noted
        for _ in range(3 * SLOTS):  # none of its slots is lost
            begun.clear()
            async with Client(server.url, window=3, timeout=HANG) as client:
                await client.send(cameras)
                await client.send(cameras)
                await begun.wait()
        assert (await stream(server.url, cameras))[0][-1] == FRAMES
        await until(lambda: not loop._turning and not loop.clients)
