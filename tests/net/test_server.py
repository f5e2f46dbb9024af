"""The server over real sockets on loopback: ordinary service."""

from __future__ import annotations

import asyncio
import re
import threading
import time
from collections import Counter
from dataclasses import dataclass

import aiohttp
import numpy as np
import pytest

from glsplat.errors import ContextError, GlsplatError, ProtocolError
from glsplat.gl.software import is_software
from glsplat.net import render_loop
from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.tracking.sample import Sample
from tests.extras.accounts.test_accounts import WS
from tests.net.conftest import FakeBackend, eyes, serving
from tests.net.pace.contested import Contested, contest
from tests.net.wire import HANG, until


async def test_a_client_gets_the_pair_it_asked_for(serve, fake_backend, cameras):
    backend = fake_backend()
    async with serve(backend) as server, Client(server.url) as client:
        reply = await client.render(cameras, pose=Pose.zero(), quality=95)
    left, right = reply.images()
    assert left.shape == right.shape == (64, 64, 3)
    assert abs(int(left[32, 32, 0]) - 51) <= 3  # frame 1
    assert not np.array_equal(left, right)
    assert reply.info["driver"] == "numpy <fake>" and reply.info["dropped"] == 0
    np.testing.assert_allclose(np.reshape(reply.info["eyes"][0]["viewmat"], (4, 4)), cameras[0].viewmat)
    assert {"wait", "render", "draw", "encode", "total"} <= set(reply.info["times"])
    assert reply.info["times"]["total"] >= reply.info["times"]["render"]
    assert backend.closed and len(backend.threads) == 1  # opened, used and closed on one thread


async def test_pipelined_requests_keep_only_the_newest(serve, fake_backend, cameras):
    backend = fake_backend()
    backend.gate.clear()
    async with serve(backend) as server, Client(server.url, window=2) as client:
        for _ in range(30):
            await client.send(cameras)
        await until(lambda: server.stats()["totals"]["accepted"] == 30)
        backend.gate.set()
        ids = [(await client.receive()).reply.frame_id]
        while ids[-1] < 30:
            ids.append((await client.receive()).reply.frame_id)
        stats = server.stats()
    assert ids == sorted(set(ids)) and ids[-1] == 30
    assert stats["totals"]["dropped"] == 30 - len(ids) >= 28
    assert len(backend.drawn) == len(ids)


async def test_encoding_overlaps_the_next_drawing(serve, fake_backend, cameras, monkeypatch):
    backend, second = fake_backend(), threading.Event()
    backend.fail = lambda request: second.set() if request.frame_id == 2 else None
    async with serve(backend) as server:
        encode = server.drawer.encoder._encoder.encode

        def waiting(*args):
            assert second.wait(HANG)  # the first picture is ready when the second one has been drawn
            return encode(*args)

        monkeypatch.setattr(server.drawer.encoder._encoder, "encode", waiting)
        async with Client(server.url, timeout=HANG) as client:
            await client.send(cameras)
            await until(lambda: backend.drawn)
            await client.send(cameras)
            assert [(await client.receive()).reply.frame_id for _ in range(2)] == [1, 2]


def test_clients_take_turns(cameras, stopped):
    """Four that ask for equal pictures all the time."""
    backend = Contested(clock=stopped, cost=lambda request: 0.005, seconds=0.2)

    async def client(server):
        async with Client(server.url, timeout=HANG) as client:
            while not backend.over.is_set():
                await client.render(cameras)

    contest(backend, [client] * 4)
    counts = Counter(request.viewer for request in backend.contested)
    assert len(counts) == 4 and min(counts.values()) >= 9


async def test_status_pages(serve, cameras):
    out = {}
    async with serve() as server, Client(server.url) as client, aiohttp.ClientSession() as http:
        await client.render(cameras, pose=Pose.zero())
        for path in ("/", "/healthz", "/stats", "/metrics", "/none"):
            async with http.get(f"http://127.0.0.1:{server.port}{path}") as response:
                out[path] = await response.text()
                assert response.status == (404 if path == "/none" else 200)
                assert response.headers["Server"] == "glsplat"
                assert path != "/" or "default-src 'none'" in response.headers["Content-Security-Policy"]
    assert "numpy &lt;fake&gt;" in out["/"] and "http://" not in out["/"]
    assert all(address.startswith(("vr/", "/")) for address in re.findall(r'(?:src|href)="([^"]*)"', out["/"]))
    assert re.search(r"<td>render</td><td>\d+\.\d\d</td>", out["/"])
    assert '"rebuilds": 0' in out["/stats"] and '"sent": 1' in out["/stats"]
    assert "glsplat_sent_total 1\n" in out["/metrics"]
    assert 'glsplat_stage_milliseconds{stage="render",quantile="0.95"}' in out["/metrics"]


