"""Features: the server calls their hooks, and a feature that fails leaves nothing running."""

import asyncio
from collections import Counter

import aiohttp
import pytest
from aiohttp import web

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.client.client import Client
from glsplat.net.feature import Feature
from glsplat.net.guard.access import Access
from glsplat.net.options import ServerConfig
from glsplat.net.served_scene import server_of

from .wire import until


class Counting(Feature):
    """Counts the calls of its hooks and those of the observer that it gives to each client."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()

    async def start(self, server):
        self.server = server
        self.calls["start"] += 1

    async def stop(self):
        self.calls["stop"] += 1

    def routes(self):
        return [web.get("/counting", self.answer)]

    async def answer(self, request):
        return web.json_response(len(self.server.clients))

    @web.middleware
    async def guard(self, request, handler):
        return web.Response(status=418) if request.path == "/metrics" else await handler(request)

    def query(self, query, user):
        if "forbidden" in query:
            raise ProtocolError("forbidden is not allowed")
        return query

    def client_opened(self, client, asked):
        self.calls["opened"] += 1
        client.observe(self)
        if asked.name == "eve":
            raise ProtocolError("eve may not come in")

    def client_closed(self, client, goodbye):
        self.calls["closed" if goodbye else "lost"] += 1

    def request_received(self, request):
        self.calls["request"] += 1

    def picture_drawn(self, images):
        images[..., :3] = 255
        self.calls["picture"] += 1

    def reply_sent(self, messages):
        self.calls["reply"] += 1

    def stats(self, user):
        return {"counting": sum(self.calls.values())}

    def client_stats(self, user, client):
        return {"counted": client.number}

    def session(self, user):
        return {"counting": True}

    def avatar_fields(self, name):
        return {"counted": name}


class Faulty(Feature):
    """Fails by faults of its own for clients that are called eve, and as any client leaves."""

    def client_opened(self, client, asked):
        if asked.name == "eve":
            raise RuntimeError("a fault")

    def client_closed(self, client, goodbye):
        raise RuntimeError("another fault")


class Failing(Feature):
    async def start(self, server):
        await asyncio.sleep(0.01)  # the others have started
        raise GlsplatError("no room for this feature")


def test_hooks_are_called(fake_backend, cameras):
    feature = Counting()

    async def main():
        server = server_of(fake_backend(), ServerConfig(port=0), features=[feature])
        await server.start()
        try:
            async with aiohttp.ClientSession(f"http://127.0.0.1:{server.port}") as http:
                async with Client(server.url) as client:
                    reply = await client.render(cameras)
                    assert all(image.min() > 250 for image in reply.images())
                    async with http.get("/counting") as answer:
                        assert await answer.json() == 1
                    stats, session = server.stats(), server.session()
                    assert stats["counting"] and stats["clients"][0]["counted"] == 1
                    assert session["counting"] and session["avatars"][0]["counted"] == "default"
                await until(lambda: feature.calls["closed"])
                async with http.get("/metrics") as answer:
                    assert answer.status == 418
                for query in ("name=eve", "forbidden=1"):
                    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                        await http.ws_connect(f"/ws?{query}")
                    assert refused.value.status == 400
                assert not server.clients and not server.stats()["connected"]
        finally:
            await server.stop()

    asyncio.run(main())
    once = {"start": 1, "stop": 1, "request": 1, "picture": 1, "reply": 1, "closed": 1}
    assert feature.calls == once | {"opened": 2, "lost": 1}  # eve was refused after her client was made


def test_a_feature_has_the_gate_before_it(fake_backend):
    async def main():
        config = ServerConfig(port=0, access=Access(token="t" * 20))
        server = server_of(fake_backend(), config, features=[Counting()])
        await server.start()
        try:
            async with aiohttp.ClientSession(f"http://127.0.0.1:{server.port}") as http:
                async with http.get("/counting") as answer:
                    return answer.status
        finally:
            await server.stop()

    assert asyncio.run(main()) == 401


def test_a_feature_that_cannot_start_stops_the_others(fake_backend):
    feature, backend = Counting(), fake_backend()

    async def main():
        server = server_of(backend, ServerConfig(port=0), features=[feature, Failing()])
        with pytest.raises(GlsplatError, match="no room for this feature"):
            await server.start()
        return server.port

    port = asyncio.run(main())
    assert feature.calls == {"start": 1, "stop": 1} and backend.closed

    async def again():
        server = server_of(fake_backend(), ServerConfig(port=port))  # the port is free again
        await server.start()
        await server.stop()

    asyncio.run(again())


def test_a_room_that_no_feature_has_is_refused(fake_backend):
    async def main():
        server = server_of(fake_backend(), ServerConfig(port=0))
        await server.start()
        try:
            async with aiohttp.ClientSession(f"http://127.0.0.1:{server.port}") as http:
                with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                    await http.ws_connect("/ws?room=lab")
                return refused.value.status, len(server.clients)
        finally:
            await server.stop()

    assert asyncio.run(main()) == (404, 0)


async def test_a_fault_of_a_feature_costs_its_own_client_alone(fake_backend, cameras, caplog):
    counting = Counting()
    server = server_of(fake_backend(), ServerConfig(port=0, max_clients=1), features=[Faulty(), counting])
    await server.start()
    try:
        async with aiohttp.ClientSession(f"http://127.0.0.1:{server.port}") as http:
            for _ in range(3):
                with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                    await http.ws_connect("/ws?name=eve")
                assert refused.value.status == 500 and not server.clients
            async with Client(server.url) as client:
                assert (await client.render(cameras)).images()[0].any()
            await until(lambda: counting.calls["closed"])
            assert not server.clients and counting.calls["lost"] == 3
    finally:
        await server.stop()
    assert caplog.text.count("Faulty failed as client") == 4
