"""Slots of shared memory: pictures drawn into them, and no room for one."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import pytest

from glsplat.camera import Camera, head_matrix, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import ContextError, GlsplatError
from glsplat.net.backend import MemoryTarget, RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.worker import slots
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.slot_writer import SLOTS, slot_writers
from glsplat.net.worker.slots import Slots
from glsplat.net.worker.wire import greet
from glsplat.net.worker.work import work_in_process
from glsplat.renderer import Renderer
from tests.net.running import working
from tests.net.worker.fakes import Boxed

SIDE = 1200  # a pair takes 11 MiB, of which 8 are set aside at the start


def request(side: int) -> RenderJob:
    K = np.array([[100, 0, side - 20], [0, 50, side - 20], [0, 0, 1.0]])
    return RenderJob(frame_id=1, cameras=(Camera(np.eye(4), K, side, side),) * 2)


def no_room(descriptor: int, start: int, length: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def full(tmp_path, monkeypatch) -> Callable[[], AbstractContextManager[None]]:
    """Pictures go to a folder; no file there can grow within ``full()``."""
    monkeypatch.setattr(slots, "SHM", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    @contextmanager
    def within() -> Iterator[None]:
        with monkeypatch.context() as patch:
            patch.setattr("os.posix_fallocate", no_room)
            yield

    return within


async def test_memory_that_fills_up_fails_one_picture(full):
    async with working(process_worker(Boxed, SIDE)) as worker:
        assert worker.launcher.slots.folder == slots.SHM
        with full():
            for _ in range(SLOTS):
                with pytest.raises(GlsplatError, match=r"^no room for a picture of 11\.0 MiB: .* is full$") as error:
                    await worker.draw(request(SIDE))
                assert not isinstance(error.value, ContextError)
            (await worker.draw(request(1000))).done()  # what was set aside at the start is there
        rendered = await worker.draw(request(SIDE))
        assert rendered.images[:, -20:-16, -20:-12].min() == 100 and worker.launcher.slots.free == SLOTS - 1
        rendered.done()
    assert os.listdir(slots.SHM) == []


async def test_memory_that_is_full_at_the_start(full, tmp_path_factory, monkeypatch):
    with full(), pytest.raises(ContextError, match=r"^no room for pictures in memory or on disk: .* is full; free"):
        await process_worker(Boxed, SIDE).open(lambda: None)
    assert os.listdir(slots.SHM) == []
    # then another folder, where there is one with room
    reserve, calls = os.posix_fallocate, iter([no_room])
    monkeypatch.setattr("os.posix_fallocate", lambda *which: next(calls, reserve)(*which))
    monkeypatch.setattr("tempfile.tempdir", other := str(tmp_path_factory.mktemp("disk")))
    made = Slots(SIDE * SIDE)
    assert made.folder == other and os.listdir(slots.SHM) == []
    made.close()


def test_a_worker_without_its_slots_fails(tmp_path, monkeypatch):
    """It does not end as if the server had left."""
    monkeypatch.setattr("signal.signal", lambda *_: None)
    ours, theirs = socket.socketpair()
    with ours, theirs, ThreadPoolExecutor() as threads:
        greeting = threads.submit(greet, ours, b"s" * 32, worker=False)
        try:
            with pytest.raises(FileNotFoundError):
                work_in_process(theirs, b"s" * 32, Boxed, (str(tmp_path / "slots"), 4096))
        finally:
            theirs.close()
        assert greeting.exception() is not None


async def test_pictures_of_another_number_than_asked_for_take_no_slot():
    async with working(process_worker(TooMany, 64)) as worker:
        for _ in range(7):
            with pytest.raises(RuntimeError, match=r"pictures of shape \(2, 64, 64, 4\) were requested, \(3, 64"):
                await worker.draw(request(64))
            await asyncio.sleep(0)  # it is given back
        assert worker.launcher.slots.free == SLOTS


class TooMany(Boxed):
    def render(self, request):
        rendered = super().render(request)
        return type(rendered)(np.zeros((3, 64, 64, 4), np.uint8))


def pair(side: int):
    return stereo_cameras(head_matrix((0, 1.2, 2.2), (0, 0, 0, 1)), size=(side, side))


@pytest.mark.gl
async def test_a_slot_gets_the_same_picture_without_a_copy():
    backend, slots = RendererBackend(default_avatar(), (96, 96)), Slots(2 * 96 * 96 * 4)
    writers = slot_writers(slots.path, slots.nbytes)
    slots.unlink()
    backend.open()
    try:
        assert isinstance(backend, MemoryTarget)
        for side in (96, 64, 80):  # what is left of a larger picture must not shine through
            request, shape = RenderJob(frame_id=1, cameras=pair(side)), (2, side, side, 4)
            backend.out = None
            expected = backend.render(request).images
            slot = await slots.take(shape)
            backend.out = writers[slot.number].place(shape)
            backend.out.fill(77)
            rendered = backend.render(request)
            assert rendered.images is backend.out
            writers[slot.number].put(rendered, shape)
            np.testing.assert_array_equal(slot.picture, expected)
            slot.give_back()
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
