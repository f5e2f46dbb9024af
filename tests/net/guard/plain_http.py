"""HTTP written by hand, as strangers may send it."""

from __future__ import annotations

import asyncio

from tests.net.wire import HANG

__all__ = ["ask", "get", "status"]


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
