"""A server whose driver fails: an error costs a picture, a lost context is made anew, nothing is left behind."""

from __future__ import annotations

import asyncio
import ctypes
import ctypes.util

import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import ProtocolError
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.client import Client
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from tests.apps.serve.viewers import parameters


@pytest.fixture
def backend():
    backend = RendererBackend(default_avatar(), (64, 64))
    yield backend
    backend.close()


@pytest.mark.gl
def test_an_opengl_error_costs_that_picture_only(backend, caplog):
    """An error that the driver reports while a client's picture is drawn: it gets an error, the others go on."""
    eyes, pose = next(iter(parameters(64)))
    wide = stereo_cameras(head_matrix((0, 1, 2), (0, 0, 0, 1)), size=(80, 64))

    async def main():
        server = server_of(backend, ServerConfig(port=0))
        await server.start()
        prepare, gl = backend._pool.get().renderer.prepare, ctypes.CDLL("libGL.so.1")

        def faulty(cameras, pose):
            if cameras[0].width == 80:
                gl.glEnable(0x1234)  # GL_INVALID_ENUM
            return prepare(cameras, pose)

        backend._pool.get().renderer.prepare = faulty
        try:
            async with Client(server.url) as good, Client(server.url) as bad:
                before = await good.render(eyes, pose=pose)
                for _ in range(4):  # more in a row than a lost context would be allowed
                    with pytest.raises(ProtocolError, match=r"^the picture could not be drawn$"):
                        await bad.render(wide)
                    after = await good.render(eyes, pose=pose)
                    assert after.pictures == before.pictures
                backend._pool.get().renderer.prepare = prepare
                assert (await bad.render(wide)).images()[0].shape == (64, 80, 3)
                return server.stats()
        finally:
            await server.stop()

    stats = asyncio.run(main())
    assert stats["healthy"] and stats["rebuilds"] == 0 and stats["totals"]["failed"] == 4
    assert "reports an OpenGL error" in caplog.text


def lose_context():
    """What a driver reset leaves: no call does anything. To be called on the render thread."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
    assert egl.eglMakeCurrent(ctypes.c_void_p(egl.eglGetCurrentDisplay()), None, None, None)


@pytest.mark.gl
def test_a_lost_context_is_made_anew(backend, caplog):
    eyes, pose = next(iter(parameters(64)))

    async def main():
        server = server_of(backend, ServerConfig(port=0))
        await server.start()
        try:
            async with Client(server.url) as client:
                before = await client.render(eyes, pose=pose)
                await asyncio.get_running_loop().run_in_executor(server.drawer.worker._thread, lose_context)
                with pytest.raises(ProtocolError, match=r"^the picture could not be drawn$"):
                    await client.render(eyes, pose=pose)
                after = await client.render(eyes, pose=pose)  # on the same connection
                assert after.pictures == before.pictures
                return server.stats()
        finally:
            await server.stop()

    stats = asyncio.run(main())
    assert stats["healthy"] and stats["rebuilds"] == 1 and stats["clients"][0]["failed"] == 1
    assert "the OpenGL context is lost; starting a new one" in caplog.text
