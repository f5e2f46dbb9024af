"""Shared memory without room: one picture fails with a line that says why, and no process dies of it."""

from __future__ import annotations

import errno
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from glsplat.camera import Camera
from glsplat.errors import ContextError, GlsplatError
from glsplat.net.backend import RenderJob
from glsplat.net.backends import slots
from glsplat.net.backends.process import ProcessBackend
from tests.net.backends.fakes import Boxed

MIB = 2**20
SIDE = 1200  # a pair takes 11 MiB, of which 8 are set aside at the start


def request(side: int) -> RenderJob:
    K = np.array([[100, 0, side - 20], [0, 50, side - 20], [0, 0, 1.0]])
    return RenderJob(frame_id=1, cameras=(Camera(np.eye(4), K, side, side),) * 2)


def no_room(descriptor: int, start: int, length: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def small(tmp_path, monkeypatch) -> Iterator[Callable]:
    """Pictures go to a folder with little room; as a context manager, none of which is left.

    A file system of its own where one may be mounted; else what the system would answer is made up.
    """
    folder = tmp_path / "shm"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=40m", "glsplat-test", str(folder)]
    mounted = subprocess.run(mount, capture_output=True).returncode == 0
    monkeypatch.setattr(slots, "SHM", str(folder))
    monkeypatch.setattr("tempfile.tempdir", str(folder))

    @contextmanager
    def full() -> Iterator[None]:
        if mounted:
            with open(folder / "filler", "wb") as file:
                left = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
                os.posix_fallocate(file.fileno(), 0, left)
                yield
            os.unlink(folder / "filler")
            return
        with monkeypatch.context() as patch:
            patch.setattr("os.posix_fallocate", no_room)
            yield

    yield full
    if mounted:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_memory_that_fills_up_fails_one_picture(small):
    backend = ProcessBackend(Boxed, SIDE)
    backend.open()
    try:
        assert backend._slots.folder == slots.SHM
        with small():
            for _ in range(4):  # every slot
                with pytest.raises(GlsplatError, match=r"^no room for a picture of 11\.0 MiB: .*shm is full$") as error:
                    backend.render(request(SIDE))
                assert not isinstance(error.value, ContextError)
            rendered = backend.render(request(1000))  # what was set aside at the start is there
            assert rendered.images[:, -20:-16, -20:-12].min() == 100
            rendered.done()
        rendered = backend.render(request(SIDE))
        assert rendered.images[:, -20:-16, -20:-12].min() == 100 and backend.free_slots == 2
        rendered.done()
    finally:
        backend.close()
    assert os.listdir(slots.SHM) == []


def test_memory_that_is_full_at_the_start(small, tmp_path, monkeypatch):
    backend = ProcessBackend(Boxed, SIDE)
    with small():
        with pytest.raises(ContextError, match=r"^no room for pictures in memory or on disk: .*shm is full; free some"):
            backend.open()
        backend.close()
    assert os.listdir(slots.SHM) == []
    if os.path.ismount(slots.SHM):  # another folder has room
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        with small():
            backend.open()
            assert backend._slots.folder == str(tmp_path)
            backend.render(request(SIDE)).done()
        backend.close()


def test_pictures_of_another_number_than_asked_for_take_no_slot():
    backend = ProcessBackend(TooMany, 64)
    backend.open()
    try:
        for _ in range(7):
            with pytest.raises(RuntimeError, match=r"pictures of shape \(2, 64, 64, 4\) were asked for, \(3, 64"):
                backend.render(request(64))
        assert backend.free_slots == 3
    finally:
        backend.close()


class TooMany(Boxed):
    def render(self, request):
        rendered = super().render(request)
        return type(rendered)(np.zeros((3, 64, 64, 4), np.uint8))
