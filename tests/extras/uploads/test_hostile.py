"""Clients that send what no page would: each gets one line or is cut off, and nothing of it stays."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import random
from dataclasses import replace

import aiohttp
import pytest

import glsplat.extras.uploads.upload_store
from glsplat.errors import FormatError
from glsplat.extras.uploads.form import _FIELDS, RefusedError, split_form
from glsplat.extras.uploads.job import VIEWS
from glsplat.net.client import Client as Streaming
from glsplat.net.guard.limits import Limits
from tests.extras.uploads.conftest import GUARD, HEADERS, LIMITS, TOKEN
from tests.extras.uploads.makers import PICTURE
from tests.extras.uploads.test_uploads import form

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
    "a height in letters": (400, "height needs", form(front=PICTURE, height="tall")),
    "anyway of another kind": (400, "anyway needs yes or no", form(front=PICTURE, anyway="1")),
    "an unknown field": (400, "and no others", form(front=PICTURE, path="/etc/passwd")),
    "too long a field": (400, "height needs", form(front=PICTURE, height="1" * 500)),
    "too big a picture": (413, "a picture has at most 0.01 MB", form(front=bytes(10_001))),
    "too much in all": (413, "all of them together 0.03 MB", form(**dict.fromkeys(VIEWS, bytes(30_000)))),
    "one field twice": (400, "two fields front", multipart(CONSENT, part("front", b"x"), part("front", b"y"))),
    "a form in a form": (400, "cannot be read", multipart(part("front", multipart(b""), "Content-Type: a/b"))),
    **{
        f"the name {title!r}": (400, "name needs 1 to 32 letters", form(front=PICTURE, name=title))
        for title in ("<b>x</b>", "a" * 33, "../etc", "a\nb", "\u202egnp.exe")
    },
    "no end": (400, "cannot be read", multipart(CONSENT)[:-30]),
    "no boundary": (400, "cannot be read", b"just bytes"),
    "nothing": (400, "cannot be read", b""),
    "a header without end": (400, "cannot be read", multipart(b"Content-Disposition: " + b"x" * 20_000)),
    "a thousand headers": (400, "cannot be read", multipart(b"a: b\r\n" * 1000 + b"\r\nx")),
    "a name that is none": (400, "cannot be read", multipart(CONSENT, part("", PICTURE))),
    "parts without end": (400, "cannot be read", multipart(*[part("front", b"")] * 1000)),
}  # fmt: skip


MULTIPART = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}


async def test_each_fault_of_a_form_is_one_line_and_frees_its_place(takes):
    async with takes(picture_bytes=10_000, body_bytes=30_000, per_address=1, waiting=0) as client:
        for name, (status, line, data) in REFUSED.items():
            got = await client.post(data, query="", headers=MULTIPART if isinstance(data, bytes) else {})
            assert got[0] == status and line in got[1] and got[1].count("\n") == 1, (name, got)
            assert client.counts()["receiving"] == 0, name
        await client.made()


async def test_other_kinds_of_bodies_are_refused_unread(takes):
    async with takes() as client:
        for kind in ("image/heic", "text/html", "application/x-www-form-urlencoded", "x"):
            status, line = await client.post(PICTURE, headers={"Content-Type": kind})
            assert status == 415 and line.startswith("send one picture"), kind
        bomb = gzip.compress(bytes(10**8))
        for body, coding in (
            (bomb, "gzip"),
            (bomb, "GZip, identity"),
            (b"no gzip", "gzip"),
            (b"", "br"),
            (PICTURE, "zstd"),
        ):
            status, line = await client.post(body, headers={"Content-Encoding": coding})
            assert status == 415 and line.count("\n") == 1, coding


async def test_transfer_encodings_are_not_decoded(takes):
    bomb = gzip.compress(b"refuse" + bytes(10**6))
    body = multipart(CONSENT, part("front", bomb, "Content-Encoding: gzip", "Content-Type: image/jpeg"))
    async with takes() as client:
        await client.made(body, query="", headers=MULTIPART)  # the stub reads no "refuse" in it


@pytest.mark.parametrize("headers", [{"Content-Length": str(300 * 2**20)}, {}], ids=["length", "chunked"])
async def test_a_huge_body_is_cut_off(takes, headers):
    sent = [0]

    async def chunks():
        while sent[0] < 300 * 2**20:
            sent[0] += 2**18
            yield bytes(2**18)

    async with takes() as client:
        with contextlib.suppress(aiohttp.ClientError):
            more = {"headers": {"Content-Type": "image/jpeg"} | headers, "chunked": None if headers else True}
            status, line = await client.post(chunks(), **more)
            assert status == 413 and line.count("\n") == 1
        assert sent[0] < 120 * 2**20
        await client.received(0)


async def test_hundreds_of_posts_are_held_off(takes):
    limits = replace(LIMITS, uploads=1e-6, uploads_burst=Limits().uploads_burst)  # however long it takes
    async with takes(limits=limits) as client:

        async def post():
            try:
                return (await client.post())[0]
            except aiohttp.ClientError:
                return 0

        got = [status for _ in range(4) for status in await asyncio.gather(*(post() for _ in range(50)))]
        assert got.count(202) <= Limits().uploads_burst and got.count(429) > 180
        assert len(client.kept()) <= Limits().uploads_burst
        assert (await client.ask("GET", "/session"))[0] == 200


async def test_only_who_may_connect_may_make_and_delete(takes):
    async with takes() as client:
        (client.folder / "photo-abcdefgh.glb").touch()
        for status, headers in (
            (401, {}),
            (401, {"Authorization": "Bearer wrong-wrong-wrong"}),
            (403, HEADERS | {"Origin": "https://elsewhere.example"}),
            (421, HEADERS | {"Host": "elsewhere.example"}),
        ):
            for method, path in (("POST", "?consent=yes"), ("GET", "/photo-abcdefgh"), ("DELETE", "/photo-abcdefgh")):
                got = await client.ask(method, f"/avatars{path}", headers)
                assert got[0] == status and got[1].count("\n") == 1
        assert client.kept() == ["photo-abcdefgh.glb"]


async def test_a_disk_that_is_full_says_so_and_keeps_nothing(takes, monkeypatch):
    def full(*args, **options):
        raise FormatError("/srv/avatars/x.glb: cannot be written (No space left on device)")

    async with takes() as client:
        monkeypatch.setattr(glsplat.extras.uploads.upload_store, "replace_file", full)
        told = await client.job(PICTURE, "failed")
        assert told["error"] == "the avatar could not be saved: the server cannot write to its disk"  # no file named
        assert client.kept() == [] and await client.offered() == ["default"]


async def test_findings_without_end_are_cut_short(takes):
    """As text, and still read: what the maker's process writes, the server takes."""
    async with takes() as client:
        told = await client.job(b"many", "failed")
        assert told["error"] == "\U00010000" * 300 and len(told["findings"]) == 40
        assert told["findings"][-1]["text"] == "\U00010000" * 300


