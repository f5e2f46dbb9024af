"""Requests and WebSocket frames by hand, for clients that do what no library would."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Callable

import numpy as np

from glsplat.net.client import Client
from glsplat.net.guard.limits import Limits

HANG = 60.0
"""Seconds after which something hangs, on whatever machine; no test expects anything within them."""
EYE = {"viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "K": [50, 50, 32, 32]}
UNLIMITED = Limits(
    **dict.fromkeys(("frames", "control", "bytes", "visits", "work"), 1e9),
    **dict.fromkeys(("frames_burst", "control_burst", "bytes_burst", "visits_burst"), 1e9),
)  # for tests of what lies behind the limits
UPGRADE = (
    b"GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


def native(frame_id, **more):
    return json.dumps({"v": 1, "frame_id": frame_id, "ack": 0, "eyes": [EYE, EYE], "size": [64, 64], **more})


async def until(condition: Callable[[], object]) -> None:
    """Wait for what other tasks, threads or processes bring about."""
    async with asyncio.timeout(HANG):
        while not condition():
            await asyncio.sleep(0.002)


async def all_of(reader: asyncio.StreamReader) -> bytes:
    """What comes before the connection ends, in order or cut off."""
    data = b""
    try:
        while more := await asyncio.wait_for(reader.read(65536), HANG):
            data += more
    except ConnectionError:
        pass
    return data


async def still_serves(server, cameras):
    async with Client(server.url) as client:
        return (await client.render(cameras)).frame_id == 1


async def raw(server):
    """A WebSocket by hand: (reader, writer) after the upgrade."""
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(UPGRADE)
    head = await reader.readuntil(b"\r\n\r\n")
    assert b" 101 " in head and b"deflate" not in head.lower()
    return reader, writer


def frame(opcode, payload, fin=True):
    """A masked client frame (RFC 6455, section 5.2) with an all-zero mask."""
    first = (0x80 if fin else 0) | opcode
    if len(payload) < 126:
        head = struct.pack("!BB", first, 0x80 | len(payload))
    elif len(payload) < 65536:
        head = struct.pack("!BBH", first, 0x80 | 126, len(payload))
    else:
        head = struct.pack("!BBQ", first, 0x80 | 127, len(payload))
    return head + b"\0\0\0\0" + payload


def full_hands(frame_id):
    """The longest request a headset sends: two eyes, head, wrists and both hands with rotations, all digits."""
    rng = np.random.default_rng(frame_id)
    values = {name: rng.uniform(-1, 1, 7).tolist() for name in ("head", "left", "right", "left_grip", "right_grip")}
    values |= {name: rng.uniform(-1, 1, (25, 7)).tolist() for name in ("left_joints", "right_joints")}
    eye = {"viewmat": rng.uniform(-1, 1, 16).tolist(), "K": rng.uniform(500, 900, 4).tolist()}
    return json.dumps(
        {"v": 1, "frame_id": frame_id, "ack": frame_id, "t": 1e3 / 3, "eyes": [eye, eye], "tracking": values}
    )


async def ask(port, text, source="127.0.0.1"):
    """The whole answer to a request written by hand."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0))
    try:
        writer.write(text if isinstance(text, bytes) else text.encode())
        return (await asyncio.wait_for(reader.read(), HANG)).decode("latin-1")
    except ConnectionError:
        return ""
    finally:
        writer.transport.abort()
        await asyncio.sleep(0)


def get(path="/stats", host="127.0.0.1", more=""):
    hosts = "".join(f"Host: {name}\r\n" for name in ([host] if isinstance(host, str) else host))
    return f"GET {path} HTTP/1.1\r\n{hosts}{more}Connection: close\r\n\r\n"


def status(answer):
    return int(answer.split(" ", 2)[1]) if answer else None
