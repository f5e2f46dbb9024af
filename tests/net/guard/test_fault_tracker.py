"""Pictures that cost too much, take too long or end the renderer: their client's fault, and nobody else's."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import time

import aiohttp
import pytest

import glsplat
from glsplat.errors import BudgetError, ContextError, ContextLostError
from glsplat.net.backend import AvatarInfo
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.client import Client
from glsplat.net.client_stream import ClientStream
from glsplat.net.messages import Decoder
from glsplat.net.render_loop import RenderLoop
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from glsplat.net.session import Session
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.slot_writer import SLOTS
from glsplat.net.worker.wire import WorkerLostError
from tests.net.attacks.pictures import costly
from tests.net.wire import HANG, native, still_serves, until
from tests.net.worker.fakes import Boxed


def visitor(address: str) -> aiohttp.ClientSession:
    """A client that comes from another address of loopback."""
    return aiohttp.ClientSession(connector=aiohttp.TCPConnector(local_addr=(address, 0)))


async def ask(ws: aiohttp.ClientWebSocketResponse, frame_id: int, **fields: object) -> object:
    """The error code, the close code, or the first bytes of the picture."""
    await ws.send_str(native(frame_id, **fields))
    message = await ws.receive(timeout=HANG)
    if message.type == aiohttp.WSMsgType.TEXT:
        return json.loads(message.data)["error"]["code"]
    return message.data[:2] if message.type == aiohttp.WSMsgType.BINARY else ws.close_code


@pytest.mark.parametrize(
    ("error", "code", "warned"),
    [
        (BudgetError("covers 1e12 pixels", "too_costly"), "too_costly", 8),
        (BudgetError("took too long", "too_slow"), "too_slow", 1),
        (ContextLostError("hangs"), "render", 1),
        (WorkerLostError("signal 9"), "render", 1),  # as of a kernel without memory: it may be the picture's
    ],
)
async def test_bad_pictures_end_their_client_and_hold_off_its_address(serve, fake_backend, error, code, warned):
    """First a warning; the server goes on, and other addresses notice nothing."""
    backend = fake_backend(fail=lambda request: error if request.frame_id < 100 else None)
    async with (
        serve(backend) as server,
        visitor("127.0.0.9") as beside,
        visitor("127.0.0.8") as bad,
        visitor("127.0.0.7") as other,
        beside.ws_connect(server.url) as good,
    ):
        assert await ask(good, 100) == b"VR"
        async with bad.ws_connect(server.url) as ws:
            assert [await ask(ws, i + 1) for i in range(warned + 1)] == [code] * (warned + 1)
            assert (await ws.receive(timeout=HANG)).data == 1008
        async with bad.get(server.url.replace("ws", "http", 1)) as response:
            assert response.status in (429, 503)
        async with other.ws_connect(server.url) as ws:
            assert [await ask(ws, 1), await ask(ws, 101, ack=0)] == [code, b"VR"]
        assert await ask(good, 101) == b"VR" and server.drawer.healthy


async def test_no_number_of_lost_contexts_ends_the_server(serve, fake_backend, cameras):
    backend = fake_backend(fail=lambda request: ContextLostError("lost") if request.frame_id < 100 else None)
    async with serve(backend) as server:
        for i in range(10):
            async with visitor(f"127.0.0.{i + 10}") as http, http.ws_connect(server.url) as ws:
                assert await ask(ws, 1) == "render"
        async with visitor("127.0.0.9") as http, http.ws_connect(server.url) as ws:
            assert (await ask(ws, 100), server.drawer.rebuilds, server.drawer.healthy) == (b"VR", 10, True)


async def test_a_request_the_driver_cannot_serve_is_not_a_lost_context(serve, fake_backend, cameras):
    refusal = ContextError("size needs 1 to 16384 pixels a side")
    backend = fake_backend(fail=lambda request: refusal if request.frame_id < 100 else None)
    async with serve(backend) as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        answers = [await ask(ws, i) for i in range(1, 7)]
        assert (answers, await ask(ws, 100), server.drawer.rebuilds) == (["render"] * 6, b"VR", 0)


async def test_a_real_picture_that_costs_too_much(serve):
    """A body collapsed to a point and seen through a long lens, 4 kB of legal JSON."""
    avatar = glsplat.default_avatar()
    offered = [AvatarInfo(name="default", skeleton=avatar.skeleton)]
    async with serve(RendererBackend(avatar, (64, 64)), offered=offered) as server, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url) as ws:
            for i in (1, 3):
                await ws.send_str(costly(i, 0).decode())
                assert json.loads((await ws.receive(timeout=HANG)).data)["error"]["code"] == "too_costly"
                assert await ask(ws, i + 1, ack=None) == b"VR"
        assert server.drawer.rebuilds == 0


async def test_a_picture_nobody_waits_for_is_given_up(serve, cameras):
    worker = process_worker(Boxed, 64, seconds=1e6)  # one that hangs would not be given up in the time there is
    async with serve(worker) as server:
        async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_str(native(71))
            await until(lambda: server.drawer.drawing_for)
        try:
            assert await still_serves(server, cameras) and server.drawer.rebuilds == 0
        finally:
            await worker.launcher.end(0.0)


@pytest.mark.check
async def test_a_hung_renderer_does_not_keep_the_server_from_ending(monkeypatch):
    monkeypatch.setattr("glsplat.net.server.DRAIN_GIVE_UP_S", 0.1)
    worker = process_worker(Boxed, 64, seconds=1e6)
    server = server_of(worker, ServerConfig(port=0))

    async def hang():
        async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_str(native(70))
            await until(lambda: server.drawer.drawing_for)
            os.kill(os.getpid(), signal.SIGTERM)
            await ws.receive()

    tasks = []
    running = asyncio.create_task(server.run(lambda: tasks.append(asyncio.create_task(hang()))))
    done, _ = await asyncio.wait([running], timeout=HANG)
    await worker.launcher.end(0.0)
    await running
    assert done


@pytest.mark.check
async def test_clients_that_leave_take_no_picture_slot_with_them():
    """While their picture waits for the encoder, is encoded, or lies ready; or when there is one too many of them."""
    worker = process_worker(Boxed, 64)
    render_loop = RenderLoop(worker)
    await render_loop.start()
    encode = render_loop.encoder._encoder.encode
    render_loop.encoder._encoder.encode = lambda *args: (time.sleep(0.003), encode(*args))[1]
    for i in range(30):
        client = ClientStream(i, Session(Decoder()))
        render_loop.add(client)
        client.received(client.session.receive(native(1), 0.0), 0.0)
        answer = await asyncio.wait_for(client.answers.get(), HANG)
        packing = asyncio.create_task(render_loop.pack(client, answer))
        for _ in range(i % 3):
            await asyncio.sleep(0 if i % 2 else 0.002)
        packing.cancel()
        render_loop.remove(client)
        await asyncio.gather(packing, return_exceptions=True)
    with contextlib.suppress(TimeoutError):
        await until(lambda: worker.launcher.slots.free == SLOTS)
    free = worker.launcher.slots.free
    await render_loop.stop()
    assert free == SLOTS


async def test_a_good_client_reads_why(serve, fake_backend, cameras):
    """The library's client reports the refusal as the error it is."""
    error = BudgetError("the picture covers 1e+10 pixels splat by splat, at most 1e+09 are drawn", "too_costly")
    async with serve(fake_backend(fail=lambda request: error)) as server, Client(server.url) as client:
        with pytest.raises(glsplat.GlsplatError, match="at most 1e") as caught:
            await client.render(cameras)
        assert caught.value.code == "too_costly"