async def test_an_avatar_that_is_too_big_is_not_taken(takes):
    async with takes(avatar_bytes=10_000) as client:
        assert "error on the server" in (await client.job(PICTURE, "failed"))["error"]
        assert client.kept() == []


def test_mangled_forms_are_forms_or_refused():
    whole = multipart(CONSENT, part("front", PICTURE, "Content-Type: image/jpeg"), part("height", b"1.7"))
    chance = random.Random(7)
    for _ in range(3000):
        data = bytearray(whole)
        for _ in range(chance.randrange(1, 6)):
            at = chance.randrange(len(data))
            match chance.randrange(3):
                case 0:
                    data[at] = chance.randrange(256)
                case 1:
                    del data[at : at + chance.randrange(40)]
                case _:
                    data[at:at] = data[chance.randrange(len(data)) :][: chance.randrange(60)]
        try:
            fields, pictures = split_form(bytes(data), BOUNDARY.encode())
        except RefusedError as error:
            assert error.status == 400 and "\n" not in str(error)
        else:
            assert set(fields) <= set(_FIELDS) and set(pictures) <= set(VIEWS)


async def test_a_streaming_client_is_served_all_the_while(takes, cameras, tmp_path):
    async with takes() as client, Streaming(client.server.url, token=TOKEN, timeout=GUARD) as streaming:
        told = await client.job(f"hold {tmp_path / 'go on'}, then crash".encode(), "making")
        for _ in range(5):
            await streaming.render(cameras)
        (tmp_path / "go on, then crash").touch()
        while (await client.ask("GET", f"/avatars/{told['name']}"))[1]["state"] != "failed":
            await streaming.render(cameras)
