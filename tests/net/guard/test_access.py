"""Tokens, origins, addresses and TLS."""

from __future__ import annotations

import asyncio
import base64

import aiohttp
import pytest

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.client import Client
from glsplat.net.guard.access import Access, is_loopback, read_token, server_tls
from glsplat.net.server import ServerConfig

TOKEN = "correct-horse-battery"


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        *[(host, True) for host in ("127.0.0.1", "localhost", "::1", "127.8.8.8")],
        *[(host, False) for host in ("0.0.0.0", "::", "192.168.1.4", "example.org", "localhost.evil.org", "")],
    ],
)
def test_loopback(host, expected):
    assert is_loopback(host) is expected


def test_another_address_needs_tls_and_a_token():
    for options in ({}, {"tls": True}, {"token": TOKEN}):
        with pytest.raises(GlsplatError, match=r"--self-signed, or tls-cert, tls-key and token-file.*--insecure"):
            Access(host="0.0.0.0", **options)
    Access(host="0.0.0.0", tls=True, token=TOKEN)
    Access(host="0.0.0.0", insecure=True)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        ({"Authorization": f"Bearer {TOKEN}"}, None),
        ({"Authorization": f"bearer  {TOKEN} "}, None),
        ({"Authorization": f"Basic {TOKEN}"}, 401),
        ({"Authorization": f"Bearer {TOKEN}x"}, 401),
        ({"Authorization": "Bearer "}, 401),
        ({"Authorization": "Bearer \u00e9"}, 401),
        ({"Authorization": "Bearer \udcff"}, 401),  # bytes that are not UTF-8, as aiohttp reads them
        ({"Sec-WebSocket-Protocol": "glsplat.v1, token.\udcff\udcfe"}, 401),
        ({"Sec-WebSocket-Protocol": f"glsplat.v1, token.{TOKEN}"}, None),
        ({"Sec-WebSocket-Protocol": f"token.{TOKEN[:-1]}"}, 401),
        ({"Sec-WebSocket-Protocol": TOKEN}, 401),
    ],
)
def test_tokens(headers, status):
    refusal = Access(token=TOKEN).refusal(headers)
    assert (refusal and refusal[0]) == status
    assert refusal is None or TOKEN not in refusal[1]


@pytest.mark.parametrize(
    ("origin", "host", "allowed"),
    [
        (None, "127.0.0.1:8000", True),
        ("http://127.0.0.1:8000", "127.0.0.1:8000", True),
        ("http://localhost:8000", "localhost:8000", True),
        ("http://localhost:8000", "127.0.0.1:8000", True),
        ("http://localhost:3000", "localhost:8000", False),  # another program's page
        ("http://evil.example", "127.0.0.1:8000", False),
        ("http://evil.example:8000", "evil.example:8000", False),  # a name that resolves to loopback
        ("null", "127.0.0.1:8000", False),
        ("http://[", "127.0.0.1:8000", False),
        ("http://127.0.0.1:notaport", "127.0.0.1:8000", False),
        ("https://lab.example", "127.0.0.1:8000", True),  # on the list
    ],
)
def test_origins_on_loopback(origin, host, allowed):
    headers = {"Host": host} | ({} if origin is None else {"Origin": origin})
    refusal = Access(origins=("https://lab.example",)).refusal(headers)
    assert (refusal is None) == allowed and (allowed or refusal[0] == 403)


def test_origins_elsewhere_are_the_own_host():
    access = Access(host="0.0.0.0", tls=True, token=TOKEN)
    good = {"Host": "render.example:8000", "Authorization": f"Bearer {TOKEN}"}
    assert access.refusal(good | {"Origin": "https://render.example:8000"}) is None
    assert access.refusal(good | {"Origin": "http://render.example:8000"})[0] == 403
    assert access.refusal(good | {"Origin": "https://other.example"})[0] == 403


@pytest.mark.parametrize(
    ("given", "allowed"),
    [(f"me:{TOKEN}", True), (f":{TOKEN}", True), (TOKEN, False), (f"{TOKEN}:", False), ("me:" + TOKEN[:-1], False)],
)
def test_a_browser_gives_the_token_as_password(given, allowed):
    """The status page is opened by people: the browser asks them for a name and a password."""
    access, host = Access(token=TOKEN), {"Host": "127.0.0.1"}
    encoded = base64.b64encode(given.encode()).decode()
    assert (access.refusal(host | {"Authorization": f"Basic {encoded}"}) is None) == allowed
    assert access.refusal(host | {"Authorization": f"Basic {given}!"})[0] == 401  # not base64


def test_token_files(tmp_path):
    path = tmp_path / "token"
    with pytest.raises(GlsplatError, match="token: cannot read the token"):
        read_token(path)
    for bad in (b"", b"short", b"two words but long enough", b"\xff" * 20):
        path.write_bytes(bad)
        with pytest.raises(GlsplatError, match="token: a token"):
            read_token(path)
    path.write_text(f"{TOKEN}\n")
    assert read_token(path) == TOKEN


def test_tls_files(tmp_path):
    with pytest.raises(GlsplatError, match=r"cert\.pem: expected a PEM file for TLS, found none"):
        server_tls(tmp_path / "cert.pem", tmp_path / "key.pem")
    for name in ("cert.pem", "key.pem"):
        (tmp_path / name).write_text("not a certificate")
    with pytest.raises(GlsplatError, match="expected a certificate and the key that belongs to it in PEM"):
        server_tls(tmp_path / "cert.pem", tmp_path / "key.pem")


async def test_a_token_guards_everything_but_healthz(serve, cameras):
    config = ServerConfig(port=0, access=Access(token=TOKEN))
    async with serve(config=config) as server, aiohttp.ClientSession() as http:
        base = f"http://127.0.0.1:{server.port}"
        codes = {}
        for path in ("/", "/stats", "/metrics", "/healthz", "/ws"):
            async with http.get(base + path) as response:
                codes[path] = response.status
                assert ("WWW-Authenticate" in response.headers) == (response.status == 401)
        for token in (None, "wrong-token-wrong-token"):
            with pytest.raises(ProtocolError, match=r"401.*--token-file"):
                await Client(server.url, token).connect()
        async with Client(server.url, TOKEN) as client:
            await client.render(cameras)
        protocols = ("glsplat.v1", f"token.{TOKEN}")
        async with http.ws_connect(server.url, protocols=protocols) as ws:
            protocol = ws.protocol
    assert codes == {"/": 401, "/stats": 401, "/metrics": 401, "/healthz": 200, "/ws": 401}
    assert protocol == "glsplat.v1"  # the token is not sent back


async def test_foreign_pages_cannot_connect(serve):
    async with serve() as server, aiohttp.ClientSession() as http:
        with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
            await http.ws_connect(server.url, origin="http://evil.example")
        async with http.ws_connect(server.url, origin=f"http://127.0.0.1:{server.port}"):
            assert caught.value.status == 403


async def test_tls_to_a_plain_server_is_said(serve):
    async with serve() as server:
        with pytest.raises(ProtocolError, match="does not use TLS: use an address that begins with ws://"):
            await Client(server.url.replace("ws:", "wss:")).connect()


@pytest.mark.parametrize("greeting", [b"SSH-2.0-x\r\n", b""])
async def test_something_else_listens(greeting):
    async def answer(reader, writer):
        writer.write(greeting)
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(ProtocolError, match="is it a glsplat server"):
            await Client(f"ws://127.0.0.1:{port}/ws").connect()
