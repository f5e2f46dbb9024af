"""Senders that take their time: who keeps up the rate is served, all others lose their place and leave nothing."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass, replace

import pytest

from glsplat.extras.uploads.form import RateFloor
from glsplat.extras.uploads.job import UploadConfig
from glsplat.net.guard.limits import Limits
from tests.extras.uploads.conftest import GUARD, LIMITS, TOKEN, Client, until
from tests.extras.uploads.makers import PICTURE

NOTHING = dict.fromkeys(("receiving", "waiting", "making", "done", "failed"), 0)
RATE = 4000  # bytes a second, of UploadConfig
JPEG = "Content-Type: image/jpeg"


def length(nbytes: int) -> str:
    return f"{JPEG}\r\nContent-Length: {nbytes}"


CHUNKED = f"{JPEG}\r\nTransfer-Encoding: chunked"
EXPECTS = f"{length(100_000)}\r\nExpect: 100-continue"


def chunk(data: bytes) -> bytes:
    return b"%x\r\n%b\r\n" % (len(data), data)


@dataclass
class Sender:
    """A connection from an address of its own that has sent a request's head."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    @classmethod
    async def open(cls, client: Client, headers: str, address: str = "127.0.0.1") -> Sender:
        reader, writer = await asyncio.open_connection("127.0.0.1", client.server.port, local_addr=(address, 0))
        head = f"POST /avatars?consent=yes HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n{headers}"
        writer.write(f"{head}\r\n\r\n".encode())
        return cls(reader, writer)

    async def answer(self) -> tuple[int, str]:
        """Status and the line of the answer, at the end of which the server closed the connection."""
        with contextlib.suppress(ConnectionError):
            head, _, line = (await self.reader.read()).decode().rpartition("\r\n\r\n")
            self.writer.close()
            return int(head.split("HTTP/1.1 ")[-1].split()[0]), line
        return 0, "cut off"


def late(pieces: list[tuple[float, int]], end: float = 1e9) -> float | None:
    """When a sender of (seconds since the last, bytes) is too slow; None: it is not, until ``end``."""
    floor, now = RateFloor(RATE, 10.0, 0.0), 0.0
    for after, nbytes in pieces:
        if now + floor.left(now) < now + after:
            return now + floor.left(now)
        now += after
        floor.receive(nbytes, now)
    return now + floor.left(now) if now + floor.left(now) < end else None


def test_the_rate() -> None:
    assert UploadConfig(folder=None, make=None).rate == RATE  # type: ignore[arg-type]
    assert late([]) == 10
    assert late([(3, 1)] * 40) == pytest.approx(10, abs=0.01)  # a byte every three seconds
    assert late([(1, RATE // 2)] * 120) == pytest.approx(19.5, abs=1)  # half the rate: twice the slack
    assert late([(0, 10**7)]) == 10  # what came at once earns ten seconds, not more
    assert late([(0, 10**7)] + [(1, RATE - 400)] * 120) == pytest.approx(100, abs=11)
    assert late([(1, 8000)] * 120, end=121) is None  # 64 kbit/s
    assert late([(5, 40_000)] * 24, end=121) is None  # the same in bursts
    assert late([(9.9, RATE * 10)] * 12, end=121) is None  # bursts of just the rate


SLOW = {
    "a byte": (length(1_000_000), b"x", {"stall": 0.2}),
    "a chunk of a byte": (CHUNKED, chunk(b"x"), {"stall": 0.2}),
    "nothing after 100 Continue": (EXPECTS, b"", {"stall": 0.2}),
    "no last chunk": (CHUNKED, chunk(PICTURE), {"stall": 0.2}),
    "all but one byte": (length(len(PICTURE) + 1), PICTURE, {"stall": 0.2}),
    "too long in all": (length(10**7), b"ok", {"stall": GUARD, "receive_timeout": 0.2}),
}


@pytest.mark.parametrize("kind", SLOW)
async def test_a_slow_sender_loses_its_place(takes, kind: str) -> None:
    headers, data, options = SLOW[kind]
    async with takes(waiting=0, **options) as client:
        slow = await Sender.open(client, headers)
        slow.writer.write(data)
        status, line = await slow.answer()
        assert status == 408 and line.count("\n") == 1
        assert "too slowly: at least 4 kB a second are needed, all of them within" in line
        assert client.counts() == NOTHING


async def test_one_sender_an_address(takes) -> None:
    """However many connections it opens, another address has a place; a job of its own may wait beside."""
    async with takes() as client:
        await client.post(b"wait")
        many = [await Sender.open(client, length(1000), "127.0.0.9") for _ in range(20)]
        answers = [asyncio.create_task(one.answer()) for one in many]
        await until(lambda: sum(task.done() for task in answers) == 19)
        assert client.counts()["receiving"] == 1
        said = {task.result() for task in answers if task.done()}
        assert said == {(503, "other pictures from this address are on their way; send yours after them\n")}
        assert (await client.post(b"wait"))[0] == 202
        for task in answers:
            task.cancel()
        for one in many:
            one.writer.transport.abort()
        await client.received(0)


async def test_two_slow_addresses_leave_a_place(takes) -> None:
    async with takes() as client:
        slow = [await Sender.open(client, length(1000), f"127.0.0.{host}") for host in (11, 12, 11, 12)]
        await client.received(2)
        assert (await client.post(b"wait"))[0] == 202
        for one in slow:
            one.writer.transport.abort()


async def test_a_sender_that_leaves_in_the_middle_leaves_nothing(takes) -> None:
    async with takes(waiting=0) as client:
        for leave in ("abort", "close", "write_eof"):
            gone = await Sender.open(client, length(1000))
            gone.writer.write(b"abc")
            await client.received(1)
            getattr(gone.writer.transport, leave)()
            await client.received(0)
            gone.writer.close()
        assert client.counts() == NOTHING


async def test_a_sender_that_stops_after_the_last_byte_is_served(takes) -> None:
    """It reads no answer and stays connected."""
    async with takes() as client:
        silent = await Sender.open(client, length(len(PICTURE)))
        silent.writer.write(PICTURE)
        await until(lambda: client.counts()["done"] == 1)
        silent.writer.transport.abort()


@pytest.mark.parametrize("how", ["waits", "leaves"])
async def test_a_place_held_for_nothing_counts(takes, how: str) -> None:
    """As further requests of that address, and of no other: it cannot come back again and again."""
    limits = replace(LIMITS, uploads=1e-6, uploads_burst=2.0, uploads_unfinished=10.0)
    async with takes(limits=limits, stall=0.4) as client:
        slow = await Sender.open(client, length(1000), "127.0.0.21")
        await client.received(1)
        if how == "leaves":
            await asyncio.sleep(0.3)
            slow.writer.transport.abort()
        else:
            assert (await slow.answer())[0] == 408
        await client.received(0)
        again = await Sender.open(client, length(1000), "127.0.0.21")
        status, line = await again.answer()
        assert status == 429 and "too many pictures from one address" in line
        assert (await client.post(b"wait"))[0] == 202  # another address


def test_coming_back_is_no_way_to_hold_a_place() -> None:
    """A place held to the last second costs an address five times as long without one."""
    limits, stall = Limits(), UploadConfig(folder=None, make=None).stall  # type: ignore[arg-type]
    assert limits.uploads_unfinished * stall + 1 >= 3
    assert stall / ((1 + limits.uploads_unfinished * stall) / limits.uploads) < 1 / 6
