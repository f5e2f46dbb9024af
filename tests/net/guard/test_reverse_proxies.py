"""A server behind a real nginx and a real Caddy, each with the configuration of docs/deploying.md."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import socket
import ssl
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from apps.serve.command import add_arguments, server_config
from apps.serve.options import parsed
from apps.usage import CommandParser
from glsplat.extras.operations.certificate import CERTIFICATE, kept_certificate
from glsplat.net.client import Client
from glsplat.net.options import ServerConfig
from tests import needs
from tests.net.conftest import Serve
from tests.net.wire import HANG, UPGRADE, all_of, frame, native

pytestmark = pytest.mark.check

DOCS = (Path(__file__).parents[3] / "docs" / "deploying.md").read_text(encoding="utf-8")
SECTION = DOCS[DOCS.index("## Behind a reverse proxy") : DOCS.index("## A UDP port")]
NAME = "avatars.example.org"
TOKEN = "0123456789abcdef-token"
ANN, EVE, MALLORY = "127.0.0.5", "127.0.0.6", "127.0.0.7"
NGINX = """daemon off; master_process off; pid nginx.pid; error_log error.log;
events {{}}
http {{ access_log off; client_body_temp_path body; proxy_temp_path proxy; fastcgi_temp_path fastcgi;
uwsgi_temp_path uwsgi; scgi_temp_path scgi;
{block}
}}
"""
CADDY = """{{
    admin off
    auto_https off
}}
{block}
"""


def block(fence: str, begins: str) -> str:
    """The first block of the section that begins so."""
    found = re.findall(r"(?ms)^```(\w*)\n(.*?)^```$", SECTION)
    return next(text for kind, text in found if kind == fence and text.startswith(begins))


def replaced(text: str, *changes: tuple[str, object]) -> str:
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, str(new))
    return text


def nginx(folder: Path, port: int, server: int) -> list[str]:
    text = replaced(
        block("nginx", "limit_req_zone"),
        ("listen 443", f"listen 127.0.0.1:{port}"),
        ("/etc/glsplat/cert.pem", folder / "cert.pem"),
        ("/etc/glsplat/key.pem", folder / "key.pem"),
        ("127.0.0.1:8000", f"127.0.0.1:{server}"),
    )
    (folder / "nginx.conf").write_text(NGINX.format(block=text))
    return [needs.program("nginx") or "", "-p", str(folder), "-c", "nginx.conf", "-e", "error.log"]


def caddy(folder: Path, port: int, server: int) -> list[str]:
    tls = f"{NAME}:{port}, 127.0.0.1:{port} {{\n    tls {folder / 'cert.pem'} {folder / 'key.pem'}\n"
    text = replaced(block("", NAME), (f"{NAME} {{\n", tls), ("127.0.0.1:8000", f"127.0.0.1:{server}"))
    (folder / "Caddyfile").write_text(CADDY.format(block=text))
    return [needs.program("caddy") or "", "run", "--config", str(folder / "Caddyfile"), "--adapter", "caddyfile"]


def served(folder: Path) -> ServerConfig:
    """What the documented server.toml makes."""
    (folder / "token").write_text(TOKEN)
    text = replaced(block("toml", "scene"), ("/etc/glsplat/token", folder / "token"))
    (folder / "server.toml").write_text(text)
    parser = CommandParser()
    add_arguments(parser)
    return replace(server_config(parsed(parser, ["--config", str(folder / "server.toml")])), port=0, fit=False)


def certificate(folder: Path) -> ssl.SSLContext:
    """cert.pem and key.pem, and who trusts them."""
    kept = kept_certificate(folder, (NAME,))
    (folder / CERTIFICATE).rename(folder / "cert.pem")
    kept.path.rename(folder / "key.pem")
    return ssl.create_default_context(cafile=folder / "cert.pem")


@contextmanager
def running(command: list[str], folder: Path, port: int) -> Iterator[None]:
    """The proxy, from when it listens on."""
    environment = os.environ | {"HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    with (folder / "output").open("wb") as output:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=output, stderr=output)
    try:
        while True:
            with socket.socket() as knock:
                if knock.connect_ex(("127.0.0.1", port)) == 0:
                    break
            with pytest.raises(subprocess.TimeoutExpired):  # else it has ended: the message says why
                process.wait(0.1)
        yield
    finally:
        process.terminate()
        process.wait(HANG)


@pytest.mark.parametrize("proxy", [nginx, caddy])
async def test_clients_behind_a_proxy_are_told_apart(
    serve: Serve, cameras: Any, tmp_path: Path, caplog: Any, proxy: Callable[[Path, int, int], list[str]]
) -> None:
    if proxy is nginx:
        needs.require("nginx")
    elif needs.program("caddy") is None:
        pytest.skip("no Caddy here")
    caplog.set_level(logging.INFO)
    tls = certificate(tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    async def opened(source: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection("127.0.0.1", port, ssl=tls, server_hostname=NAME, local_addr=(source, 0))

    async def ask(source: str, path: str, token: str = TOKEN, more: str = "") -> tuple[int, str]:
        reader, writer = await opened(source)
        head = f"GET /glsplat{path} HTTP/1.1\r\nHost: {NAME}\r\nAuthorization: Bearer {token}\r\n{more}"
        writer.write(f"{head}Connection: close\r\n\r\n".encode())
        answer = (await all_of(reader)).decode("latin-1")
        writer.transport.abort()
        return int(answer.split(" ", 2)[1]), answer

    async with serve(config=served(tmp_path)) as server:
        with running(proxy(tmp_path, port, server.port), tmp_path, port):
            code, page = await ask(ANN, "/vr/")
            assert code == 200 and "<html" in page
            async with Client(f"wss://127.0.0.1:{port}/glsplat/ws", TOKEN, cafile=tmp_path / "cert.pem") as client:
                await client.render(cameras)

            # whatever Mallory claims, his guesses are his
            claims = ["", f"X-Forwarded-For: {ANN}\r\n", f"Forwarded: for={ANN}\r\n", "X-Forwarded-For: unknown\r\n"]
            guesses = [(await ask(MALLORY, "/stats", f"wrong-token-{n:08d}", claims[n % 4]))[0] for n in range(6)]
            assert guesses == [401] * 6
            assert [(await ask(who, "/stats"))[0] for who in (MALLORY, ANN, EVE)] == [429, 200, 200]

            reader, writer = await opened(EVE)
            head = f"Host: {NAME}\r\nOrigin: https://{NAME}\r\nAuthorization: Bearer {TOKEN}\r\n{claims[1]}"
            writer.write(UPGRADE.replace(b"/ws", b"/glsplat/ws").replace(b"Host: 127.0.0.1\r\n", head.encode()))
            assert b" 101 " in await reader.readuntil(b"\r\n\r\n")
            assert [stream.address for stream in server.clients.values()] == [EVE]
            writer.write(frame(0x1, native(1).encode()))
            assert await reader.readexactly(1) == b"\x82"  # a picture
            writer.transport.abort()
    assert "trusted proxy" not in caplog.text
