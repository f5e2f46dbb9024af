"""Photographs in, avatars out: what a client sees of the making, and what stays of it."""

from __future__ import annotations

import asyncio
import stat

import aiohttp
import pytest

from glsplat.formats import load
from glsplat.net.guard.access import Access
from glsplat.net.guard.forwarded import proxy_network
from glsplat.net.server import Server, ServerConfig
from glsplat.net.uploads.job import UploadConfig
from glsplat.net.uploads.routes import Uploads
from tests.net.conftest import FakeBackend
from tests.net.uploads.conftest import GUARD, HEADERS, described, until
from tests.net.uploads.makers import PICTURE, make


def form(**fields) -> aiohttp.FormData:
    data = aiohttp.FormData()
    for name, value in ({"consent": "yes"} | fields).items():
        if isinstance(value, bytes):
            data.add_field(name, value, filename="../../etc/passwd.jpg", content_type="image/jpeg")
        else:
            data.add_field(name, value)
    return data


def test_a_photograph_becomes_an_avatar_that_is_offered_and_kept(takes):
    async def main():
        async with takes() as client:
            session = (await client.ask("GET", "/session"))[1]
            assert session["upload"]["views"] == ["front", "back", "left", "right"]
            status, told = await client.post()
            assert status == 202 and told["state"] == "waiting" and told["ahead"] == 0
            name = told["name"]
            told = await client.until(name, "done")
            assert told["steps"] == ["looking at the picture", "making the person"] and told["share"] == 1
            assert told["error"] is None and told["findings"] == []
            offered = (await client.ask("GET", "/session"))[1]["avatars"]
            assert [one["name"] for one in offered] == ["default", name]
            assert [one["made"] for one in offered] == [False, True]
            async with client.http.ws_connect(
                f"{client.server.url}?avatar={name}", headers={"Authorization": "Bearer 0123456789abcdef"}
            ) as ws:
                assert not ws.closed
            assert client.kept() == [f"{name}.glb"]
            path = client.folder / f"{name}.glb"
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            avatar = load(path)
            assert avatar.meta["pictures"] == "front" and avatar.meta["height"] == "None"
            assert PICTURE not in path.read_bytes()

    asyncio.run(main())


@pytest.mark.check
def test_a_form_brings_all_sides_and_the_height(takes):
    async def main():
        async with takes() as client:
            name = await client.made(form(front=PICTURE, back=PICTURE, left=b"", height="1.74", anyway="no"), query="")
            meta = load(client.folder / f"{name}.glb").meta
            assert meta["pictures"] == "back,front" and meta["height"] == "1.74"
            assert name.startswith("photo-")  # whatever the picture's file was called

    asyncio.run(main())


@pytest.mark.check
def test_what_is_wrong_with_a_picture_is_told_and_it_is_made_anyway(takes):
    async def main():
        async with takes() as client:
            _, told = await client.post(b"doubt")
            told = await client.until(told["name"], "failed")
            assert told["error"] == "the picture has two faults"
            assert (
                told["findings"][0] == {"side": "front", "code": "small", "kind": "refusal", "text": "Come nearer."}
                and len(told["findings"]) == 2
            )
            await client.made(b"doubt", query="?consent=yes&anyway=yes")

    asyncio.run(main())


