"""The backend in a process of its own: pictures, errors, and a process that crashes, hangs or ends."""

from __future__ import annotations

import os
import signal
from functools import partial

import aiohttp
import numpy as np
import psutil
import pytest

from glsplat.camera import Camera
from glsplat.errors import ContextError, ContextLostError, GlsplatError, PoseError, ProtocolError
from glsplat.net.backend import RenderJob
from glsplat.net.backends import process
from glsplat.net.backends.process import ProcessBackend
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from glsplat.net.worker import slots
from tests.net.wire import until
from tests.net.worker.fakes import Boxed


def request(frame_id=1, x=10, y=20, grey=100, size=(64, 48), eyes=2):
    K = np.array([[grey, 0, x], [0, 50, y], [0, 0, 1.0]])
    return RenderJob(frame_id=frame_id, cameras=(Camera(np.eye(4), K, *size),) * eyes)


def expected(x=10, y=20, grey=100, size=(64, 48), eyes=2):
    out = np.zeros((eyes, size[1], size[0], 4), np.uint8)
    out[:, y : y + 4, x : x + 8] = grey
    return out


@pytest.fixture(scope="module")
def backend():
    backend = ProcessBackend(Boxed, 64)
    backend.driver = backend.open()
    yield backend
    backend.close()


def test_pictures_of_changing_size_and_place(backend):
    """Only what is covered is copied: nothing of the picture before may show."""
    rng = np.random.default_rng(0)
    assert int(backend.driver.split()[1]) != os.getpid()
    for i in range(40):
        size = (int(rng.integers(20, 65)), int(rng.integers(20, 65)))
        place = {"x": int(rng.integers(0, size[0] - 8)), "y": int(rng.integers(0, size[1] - 4))}
        kind = place | {"grey": int(rng.integers(1, 255)), "size": size, "eyes": int(rng.integers(1, 3))}
        rendered = backend.render(request(50 if i % 7 == 3 else 1, **kind))
        np.testing.assert_array_equal(rendered.images, expected(**kind))
        assert rendered.timings == {"draw": 1.5} and rendered.driver == "boxed"
        rendered.done()


def test_pictures_stay_until_they_are_done_with(backend):
    held = [backend.render(request(grey=grey)) for grey in (10, 20, 30)]
    for grey, rendered in zip((10, 20, 30), held, strict=True):
        np.testing.assert_array_equal(rendered.images, expected(grey=grey))
    held[1].done()
    newest = backend.render(request(grey=40))
    np.testing.assert_array_equal(held[0].images, expected(grey=10))
    np.testing.assert_array_equal(held[2].images, expected(grey=30))
    np.testing.assert_array_equal(newest.images, expected(grey=40))
    for rendered in (held[0], held[2], newest):
        rendered.done()


def test_errors_come_back_as_what_they_are(backend):
    for frame_id, error, words in (
        (92, RuntimeError, "ZeroDivisionError"),
        (93, PoseError, "^no such joint$"),
        (94, ContextLostError, "^lost$"),
        (95, GlsplatError, "^out of memory$"),
    ):
        with pytest.raises(error, match=words):
            backend.render(request(frame_id))
    with pytest.raises(GlsplatError, match="80x80 pixels are more than the server was started for"):
        backend.render(request(size=(80, 80)))
    for _ in range(6):  # no slot was lost
        backend.render(request()).done()


@pytest.mark.check
@pytest.mark.parametrize(
    ("fault", "words"),
    [(ContextError("no EGL here"), "no EGL here"), (RuntimeError(), "the renderer's process has ended")],
)
def test_a_backend_that_cannot_open(fault, words):
    before = {*psutil.Process().children()}
    with pytest.raises(ContextError, match=f"^{words}$"):
        ProcessBackend(partial(Boxed, fault), 64).open()
    new = {*psutil.Process().children()} - before
    assert all("spawn_main" not in " ".join(child.cmdline()) for child in new)


@pytest.mark.check
def test_a_driver_that_hangs_is_given_up(monkeypatch):
    backend, told = ProcessBackend(Boxed, 64, seconds=0.0), []
    driver = backend.open()
    with monkeypatch.context() as patch:
        patch.setattr(process, "_HANG", 0.3)
        with pytest.raises(ContextError, match=r"did not answer within 0\.3 s"):
            backend.render(request(70))
        patch.setattr(backend._pipe, "send", told.append)
        backend.close()
    assert told == []  # it is not asked to end in order
    assert not psutil.pid_exists(int(driver.split()[1])) and backend.open() != driver
    backend.render(request()).done()
    backend.close()


@pytest.mark.check
async def test_a_renderer_that_crashes_is_started_again(serve, cameras):
    """One picture is lost, the connection stays."""
    async with serve(ProcessBackend(Boxed, 64), ServerConfig(port=0)) as server:
        async with Client(server.url) as client:
            before = (await client.render(cameras)).info["driver"]
            client._connection.flow.newest = 89  # 90: a segmentation fault
            with pytest.raises(ProtocolError, match=r"^the picture could not be drawn$"):
                await client.render(cameras)
            after, rebuilds = (await client.render(cameras)).info["driver"], server.stats()["rebuilds"]
    assert before != after and rebuilds == 1


@pytest.mark.check
def test_no_process_or_file_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(slots, "SHM", str(tmp_path))
    own = psutil.Process()
    before = own.num_fds()
    for _ in range(2):
        backend = ProcessBackend(Boxed, 64)
        pid = int(backend.open().split()[1])
        assert list(tmp_path.iterdir()) == []  # the name is gone as soon as both sides have it
        backend.render(request()).done()
        backend.close()
        backend.close()  # harmless
        assert not psutil.pid_exists(pid)
    del backend
    assert own.num_fds() <= before + 2


async def test_the_loop_runs_while_the_renderer_holds_its_lock(serve):
    """A picture that takes long keeps nobody waiting for an answer."""
    async with serve(ProcessBackend(Boxed, 64), ServerConfig(port=0)) as server:
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
