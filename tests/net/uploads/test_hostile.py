"""Clients that send what no page would: each gets one line or is cut off, and nothing of it stays."""

from __future__ import annotations

import asyncio
import gzip
import random
from dataclasses import replace

import aiohttp
import pytest

import glsplat.net.uploads.upload_store
from glsplat.errors import FormatError
from glsplat.net.client import Client as Streaming
from glsplat.net.guard.limits import Limits
from glsplat.net.uploads.job import VIEWS
from tests.net.uploads.conftest import GUARD, HEADERS, LIMITS, TOKEN
from tests.net.uploads.makers import PICTURE
from tests.net.uploads.test_uploads import form

pytestmark = pytest.mark.check

BOUNDARY = "x" * 20


def multipart(*parts: bytes) -> bytes:
    return (
        b"".join(b"--" + BOUNDARY.encode() + b"\r\n" + part + b"\r\n" for part in parts)
        + f"--{BOUNDARY}--\r\n".encode()
    )


def part(name: str, body: bytes, *headers: str) -> bytes:
    lines = [f'Content-Disposition: form-data; name="{name}"', *headers]
    return "\r\n".join(lines).encode() + b"\r\n\r\n" + body


CONSENT = part("consent", b"yes")
REFUSED = {
    "no front": (400, "a picture from the front is needed", form(back=PICTURE)),
    "empty front": (400, "a picture from the front is needed", form(front=b"")),
    "no consent": (400, "consent=yes is needed", form(front=PICTURE, consent="no")),
    "a height in centimetres": (400, "height needs 0.5 to 2.8 metres", form(front=PICTURE, height="174")),
    "a height that is no number": (400, "height needs", form(front=PICTURE, height="nan")),
    "anyway of another kind": (400, "anyway needs yes or no", form(front=PICTURE, anyway="1")),
    "an unknown field": (400, "and no others", form(front=PICTURE, path="/etc/passwd")),
    "too long a field": (400, "height needs", form(front=PICTURE, height="1" * 500)),
    "too big a picture": (413, "a picture has at most 0.01 MB", form(front=bytes(10_001))),
    "too much in all": (413, "all of them together 0.03 MB", form(**dict.fromkeys(VIEWS, bytes(30_000)))),
    "one field twice": (400, "two fields front", multipart(CONSENT, part("front", b"x"), part("front", b"y"))),
    "a form in a form": (400, "cannot be read", multipart(part("front", multipart(b""), "Content-Type: a/b"))),
    "no end": (400, "cannot be read", multipart(CONSENT)[:-30]),
    "no boundary": (400, "cannot be read", b"just bytes"),
    "nothing": (400, "cannot be read", b""),
    "a header without end": (400, "cannot be read", multipart(b"Content-Disposition: " + b"x" * 20_000)),
    "a thousand headers": (400, "cannot be read", multipart(b"a: b\r\n" * 1000 + b"\r\nx")),
    "a name that is none": (400, "cannot be read", multipart(CONSENT, part("", PICTURE))),
    "parts without end": (400, "cannot be read", multipart(*[part("front", b"")] * 1000)),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_wrong_is_said_in_one_line(takes, name):
    status, line, data = REFUSED[name]

    async def main():
        async with takes(picture_bytes=10_000, body_bytes=30_000) as client:
            headers = {}
            if isinstance(data, bytes):
                headers["Content-Type"] = f"multipart/form-data; boundary={BOUNDARY}"
            got = await client.post(data, query="", headers=headers)
            assert got[0] == status and line in got[1] and got[1].count("\n") == 1, got
            assert client.counts()["receiving"] == 0  # its place is free again

    asyncio.run(main())


def test_one_who_is_often_wrong_is_served_when_right(takes):
    async def main():
        async with takes(picture_bytes=10_000, body_bytes=30_000, per_address=1, waiting=0) as client:
            for name, (status, _, data) in REFUSED.items():
                headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
                told = await client.post(data, query="", headers=headers if isinstance(data, bytes) else {})
                assert told[0] == status, name
            await client.made()

    asyncio.run(main())


def test_other_kinds_of_bodies_are_refused_unread(takes):
    async def main():
        async with takes() as client:
            for kind in ("image/heic", "text/html", "application/zip", "application/x-www-form-urlencoded", "x"):
                status, line = await client.post(PICTURE, headers={"Content-Type": kind})
                assert status == 415 and line.startswith("send one picture"), kind
            for body in (gzip.compress(bytes(10**8)), b"no gzip at all", b"", PICTURE):
                for coding in ("gzip", "deflate", "zstd", "br", "GZip, identity"):
                    status, line = await client.post(body, headers={"Content-Encoding": coding})
                    assert status == 415 and line.count("\n") == 1, (coding, body[:20])

    asyncio.run(main())


def test_transfer_encodings_are_not_decoded(takes):
    async def main():
        async with takes() as client:
            bomb = gzip.compress(b"refuse" + bytes(10**6))
            body = multipart(CONSENT, part("front", bomb, "Content-Encoding: gzip", "Content-Type: image/jpeg"))
            headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
            await client.made(body, query="", headers=headers)  # the stub reads no "refuse" in it

    asyncio.run(main())


@pytest.mark.parametrize("length", [True, False])
def test_a_huge_body_is_cut_off(takes, length):
    async def chunks(sent):
        while sent[0] < 300 * 2**20:
            sent[0] += 2**18
            yield bytes(2**18)

    async def main():
        async with takes() as client:
            sent = [0]
            headers = {"Content-Length": str(300 * 2**20)} if length else {}
            try:
                status, line = await client.post(
                    chunks(sent), headers={"Content-Type": "image/jpeg"} | headers, chunked=None if length else True
                )
                assert status == 413 and line.count("\n") == 1
            except aiohttp.ClientError:
                pass
            assert sent[0] < 120 * 2**20
            await client.made()

    asyncio.run(main())


def test_a_thousand_posts_are_held_off(takes):
    async def main():
        limits = replace(LIMITS, uploads=1e-6, uploads_burst=Limits().uploads_burst)  # however long it takes
        async with takes(limits=limits) as client:

            async def post():
                try:
                    return (await client.post())[0]
                except aiohttp.ClientError:
                    return 0

            got = [status for _ in range(20) for status in await asyncio.gather(*(post() for _ in range(50)))]
            assert got.count(202) <= Limits().uploads_burst and got.count(429) > 900
            assert len(client.kept()) <= Limits().uploads_burst
            assert (await client.ask("GET", "/session"))[0] == 200

    asyncio.run(main())


@pytest.mark.parametrize(
    ("status", "headers"),
    [(401, {}), (401, {"Authorization": "Bearer wrong-wrong-wrong"}),
     (403, HEADERS | {"Origin": "https://elsewhere.example"}), (421, HEADERS | {"Host": "elsewhere.example"})],
)  # fmt: skip
def test_only_who_may_connect_may_do_this(takes, status, headers):
    async def main():
        async with takes() as client:
            name = await client.made()
            for method, path in (
                ("POST", "/avatars?consent=yes"),
                ("GET", f"/avatars/{name}"),
                ("DELETE", f"/avatars/{name}"),
            ):
                got = await client.ask(method, path, headers)
                assert got[0] == status and got[1].count("\n") == 1
            assert client.kept() == [f"{name}.glb"]

    asyncio.run(main())


def test_a_disk_that_is_full_says_so_and_keeps_nothing(takes, monkeypatch):
    def full(*args, **options):
        raise FormatError("/srv/avatars/x.glb: cannot be written (No space left on device)")

    async def main():
        async with takes() as client:
            monkeypatch.setattr(glsplat.net.uploads.upload_store, "replace_file", full)
            _, told = await client.post()
            told = await client.until(told["name"], "failed")
            assert told["error"] == "the avatar could not be kept: this server's disk refuses it"  # and names no file
            assert client.kept() == [] and await client.offered() == ["default"]

    asyncio.run(main())


def test_findings_without_end_are_cut_short(takes):
    """As text, and still read: what the maker's process writes, the server takes."""

    async def main():
        async with takes() as client:
            _, told = await client.post(b"many")
            told = await client.until(told["name"], "failed")
            assert told["error"] == "\U00010000" * 300 and len(told["findings"]) == 40
            assert told["findings"][-1]["text"] == "\U00010000" * 300

    asyncio.run(main())


def test_an_avatar_that_is_too_big_is_not_taken(takes):
    async def main():
        async with takes(avatar_bytes=10_000) as client:
            _, told = await client.post()
            assert "server's own" in (await client.until(told["name"], "failed"))["error"]
            assert client.kept() == []

    asyncio.run(main())


def test_mangled_forms_are_answered_and_leave_nothing(takes):
    whole = multipart(CONSENT, part("front", PICTURE, "Content-Type: image/jpeg"), part("height", b"1.7"))

    async def main():
        random.seed(7)
        async with takes(stall=GUARD, per_address=9, senders=9, waiting=20) as client:
            for _ in range(150):
                data = bytearray(whole)
                for _ in range(random.randrange(1, 6)):
                    at = random.randrange(len(data))
                    kind = random.randrange(3)
                    if kind == 0:
                        data[at] = random.randrange(256)
                    elif kind == 1:
                        del data[at : at + random.randrange(40)]
                    else:
                        data[at:at] = data[random.randrange(len(data)) :][: random.randrange(60)]
                headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
                status, line = await client.post(bytes(data), query="", headers=headers)
                assert status in (202, 400, 413, 503), line
                if status == 202:
                    await client.ask("DELETE", f"/avatars/{line['name']}")
                else:
                    assert line.count("\n") == 1
            await client.made()
            assert len(client.kept()) == 1

    asyncio.run(main())


def test_a_streaming_client_is_served_all_the_while(takes, cameras, tmp_path):
    async def main():
        async with takes() as client:
            async with Streaming(client.server.url, token=TOKEN, timeout=GUARD) as streaming:
                _, told = await client.post(f"hold {tmp_path / 'go on'}, then crash".encode())
                await client.until(told["name"], "making")
                count = 0
                while (await client.ask("GET", f"/avatars/{told['name']}"))[1]["state"] != "failed":
                    await streaming.render(cameras)
                    count += 1
                    if count == 20:
                        (tmp_path / "go on, then crash").touch()
                assert count >= 20 and (await streaming.render(cameras)).frame_id == count + 1

    asyncio.run(main())
