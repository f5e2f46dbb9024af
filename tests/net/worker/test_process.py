"""Workers in a process of their own: pictures, errors, and a process that crashes, hangs or ends."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from dataclasses import replace
from functools import partial

import aiohttp
import numpy as np
import psutil
import pytest

from glsplat.camera import Camera
from glsplat.errors import ContextError, ContextLostError, GlsplatError, PoseError, ProtocolError
from glsplat.net.backend import RenderJob
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from glsplat.net.worker import connection, slots
from glsplat.net.worker.encoding import PictureEncoder
from glsplat.net.worker.process import ProcessLauncher, process_worker
from glsplat.net.worker.remote import RemoteWorker
from glsplat.net.worker.slot_writer import SLOTS
from tests.net.running import working
from tests.net.wire import HANG, until
from tests.net.worker.fakes import Boxed


def request(frame_id=1, x=10, y=20, grey=100, size=(64, 48), eyes=2):
    K = np.array([[grey, 0, x], [0, 50, y], [0, 0, 1.0]])
    return RenderJob(frame_id=frame_id, cameras=(Camera(np.eye(4), K, *size),) * eyes)


def expected(x=10, y=20, grey=100, size=(64, 48), eyes=2):
    out = np.zeros((eyes, size[1], size[0], 4), np.uint8)
    out[:, y : y + 4, x : x + 8] = grey
    return out


def pid_of(driver: str) -> int:
    return int(driver.split()[1])


async def test_pictures_of_changing_size_and_place():
    """Only what is covered is copied: nothing of the picture before may show."""
    rng = np.random.default_rng(0)
    async with working(process_worker(Boxed, 64)) as worker:
        for i in range(40):
            size = (int(rng.integers(20, 65)), int(rng.integers(20, 65)))
            place = {"x": int(rng.integers(0, size[0] - 8)), "y": int(rng.integers(0, size[1] - 4))}
            kind = place | {"grey": int(rng.integers(1, 255)), "size": size, "eyes": int(rng.integers(1, 3))}
            rendered = await worker.draw(request(50 if i % 7 == 3 else 1, **kind))
            np.testing.assert_array_equal(rendered.images, expected(**kind))
            assert rendered.timings == {"draw": 1.5} and rendered.encoded is None
            rendered.done()


async def test_pixels_of_a_worker_that_encodes():
    """Asked for them, it sends the same pixels; else its JPEGs."""
    async with working(RemoteWorker(ProcessLauncher(Boxed))) as worker:
        for frame_id in (1, 50, 1):  # 50: what is covered is not known
            rendered = await worker.draw(request(frame_id, x=3, grey=70), pixels=True)
            np.testing.assert_array_equal(rendered.images, expected(x=3, grey=70))
            assert rendered.encoded is None
            encoded = await (await worker.draw(request(frame_id))).encoded
            assert [jpeg[:2] for jpeg in encoded.pictures] == [b"\xff\xd8"] * 2


async def test_pixels_too_many_for_a_message_fail_one_picture():
    async with working(RemoteWorker(ProcessLauncher(Boxed))) as worker:
        with pytest.raises(GlsplatError, match="8193x8192 pixels are more than a worker can send"):
            await worker.draw(request(size=(8193, 8192)), pixels=True)
        assert (await worker.draw(request(), pixels=True)).images.any()


async def test_pictures_stay_until_they_are_done_with():
    async with working(process_worker(Boxed, 64)) as worker:
        held = [await worker.draw(request(grey=grey)) for grey in range(10, 10 + SLOTS)]
        for grey, rendered in enumerate(held, 10):
            np.testing.assert_array_equal(rendered.images, expected(grey=grey))
        another = asyncio.create_task(worker.draw(request(grey=40)))
        await asyncio.sleep(0.05)
        assert not another.done()  # there is no room for it
        held[1].done()
        newest = await another
        np.testing.assert_array_equal(held[0].images, expected(grey=10))
        np.testing.assert_array_equal(held[2].images, expected(grey=12))
        np.testing.assert_array_equal(newest.images, expected(grey=40))


async def test_errors_come_back_as_what_they_are():
    async with working(process_worker(Boxed, 64)) as worker:
        for frame_id, error, words in (
            (92, RuntimeError, "ZeroDivisionError"),
            (93, PoseError, "^no such joint$"),
            (94, ContextLostError, "^lost$"),
            (95, GlsplatError, "^out of memory$"),
        ):
            with pytest.raises(error, match=words):
                await worker.draw(request(frame_id))
        with pytest.raises(GlsplatError, match="80x80 pixels are more than the server was started for"):
            await worker.draw(request(size=(80, 80)))
        for _ in range(6):  # no slot was lost
            (await worker.draw(request())).done()


@pytest.mark.check
@pytest.mark.parametrize(
    ("fault", "words"),
    [(ContextError("no EGL here"), "no EGL here"), (RuntimeError(), r"the worker's process ended \(exit code 3\)")],
)
async def test_a_backend_that_cannot_open(fault, words):
    before = {*psutil.Process().children()}
    with pytest.raises(ContextError, match=f"^{words}$"):
        await process_worker(partial(Boxed, fault), 64).open(lambda: None)
    new = {*psutil.Process().children()} - before
    assert all("spawn_main" not in " ".join(child.cmdline()) for child in new)


@pytest.mark.check
async def test_a_driver_that_hangs_is_given_up(monkeypatch):
    worker, lost = process_worker(Boxed, 64, seconds=0.0), []
    driver = await worker.open(lambda: lost.append(1))
    with monkeypatch.context() as patch:
        patch.setattr(connection, "HANG_S", 0.3)
        with pytest.raises(ContextLostError, match=r"did not (answer|draw) within 0\.3 s"):
            await worker.draw(request(70))
        began = time.monotonic()
        again = await worker.rebuild()  # by force: it is not asked to end in order
    assert lost == [1] and again != driver and not psutil.pid_exists(pid_of(driver))
    assert time.monotonic() - began < HANG
    (await worker.draw(request())).done()
    await worker.close()


@pytest.mark.check
async def test_a_renderer_that_crashes_is_started_again(serve, cameras):
    """One picture is lost, the connection stays."""
    async with serve(process_worker(Boxed, 64), ServerConfig(port=0)) as server:
        async with Client(server.url) as client:
            before = (await client.render(cameras)).info["driver"]
            client._connection.flow.newest = 89  # 90: a segmentation fault
            with pytest.raises(ProtocolError, match=r"^the picture could not be drawn$"):
                await client.render(cameras)
            after, rebuilds = (await client.render(cameras)).info["driver"], server.stats()["rebuilds"]
    assert before != after and rebuilds == 1


@pytest.mark.check
async def test_no_process_or_file_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(slots, "SHM", str(tmp_path))
    own = psutil.Process()
    before = own.num_fds()
    for _ in range(2):
        worker = process_worker(Boxed, 64)
        pid = pid_of(await worker.open(lambda: None))
        assert list(tmp_path.iterdir()) == []  # the name is gone as soon as both sides have it
        (await worker.draw(request())).done()
        await worker.close()
        await worker.close()  # harmless
        assert not psutil.pid_exists(pid)
    del worker
    await asyncio.sleep(0.01)  # its connection is closed
    assert own.num_fds() <= before + 2


async def test_the_loop_runs_while_the_renderer_holds_its_lock(serve):
    """A picture that takes long keeps nobody waiting for an answer."""
    async with serve(process_worker(Boxed, 64), ServerConfig(port=0)) as server:
        async with Client(server.url) as client:
            client._connection.flow.newest = 68
            await client.send(request().cameras)  # 69: never comes back
            await until(lambda: server.drawer.drawing_for)
            async with aiohttp.ClientSession() as http:
                async with http.get(server.url.replace("ws:", "http:").replace("/ws", "/stats")) as answer:
                    status = answer.status
            os.kill(int(server.drawer.driver.split()[1]), signal.SIGKILL)
            with pytest.raises(ProtocolError, match="could not be drawn"):
                await client.receive()
            assert status == 200


class FaultyEncoder(Boxed):
    """Its worker's encoder returns a number that no message can hold."""

    def open(self):
        encode = PictureEncoder._jpegs
        PictureEncoder._jpegs = lambda *given: replace(encode(*given), ms=np.float32(1))
        return super().open()


async def test_jpegs_that_cannot_be_packed_fail_one_picture():
    async with working(RemoteWorker(ProcessLauncher(FaultyEncoder))) as worker:
        for _ in range(2):
            rendered = await worker.draw(request())
            with pytest.raises(RuntimeError, match="float32"):
                await asyncio.wait_for(rendered.encoded, HANG)
