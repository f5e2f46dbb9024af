"""The Autobahn test suite's cases (as kosoku runs them) against the server's own WebSocket, which echoes here.

Echoing exists in this file only. Compression (cases 12 and 13) is left out: the server never negotiates it.
"""

from __future__ import annotations

import asyncio
import json
import sys

import pytest
from aiohttp import WSMsgType

from glsplat.net.conversation import Conversation
from glsplat.net.server import ServerConfig
from tests.net.wire import UNLIMITED

pytestmark = pytest.mark.check

pytest.importorskip("kosoku")

# in a process of its own: it patches the standard library and puts old case files on the module path
RUN = """
import asyncio, json, os, sys
from kosoku import FailureError, run_fuzzingclient

async def main():
    url, cases, without = json.loads(sys.argv[1])
    try:
        results = await run_fuzzingclient(url, cases or None, without, 4)
        failed = []
    except FailureError as error:
        failed = [result.case_id for result in error.results]
        results = []
    print(json.dumps([len(results), failed]), flush=True)
    os._exit(0)  # its own threads abort an interpreter that ends in order

asyncio.run(main())
"""

KNOWN = ["7.9.5"]  # aiohttp answers a close frame of code 1006 in order (1000), where 1002 is wanted


class Echo(Conversation):
    async def _read(self) -> None:
        async for message in self._ws:
            if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                await self._send(message.data)
            elif message.type == WSMsgType.PING:
                await self._ws.pong(message.data)


@pytest.fixture(autouse=True)
def echo(monkeypatch):
    monkeypatch.setattr("glsplat.net.server.Conversation", Echo)


async def run(serve, cases, without=()):
    """(number of cases that passed, those that did not)."""
    # hundreds of connections, thousands of messages and 16 MiB at once are the suite's business
    async with serve(config=ServerConfig(port=0, limits=UNLIMITED)) as server:
        words = json.dumps([server.url, cases, list(without)])
        process = await asyncio.create_subprocess_exec(sys.executable, "-c", RUN, words, stdout=asyncio.subprocess.PIPE)
        out, _ = await asyncio.wait_for(process.communicate(), 120)
        assert process.returncode == 0 and server.stats()["clients"] == []
        return json.loads(out)


async def test_framing_fragments_utf8_and_closing(serve):
    """Cases 1 to 7 and 10, with the server's limit of 64 KiB a message."""
    assert await run(serve, [], ["9.*", "12.*", "13.*", *KNOWN]) == [246, []]


async def test_large_and_many_messages(serve, monkeypatch):
    """Cases 9: messages up to 16 MiB, with the limit raised, and thousands of small ones."""
    monkeypatch.setattr("glsplat.net.conversation.MAX_MESSAGE_BYTES", 17 * 2**20)
    assert await run(serve, ["9.*"]) == [54, []]
