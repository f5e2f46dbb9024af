"""Photographs in, avatars out: what a client sees of the making, and what stays of it."""

from __future__ import annotations

import asyncio

import aiohttp
import pytest

from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.routes import Uploads
from glsplat.formats import load
from glsplat.net.guard.access import Access
from glsplat.net.guard.forwarded import proxy_network
from glsplat.net.server import ServerConfig
from tests.extras.uploads.conftest import GUARD, HEADERS, described, until
from tests.extras.uploads.makers import PICTURE, make

pytestmark = pytest.mark.check


def form(**fields) -> aiohttp.FormData:
    data = aiohttp.FormData()
    for name, value in ({"consent": "yes"} | fields).items():
        if isinstance(value, bytes):
            data.add_field(name, value, filename="../../etc/passwd.jpg", content_type="image/jpeg")
        else:
            data.add_field(name, value)
    return data


async def test_a_form_brings_sides_height_and_title(takes):
    fields = form(front=PICTURE, back=PICTURE, left=b"", height="1.74", anyway="no", name="Zoë O'Neil 日本")
    async with takes() as client:
        name = await client.made(fields, query="")
        meta = load(client.folder / f"{name}.glb").meta
    assert meta["pictures"] == "back,front" and meta["height"] == "1.74" and meta["title"] == "Zoë O'Neil 日本"
    assert name.startswith("photo-")  # whatever the picture's file was called


async def test_findings_are_reported_and_the_avatar_is_made_anyway(takes):
    async with takes() as client:
        told = await client.job(b"doubt", "failed")
        assert told["error"] == "the picture has two faults" and len(told["findings"]) == 2
        assert told["findings"][0] == {"side": "front", "code": "small", "kind": "refusal", "text": "Come nearer."}
        assert not told["goes_on"]
        assert (await client.ask("POST", f"/avatars/{told['name']}/anyway", headers={}))[0] == 401
        await client.made(b"doubt", query="?consent=yes&anyway=yes")


async def test_notes_are_reported_steps_bounded_and_prints_kept_back(takes, capfd):
    async with takes() as client:
        told = await client.job(b"guess busy print this-secret", "done")
    assert told["findings"] == [{"side": "front", "code": "arms", "kind": "note", "text": "Hold your arms away."}]
    assert len(told["steps"]) <= 40 and told["share"] == 1
    assert "secret" not in "".join(capfd.readouterr())


OWN_FAULT = "an error on the server; another picture may work"


async def test_a_failure_is_one_line_and_the_next_picture_is_made(takes, caplog, capfd):
    lines = dict.fromkeys(("crash", "exit", "fault", "memory"), OWN_FAULT)
    lines["refuse"] = "the JPEG file is damaged; copy it again"
    async with takes() as client:
        for word, line in lines.items():
            told = await client.job(f"{word} secret-in-the-picture".encode(), "failed")
            assert told["error"] == line and told["findings"] == []
            assert client.kept() == [] and await client.offered() == ["default"]
        await client.made()
    assert "secret" not in caplog.text + "".join(capfd.readouterr())
    assert "signal 11" in caplog.text and "ValueError at makers.py" in caplog.text


async def test_one_is_made_at_a_time_and_few_wait(takes, tmp_path):
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


async def test_one_address_leaves_room_for_others(takes):
    async with takes(per_address=1) as client:
        name = (await client.post(b"wait"))[1]["name"]
        status, line = await client.post()
        assert status == 503 and "at most 1 avatars at once from one address" in line
        assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 204
        assert (await client.post(b"wait"))[0] == 202


@pytest.mark.parametrize("state", ["making", "waiting"])
async def test_a_cancelled_job_ends_at_once_and_leaves_nothing(takes, state):
    async with takes() as client:
        first = (await client.job(b"wait", "making"))["name"]
        second = (await client.post(b"wait"))[1]["name"]
        name, other = (first, second) if state == "making" else (second, first)
        statuses = [(await client.ask(method, f"/avatars/{name}"))[0] for method in ("DELETE", "GET", "DELETE")]
        assert statuses == [204, 404, 404]
        await client.ask("DELETE", f"/avatars/{other}")
        made = await client.made()
        assert client.kept() == [f"{made}.glb"]


async def test_a_job_that_takes_too_long_is_given_up(takes):
    async with takes(make_timeout=0.2) as client:
        told = await client.job(b"wait", "failed")
    assert told["error"] == "it took more than 0.2 s and was given up; try again later"


async def test_the_server_stops_while_one_is_made(takes):
    async with takes() as client:
        await client.job(b"wait", "making")
        await client.post(b"wait")
        async with asyncio.timeout(GUARD):
            await client.server.stop()
        assert client.kept() == []


async def test_deleting_an_avatar_closes_its_viewers_only(takes):
    async with takes() as client:
        name = await client.made()
        async with (
            client.http.ws_connect(f"{client.server.url}?avatar={name}", headers=HEADERS) as ws,
            client.http.ws_connect(f"{client.server.url}?avatar=default", headers=HEADERS) as beside,
        ):
            receiving = asyncio.create_task(ws.receive())
            assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 204
            closed = await receiving
            assert (closed.type, closed.data) == (aiohttp.WSMsgType.CLOSE, 1001) and not beside.closed
        assert client.kept() == [] and await client.offered() == ["default"]
        assert (await client.ask("DELETE", f"/avatars/{name}"))[0] == 404