@pytest.mark.check
def test_what_was_guessed_is_told(takes):
    async def main():
        async with takes() as client:
            _, told = await client.post(b"guess")
            told = await client.until(told["name"], "done")
            assert told["findings"] == [
                {"side": "front", "code": "arms", "kind": "note", "text": "Hold your arms away."}
            ]

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize(
    ("word", "line"),
    [
        (b"refuse", "the JPEG file is damaged; copy it again"),
        (b"crash", "it could not be made, for a reason of the server's own; another picture may do"),
        (b"exit", "it could not be made, for a reason of the server's own; another picture may do"),
        (b"fault", "it could not be made, for a reason of the server's own; another picture may do"),
        (b"memory", "it could not be made, for a reason of the server's own; another picture may do"),
    ],
)
def test_a_failure_is_one_line_and_the_next_picture_is_made(takes, caplog, capfd, word, line):
    async def main():
        async with takes() as client:
            _, told = await client.post(word + b" secret-in-the-picture")
            told = await client.until(told["name"], "failed")
            assert told["error"] == line and told["findings"] == []
            assert client.kept() == [] and await client.offered() == ["default"]
            await client.made()

    asyncio.run(main())
    assert "secret" not in caplog.text + "".join(capfd.readouterr())
    if word in (b"crash", b"fault"):
        assert {b"crash": "signal 11", b"fault": "ValueError at makers.py"}[word] in caplog.text


@pytest.mark.check
def test_what_the_maker_prints_reaches_nobody(takes, capfd):
    async def main():
        async with takes() as client:
            await client.made(b"print this-secret")

    asyncio.run(main())
    assert "secret" not in "".join(capfd.readouterr())


@pytest.mark.check
def test_steps_are_bounded(takes):
    async def main():
        async with takes() as client:
            _, told = await client.post(b"busy")
            return await client.until(told["name"], "done")

    told = asyncio.run(main())
    assert len(told["steps"]) <= 40 and told["share"] == 1


@pytest.mark.check
def test_one_is_made_at_a_time_and_few_wait(takes, tmp_path):
    async def main():
        async with takes(per_address=9) as client:
            names = [(await client.post(f"hold {tmp_path / 'go on'}".encode()))[1]["name"] for _ in range(3)]
            status, line = await client.post()
            assert status == 503 and "3 avatars are being made or wait" in line
            states = [(await client.ask("GET", f"/avatars/{name}"))[1] for name in names]
            assert [told["ahead"] for told in states][1:] == [1, 2]
            assert [told["state"] for told in states].count("making") <= 1
            (tmp_path / "go on").touch()
            for name in names:
                await client.until(name, "done")
            await client.made()

    asyncio.run(main())


@pytest.mark.check
def test_one_address_leaves_room_for_others(takes):
    async def main():
        async with takes(per_address=1) as client:
            _, told = await client.post(b"wait")
            status, line = await client.post()
            assert status == 503 and "at most 1 avatars at once from one address" in line
            assert (await client.ask("DELETE", f"/avatars/{told['name']}"))[0] == 204
            await client.made()

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize("state", ["making", "waiting"])
def test_a_cancelled_job_ends_at_once_and_leaves_nothing(takes, state):
    async def main():
        async with takes() as client:
            first = (await client.post(b"wait"))[1]["name"]
            second = (await client.post(b"wait"))[1]["name"]
            await client.until(first, "making")
            name = first if state == "making" else second
            assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 204
            assert (await client.ask("GET", f"/avatars/{name}"))[0] == 404
            assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 404
            await client.ask("DELETE", f"/avatars/{second if name == first else first}")
            await client.made()
            assert len(client.kept()) == 1

    asyncio.run(main())


@pytest.mark.check
def test_a_job_that_takes_too_long_is_given_up(takes):
    async def main():
        async with takes(seconds=0.2) as client:
            _, told = await client.post(b"wait")
            told = await client.until(told["name"], "failed")
            assert told["error"] == "it took more than 0.2 s and was given up; try again later"

    asyncio.run(main())


@pytest.mark.check
def test_the_server_stops_while_one_is_made(takes):
    async def main():
        async with takes() as client:
            _, told = await client.post(b"wait")
            await client.post(b"wait")
            await client.until(told["name"], "making")
            async with asyncio.timeout(GUARD):
                await client.server.stop()
            assert client.kept() == []

    asyncio.run(main())