async def test_the_last_pictures_are_sent_before_the_server_stops(fake_backend, cameras):
    backend = fake_backend()
    backend.gate.clear()
    server = server_of(backend, ServerConfig(port=0))
    await server.start()
    async with Client(server.url) as client:
        await client.send(cameras)
        await until(lambda: backend.drawn)
        stopping = asyncio.create_task(server.stop())
        await until(lambda: server._draining)
        await client.send(cameras)  # which is not drawn any more
        backend.gate.set()
        arrived = await client.receive()
        with pytest.raises(ProtocolError, match="1001"):
            await client.receive()
        await stopping
        assert arrived.reply.frame_id == 1 and len(backend.drawn) == 1


async def test_mirror_is_an_option_of_the_session(serve, fake_backend, cameras):
    backend = fake_backend()
    async with serve(backend) as server, Client(server.url, mirror=True) as client:
        await client.render(cameras)
    np.testing.assert_allclose(backend.drawn[0].cameras[0].viewmat, cameras[0].viewmat @ np.diag([-1, 1, 1, 1]))


class Solver:
    def __init__(self, height, span):
        self.height, self.calls = height, []

    def solve(self, request, now):
        self.calls.append(request)
        return Solved(Pose.zero(), ("left_lost",), scale=1.25, floor=-0.5)


async def test_tracking_goes_through_the_sessions_own_solver(serve, fake_backend):
    backend, made = fake_backend(), []
    offered = [AvatarInfo(name="default", solver=lambda *person: made.append(Solver(*person)) or made[-1])]
    tracking = {"head": [0, 1.6, 0, 0, 0, 0, 1], "left": None, "right": [0.3, 1, 0, 0, 0, 0, 1]}
    async with serve(backend, offered=offered) as server:
        async with Client(server.url) as one, Client(server.url, height=1.8) as two:
            for client in (one, two, one):
                reply = await client.render(tracking=tracking)
    assert [(solver.height, len(solver.calls)) for solver in made] == [(None, 2), (1.8, 1)]
    first, second = made[0].calls
    assert first.tracking == Sample.from_json(tracking, first.t / 1e3) and second.t > first.t
    assert reply.info["tracking"] == ["left_lost"] and "ik" in reply.info["times"]
    drawn = backend.drawn[0]
    assert drawn.pose is not None and np.allclose(drawn.to_user, similarity((0, -0.5, 0), scale=1.25))
    np.testing.assert_allclose(drawn.cameras[0].position, [-0.0275, 1.6, 0], atol=1e-12)


async def test_what_is_asked_in_vain_is_said_with_the_reason(serve, cameras):
    """With the picture to who sends a pose, instead of it to who sends tracking, to nobody else."""
    offered = [AvatarInfo(name="default", untracked="it has no skeleton", still="it has no skeleton")]
    async with serve(offered=offered) as server, Client(server.url) as client:
        infos = [(await client.render(cameras, pose=pose)).info for pose in (None, Pose.zero(), None)]
        with pytest.raises(ProtocolError, match="no tracking solver for what it shows: it has no skeleton") as told:
            await client.render(tracking={"head": [0, 1.6, 0, 0, 0, 0, 1]})
        error = told.value
    assert [info.get("still") for info in infos] == [None, "it has no skeleton", None]
    assert error.code == "bad_pose" and error.frame_id == 4


async def test_errors_before_the_start_are_one_line(serve, fake_backend):
    class Broken(fake_backend):
        def open(self):
            raise ContextError("no EGL here")

    async with serve() as first:
        with pytest.raises(GlsplatError, match=f"^port {first.port} is in use; choose another with --port$"):
            await server_of(fake_backend(), ServerConfig(port=first.port)).start()
    with pytest.raises(ContextError, match="no EGL here"):
        await server_of(Broken(), ServerConfig(port=0)).start()
    with pytest.raises(GlsplatError, match=r"cannot listen on 192\.0\.2\.1 port 0"):
        access = Access(host="192.0.2.1", insecure=True)
        await server_of(fake_backend(), ServerConfig(access=access, port=0)).start()


