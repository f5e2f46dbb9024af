"""serve --workers: what it takes, what it refuses, and a gateway of two from the command line's options."""

from __future__ import annotations

import asyncio
import sys

import pytest

import glsplat
from apps.serve.command import workers_of
from apps.serve.wiring import assemble
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import GlsplatError
from glsplat.extras.workers.pool import Workers
from glsplat.formats.scene_file import SceneFile
from glsplat.net.client import Client
from glsplat.net.served_scene import ServedScene
from glsplat.net.server import ServerConfig
from tests.apps.cli import serving


def asked(*words: str) -> Workers | None:
    return workers_of(serving(*words))


def test_what_it_takes(monkeypatch):
    monkeypatch.setattr("glsplat.extras.workers.cluster.require_ray", lambda: None)
    assert asked() is None
    assert asked("--workers", "2") == Workers(count=2)
    assert asked("--workers", "ray") == Workers(count=None, ray=True)
    words = ("worker-gpus=0.25", "worker-cpus=4", "ray-address=gpu1:6379")
    assert asked("--workers", "ray:8", *words) == Workers(count=8, ray=True, cpus=4, gpus=0.25, address="gpu1:6379")


def test_without_ray(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(GlsplatError, match=r"^work on a cluster needs ray: pip install 'glsplat\[ray\]'"):
        asked("--workers", "ray:2")
    assert asked("--workers", "2") == Workers(count=2)


@pytest.mark.check
@pytest.mark.gl
def test_avatars_and_devices_reach_the_workers():
    """Each worker has its device of the list; what none of them has is an error, what they have is drawn."""
    avatar = glsplat.default_avatar()
    cameras = stereo_cameras(head_matrix((0, 1.4, 1.2), (0, 0, 0, 1)), size=(64, 64))

    async def main():
        server = assemble(
            ServedScene(file=SceneFile.of(avatar), avatars={"ann": avatar.without("head")}),
            ServerConfig(port=0),
            device="0,llvmpipe",
            workers=Workers(count=2),
        )
        devices = [worker.launcher._make.keywords for worker in server.drawer._workers]
        assert [(one["device"], one["name"]) for one in devices] == [("0", "default"), ("llvmpipe", "default")]
        await server.start()
        try:
            async with Client(server.url) as first, Client(server.url, avatar="ann") as ann:
                return [len((await one.render(cameras, crop=True)).pictures[0]) for one in (first, ann)]
        finally:
            await server.stop()

    whole, headless = asyncio.run(main())
    assert whole != headless