@pytest.mark.check
def test_an_avatar_is_deleted_and_who_sees_it_is_told(takes):
    async def main():
        async with takes() as client:
            name = await client.made()
            other = await client.made()
            token = {"Authorization": "Bearer 0123456789abcdef"}
            async with (
                client.http.ws_connect(f"{client.server.url}?avatar={name}", headers=token) as ws,
                client.http.ws_connect(f"{client.server.url}?avatar={other}", headers=token) as beside,
            ):
                receiving = asyncio.create_task(ws.receive())
                assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 204
                closed = await receiving
                assert (closed.type, closed.data) == (aiohttp.WSMsgType.CLOSE, 1001) and not beside.closed
            assert client.kept() == [f"{other}.glb"] and await client.offered() == ["default", other]
            assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 404

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize(
    "name", ["default", "photo-", "photo-../../x", "..%2f..%2fetc%2fpasswd", "mine", "photo-abcd1234"]
)
def test_only_what_was_made_here_is_deleted(takes, name):
    async def main():
        async with takes() as client:
            (client.folder / "mine.glb").write_bytes(b"of the operator")
            (client.folder / "photo-.glb").write_bytes(b"of the operator")
            status, line = await client.ask("DELETE", f"/avatars/{name}")
            assert status in (403, 404) and len(client.kept()) == 2, line

    asyncio.run(main())


@pytest.mark.check
def test_a_full_folder_says_so(takes):
    async def main():
        async with takes(most_files=1) as client:
            name = await client.made()
            status, line = await client.post()
            assert (
                status == 507 and line == "this server keeps 1 avatars and has no room for another; delete one first\n"
            )
            await client.ask("DELETE", f"/avatars/{name}")
            await client.made()
        async with takes(folder_bytes=100) as client:
            status, line = await client.post()
            assert status == 507 and "MB of avatars, which are used up" in line

    asyncio.run(main())


@pytest.mark.check
def test_a_server_without_a_folder_takes_nothing(serve):
    async def main():
        async with serve() as server, aiohttp.ClientSession() as http:
            origin = f"http://127.0.0.1:{server.port}"
            async with http.get(f"{origin}/session") as answer:
                assert (await answer.json())["upload"] is None
            async with http.post(f"{origin}/avatars?consent=yes", data=b"x") as answer:
                assert answer.status == 404

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize("word", [b"doubt known", b"doubt known worse"])
def test_what_was_refused_goes_on_where_it_was(takes, word):
    async def main():
        async with takes() as client:
            _, told = await client.post(word)
            name = told["name"]
            told = await client.until(name, "failed")
            assert told["goes_on"] and told["findings"]
            before = told["steps"]
            while told["state"] == "failed":
                assert told["goes_on"]
                status, told = await client.ask("POST", f"/avatars/{name}/anyway")
                assert status == 202 and told["state"] == "waiting" and not told["findings"] and told["error"] is None
                told = await client.until(name, "done", "failed")
            assert told["steps"] == [*before, "making the person"]  # the picture is looked at once
            assert client.kept() == [f"{name}.glb"] and await client.offered() == ["default", name]
            status, text = await client.ask("POST", f"/avatars/{name}/anyway")
            assert status == 409 and "send the pictures again" in text

    asyncio.run(main())


@pytest.mark.check
def test_a_server_that_is_busy_says_when_to_ask_again(takes):
    async def main():
        async with takes(waiting=1) as client:
            name = (await client.post(b"doubt known"))[1]["name"]
            assert (await client.until(name, "failed"))["goes_on"]
            others = [client.server._uploads._queue.book(address) for address in "ab"]  # whose pictures still come
            for path, data in ((f"/avatars/{name}/anyway", b""), ("/avatars?consent=yes", PICTURE)):
                address = f"{client.origin}{path}"
                async with client.http.post(address, data=data, headers=HEADERS | {"Content-Type": "image/jpeg"}) as no:
                    assert no.status == 503 and int(no.headers["Retry-After"]) > 0
                    assert "2 avatars are being made or wait" in await no.text()
            assert (await client.ask("GET", f"/avatars/{name}"))[1]["goes_on"]
            client.server._uploads._queue.cancel(others[0])
            assert (await client.ask("POST", f"/avatars/{name}/anyway"))[0] == 202

    asyncio.run(main())