@pytest.mark.parametrize(
    ("given", "address"),
    [
        ("ws://lab:8000", "ws://lab:8000/ws"),
        ("wss://lab:8000/", "wss://lab:8000/ws"),
        ("ws://lab:8000?mirror=1", "ws://lab:8000/ws?mirror=1"),
        ("ws://lab:8000/?mirror=1", "ws://lab:8000/ws?mirror=1"),
        ("ws://lab:8000/proxy/ws?window=3", "ws://lab:8000/proxy/ws?window=3"),
    ],
)
def test_the_path_of_an_address_may_be_left_out(given, address):
    assert Client(given).url == address


OPTIONS = "window=0 window=9 window=x mirror=yes height=9 height=nan height=x span=0.2 span=nan avatar= avatar=nobody"


async def test_options_of_the_address_are_checked(serve):
    async with serve() as server:
        for query in OPTIONS.split():
            with pytest.raises(ProtocolError, match="400"):
                await Client(f"{server.url}?{query}").connect()
        assert server.stats()["clients"] == []


@pytest.mark.parametrize("names", [(), ("ann", "ben", "ann")])
def test_what_is_offered_has_names_of_its_own(names, fake_backend):
    with pytest.raises(GlsplatError, match="of different names"):
        server_of(fake_backend(), offered=[AvatarInfo(name=name) for name in names])


async def test_an_unknown_avatar_is_answered_with_the_names_there_are(serve):
    offered = [AvatarInfo(name="ann"), AvatarInfo(name="Jürgen B")]
    async with serve(offered=offered) as server, aiohttp.ClientSession() as http, Client(server.url, avatar="Jürgen B"):
        async with http.get(server.url.replace("ws:", "http:") + "?avatar=eve", headers=WS) as answer:
            assert answer.status == 400
            assert await answer.text() == "avatar needs a name of those offered here: ann, Jürgen B\n"


@pytest.mark.parametrize("query", ["avatar=eve", "mirror=2", "avatar=ann&window=99"])
async def test_a_refused_client_names_the_avatars_and_leaves_no_malformed_request(serve, caplog, query):
    async with serve(offered=[AvatarInfo(name="ann"), AvatarInfo(name="ben")]) as server:
        reason = 'it has no avatar "eve", but ann, ben' if query == "avatar=eve" else "it does not know an option"
        with pytest.raises(ProtocolError, match=reason):
            await Client(f"{server.url}?{query}").connect()
        with pytest.raises(ProtocolError, match='it has no avatar "eve", but ann, ben'):
            await Client(server.url, avatar="eve").connect()
    assert "malformed" not in caplog.text


TOOK = 0.02  # seconds of a picture


@dataclass
class Named(FakeBackend):
    driver: str = ""

    def open(self) -> str:
        super().open()
        return self.driver


async def seconds(driver: str, needed: bool, pictures: int = 3) -> float:
    async with serving(Named(TOOK, driver=driver)) as server, Client(server.url) as client:
        server.drawer.should_yield = lambda: needed
        await client.render(eyes())
        began = time.monotonic()
        for _ in range(pictures):
            await client.render(eyes())
        return time.monotonic() - began


@pytest.mark.check
async def test_a_software_driver_stands_back() -> None:
    assert await seconds("llvmpipe (LLVM 15.0.6, 256 bits)", True) >= 3 * 9 * TOOK


@pytest.mark.check
@pytest.mark.parametrize(("driver", "needed"), [("NVIDIA H100/PCIe/SSE2", True), ("llvmpipe", False)])
async def test_others_go_on(monkeypatch: pytest.MonkeyPatch, driver: str, needed: bool) -> None:
    monkeypatch.setattr(render_loop, "_YIELD_FACTOR", 1e9)
    monkeypatch.setattr(render_loop, "_MAX_YIELD_S", 1e9)  # it would never end
    assert await seconds(driver, needed) < 60


@pytest.mark.parametrize("driver", ["llvmpipe (LLVM 15.0.6, 256 bits)", "softpipe", "Google SwiftShader", "lavapipe"])
def test_names_of_software(driver: str) -> None:
    assert is_software(driver) and not is_software("zink Vulkan 1.3(NVIDIA)") and not is_software("AMD Radeon")
