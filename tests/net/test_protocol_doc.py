"""docs/protocol.md says what the code does: the example client runs, the tables hold the code's numbers."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path

import aiohttp
import numpy as np
import simplejpeg

from glsplat.net import messages, pump, server, session
from glsplat.net.messages import Decoder
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig

TEXT = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")


def test_the_request_of_the_page_is_a_request():
    block = re.search(r"```json\n(\{\"v\": 1, \"frame_id\": 7.*?)```", TEXT, re.S).group(1)
    request = Decoder().decode(block.replace('[[0,0,0], "21 in all"]', json.dumps(np.zeros((21, 3)).tolist())))
    assert request.frame_id == 7 and len(request.cameras) == 2


def test_the_example_client_runs(serve, tmp_path, monkeypatch):
    """With aiohttp under the three calls it makes of the websockets package."""
    code = re.search(r"```python\n(.*?)```", TEXT, re.S).group(1)

    class Connection:
        def __init__(self, url):
            self.url = url

        async def __aenter__(self):
            self.http = aiohttp.ClientSession()
            self.ws = await self.http.ws_connect(self.url)
            self.send = self.ws.send_str
            return self

        async def recv(self):
            return (await self.ws.receive(timeout=5)).data

        async def __aexit__(self, *_):
            await self.ws.close()
            await self.http.close()

    class FakeWebsockets:
        @staticmethod
        def connect(url, compression, max_size):
            return Connection(url)

    async def main():
        async with serve() as running:
            names = {"websockets": FakeWebsockets, "__name__": "example"}
            source = code.replace("struct, websockets", "struct")
            source = source.replace("ws://127.0.0.1:8000/ws", running.url).replace("asyncio.run(main())", "")
            exec(compile(source, "protocol.md", "exec"), names)
            await names["main"]()

    monkeypatch.chdir(tmp_path)
    asyncio.run(main())
    pictures = sorted(tmp_path.glob("*.jpg"))
    assert len(pictures) == 20
    assert simplejpeg.decode_jpeg(pictures[0].read_bytes()).shape == (512, 512, 3)


def test_every_error_code_is_in_the_table():
    sources = [Path(module.__file__).read_text() for module in (messages, session, server, pump)]
    codes = set(re.findall(r'ProtocolError\(\s*f?[^()]*?,\s*"([a-z_]+)"', "\n".join(sources), re.S))
    codes |= set(re.findall(r'error_text\("([a-z_]+)"', "\n".join(sources)))
    codes |= set(re.findall(r'frame\.error = \("([a-z_]+)"', "\n".join(sources))) | {"bad_request", "encode"}
    assert len(codes) >= 10
    table = TEXT.split("## 6. Errors")[1].split("## 7.")[0]
    missing = {code for code in codes if f"`{code}`" not in table}
    assert not missing


def test_the_numbers_of_the_page():
    config, limits = ServerConfig(), SessionConfig()
    for phrase in (
        f"{messages.MAX_BYTES // 1000} {messages.MAX_BYTES % 1000:03d} bytes",
        f"pings every {config.heartbeat:g} s",
        f"within {config.write_timeout:g} s",
        f"{limits.rate:g} messages a second are read, {limits.burst} more",
        f"within {limits.handshake:g} s of connecting, or no message for {limits.idle:g} s",
        f"More than {limits.errors} of them at once",
        f"within {server._FAREWELL:g} s is cut off",
        "`window=1..8`",
        f"port {config.port}",
    ):
        assert phrase in TEXT, phrase
    assert server._MAX_WINDOW == 8