async def test_only_avatars_made_here_are_deleted(takes):
    async with takes() as client:
        (client.folder / "mine.glb").write_bytes(b"of the operator")
        (client.folder / "photo-.glb").write_bytes(b"of the operator")
        for name in ("default", "photo-", "photo-../../x", "..%2f..%2fetc%2fpasswd", "mine", "photo-abcd1234"):
            assert (await client.ask("DELETE", f"/avatars/{name}"))[0] in (403, 404), name
        assert len(client.kept()) == 2


async def test_a_full_folder_is_refused_before_the_picture_is_made(takes):
    async with takes(max_avatars=1) as client:
        (client.folder / "mine.glb").write_bytes(b"of the operator")
        status, line = await client.post()
        assert status == 507
        assert line == "this server keeps 1 avatars and has no room for another; delete one first\n"


async def test_a_server_without_a_folder_takes_nothing(serve):
    async with serve() as server, aiohttp.ClientSession() as http:
        origin = f"http://127.0.0.1:{server.port}"
        async with http.get(f"{origin}/session") as answer:
            assert (await answer.json())["upload"] is None
        async with http.post(f"{origin}/avatars?consent=yes", data=b"x") as answer:
            assert answer.status == 404


async def test_a_refused_job_goes_on_where_it_stopped(takes):
    async with takes() as client:
        told = await client.job(b"doubt known worse", "failed")
        name, before = told["name"], told["steps"]
        for _ in range(2):
            assert told["goes_on"] and told["findings"]
            status, told = await client.ask("POST", f"/avatars/{name}/anyway")
            assert status == 202 and told["state"] == "waiting" and not told["findings"] and told["error"] is None
            told = await client.until(name, "done", "failed")
        assert told["state"] == "done" and told["steps"] == [*before, "making the person"]  # one look at the picture
        assert client.kept() == [f"{name}.glb"] and await client.offered() == ["default", name]
        status, text = await client.ask("POST", f"/avatars/{name}/anyway")
        assert status == 409 and "send the pictures again" in text


async def test_a_server_that_is_busy_says_when_to_ask_again(takes):
    async with takes(waiting=1) as client:
        told = await client.job(b"doubt known", "failed")
        name = told["name"]
        assert told["goes_on"]
        others = [client.server.feature(Uploads)._queue.book(address) for address in "ab"]  # whose pictures still come
        for path, data in ((f"/avatars/{name}/anyway", b""), ("/avatars?consent=yes", PICTURE)):
            address = f"{client.origin}{path}"
            async with client.http.post(address, data=data, headers=HEADERS | {"Content-Type": "image/jpeg"}) as no:
                assert no.status == 503 and int(no.headers["Retry-After"]) > 0
                assert "2 avatars are being made or wait" in await no.text()
        assert (await client.ask("GET", f"/avatars/{name}"))[1]["goes_on"]
        client.server.feature(Uploads)._queue.cancel(others[0])
        assert (await client.ask("POST", f"/avatars/{name}/anyway"))[0] == 202


async def test_the_stream_of_ones_own_machine_steps_back_while_one_is_made(takes, tmp_path):
    async with takes() as client:
        loop = client.server.drawer
        assert not loop.should_yield()
        told = await client.job(f"hold {tmp_path / 'go on'}".encode(), "making")
        assert loop.should_yield()
        (tmp_path / "go on").touch()
        await client.until(told["name"], "done")
        assert not loop.should_yield()
        await client.job(b"doubt known", "failed")
        assert not loop.should_yield()  # what waits for a word needs no machine


async def test_a_refused_job_is_dropped_for_another_on_request_or_after_a_while(takes):
    async with takes(resume_timeout=0.3) as client:
        name = (await client.job(b"doubt known", "failed"))["name"]
        while (await client.ask("GET", f"/avatars/{name}"))[1]["goes_on"]:
            await asyncio.sleep(0.02)
        assert (await client.ask("POST", f"/avatars/{name}/anyway"))[0] == 409
    async with takes() as client:
        first, second = [(await client.job(b"doubt known", "failed"))["name"] for _ in range(2)]
        assert not (await client.ask("GET", f"/avatars/{first}"))[1]["goes_on"]
        assert (await client.ask("DELETE", f"/avatars/{second}"))[0] == 204
        assert (await client.ask("POST", f"/avatars/{second}/anyway"))[0] == 404
        assert (await client.job(b"doubt known", "failed"))["goes_on"]  # and the server stops with it


@pytest.mark.parametrize(
    "access", [Access(host="0.0.0.0", insecure=True), Access(proxies=(proxy_network("127.0.0.1"),))]
)
async def test_where_others_look_on_drawing_goes_first(serve, tmp_path, access):
    uploads = Uploads(UploadConfig(folder=tmp_path, make=make), described)
    async with serve(config=ServerConfig(port=0, access=access), features=[uploads]) as server:
        url = f"http://127.0.0.1:{server.port}/avatars?consent=yes"
        async with aiohttp.ClientSession() as http:
            async with http.post(url, data=b"wait", headers={"Content-Type": "image/jpeg"}) as answer:
                assert answer.status == 202
        await until(uploads.needs_cpu)
        assert not server.drawer.should_yield()