@pytest.mark.check
def test_what_was_refused_is_forgotten_when_another_comes_or_nobody_does(takes):
    async def main():
        async with takes(patience=0.3) as client:
            refused = (await client.post(b"doubt known"))[1]["name"]
            await client.until(refused, "failed")
            while (await client.ask("GET", f"/avatars/{refused}"))[1]["goes_on"]:
                await asyncio.sleep(0.02)
            assert (await client.ask("POST", f"/avatars/{refused}/anyway"))[0] == 409
        async with takes() as client:
            first = (await client.post(b"doubt known"))[1]["name"]
            assert (await client.until(first, "failed"))["goes_on"]
            await client.made()
            assert not (await client.ask("GET", f"/avatars/{first}"))[1]["goes_on"]
            second = (await client.post(b"doubt known"))[1]["name"]
            await client.until(second, "failed")
            assert (await client.ask("DELETE", f"/avatars/{second}"))[0] == 204
            assert (await client.ask("POST", f"/avatars/{second}/anyway"))[0] == 404
            plain = (await client.post(b"doubt"))[1]["name"]
            assert not (await client.until(plain, "failed"))["goes_on"]
            assert (await client.ask("POST", f"/avatars/{plain}/anyway", headers={}))[0] == 401
            third = (await client.post(b"doubt known"))[1]["name"]
            assert (await client.until(third, "failed"))["goes_on"]  # and the server stops with it

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize("title", ["Zoë", "Ann-Marie O'Neil 2", "日本語"])
def test_its_owner_names_it(takes, title):
    async def main():
        async with takes() as client:
            name = await client.made(form(front=PICTURE, name=title), query="")
            assert load(client.folder / f"{name}.glb").meta["title"] == title

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize("title", ["<b>x</b>", "a" * 33, "../etc", "a\nb", "\u202egnp.exe", " "])
def test_names_that_are_none_are_refused(takes, title):
    async def main():
        async with takes() as client:
            status, text = await client.post(form(front=PICTURE, name=title), query="")
            assert status == (400 if title.strip() else 202), text
            assert title == " " or "name needs 1 to 32 letters" in text

    asyncio.run(main())


@pytest.mark.check
def test_the_stream_of_ones_own_machine_steps_back_while_one_is_made(takes, tmp_path):
    async def main():
        async with takes() as client:
            loop = client.server.render_loop
            assert not loop.stands_back()
            _, told = await client.post(f"hold {tmp_path / 'go on'}".encode())
            await client.until(told["name"], "making")
            assert loop.stands_back()
            (tmp_path / "go on").touch()
            await client.until(told["name"], "done")
            assert not loop.stands_back()
            refused = (await client.post(b"doubt known"))[1]["name"]
            await client.until(refused, "failed")
            assert not loop.stands_back()  # what waits for a word needs no machine

    asyncio.run(main())


@pytest.mark.check
@pytest.mark.parametrize(
    "access", [Access(host="0.0.0.0", insecure=True), Access(proxies=(proxy_network("127.0.0.1"),))]
)
def test_where_others_look_on_drawing_goes_first(tmp_path, access):
    async def main():
        uploads = Uploads(UploadConfig(folder=tmp_path, make=make), described)
        server = Server(FakeBackend(), ServerConfig(port=0, access=access), uploads=uploads)
        await server.start()
        try:
            url = f"http://127.0.0.1:{server.port}/avatars?consent=yes"
            async with aiohttp.ClientSession() as http:
                headers = {"Content-Type": "image/jpeg"}
                async with http.post(url, data=b"wait", headers=headers) as answer:
                    assert answer.status == 202
            await until(lambda: uploads.works)
            assert not server.render_loop.stands_back()
        finally:
            await server.stop()

    asyncio.run(main())
