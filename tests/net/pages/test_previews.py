"""Small pictures for the pages, and for whom; the curves; another device's address."""

from __future__ import annotations

import asyncio
import json
from base64 import b64decode
from dataclasses import replace

import aiohttp
import numpy as np
import pytest
import simplejpeg

from glsplat.extras.operations import previews
from glsplat.extras.operations.previews import PORTRAIT_PX, Previews, flattened
from glsplat.extras.operations.status import History
from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.codec.encoded import Encoded
from glsplat.net.guard.access import Access
from glsplat.net.server import ServerConfig
from tests.net.conftest import FakeBackend, eyes

TOKEN = "0123456789abcdef"
PLAIN = ServerConfig(port=0)


def asked(serve, *paths, config=PLAIN, headers=None, client=False, backend=None, **options):
    """(status, body) of each path; ``client``: after somebody was sent a picture."""

    async def main():
        backend_ = backend or FakeBackend()
        async with serve(backend_, config=config, **options) as server, aiohttp.ClientSession() as http:
            async with Client(server.url, TOKEN if config.access.token else None) as viewer:
                if client:
                    await viewer.render(eyes())
                answers = []
                for path in paths:
                    async with http.get(f"http://127.0.0.1:{server.port}{path}", headers=headers) as response:
                        answers.append((response.status, await response.read()))
                return answers

    return asyncio.run(main())


def test_an_avatar_is_drawn_once(serve):
    backend = FakeBackend()
    offered = (AvatarInfo(name="ann", height=1.7), AvatarInfo(name="a room"))
    first, again, other, none = asked(
        serve, "/thumbnails/ann", "/thumbnails/ann", "/thumbnails/a%20room", "/thumbnails/bob",
        offered=offered, backend=backend,
    )  # fmt: skip
    assert [one[0] for one in (first, again, other, none)] == [200, 200, 200, 404]
    assert simplejpeg.decode_jpeg(first[1]).shape == (PORTRAIT_PX, PORTRAIT_PX, 3) and first == again
    assert [job.avatar for job in backend.drawn] == ["ann", "a room"]
    # head and shoulders of somebody of 1.7 m who looks along +z: the head's middle is in the picture's upper half
    (camera,) = backend.drawn[0].cameras
    x, y, z = camera.viewmat[:3, :3] @ [0, 1.58, 0] + camera.viewmat[:3, 3]
    column, row = camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]
    assert z > 0 and column == pytest.approx(PORTRAIT_PX / 2) and 0.2 * PORTRAIT_PX < row < 0.5 * PORTRAIT_PX


def test_one_that_cannot_be_drawn_is_asked_for_later(serve):
    backend = FakeBackend(fail=lambda request: ValueError("no"))
    ((status, body),) = asked(serve, "/thumbnails/default", backend=backend)
    assert status == 503 and b"could not be drawn" in body


def test_the_newest_picture_of_a_client_is_for_those_who_may(serve):
    paths = ("/stats", "/pictures/1", "/pictures/7", f"/pictures/{'9' * 5000}")
    (_, stats), (status, body), *missing = asked(serve, *paths, client=True)
    (client,) = json.loads(stats)["clients"]
    assert client["picture"] is True and client["room"] is None and client["avatar"] == "default"
    assert status == 200 and max(simplejpeg.decode_jpeg(body).shape[:2]) <= 240
    assert [one[0] for one in missing] == [404, 404]
    (_, stats), (hidden, _) = asked(serve, *paths[:2], client=True, config=replace(PLAIN, private=True))
    (client,) = json.loads(stats)["clients"]
    assert hidden == 404 and client["picture"] is False and client["avatar"] is None


def test_alpha_cuts_out_on_a_light_ground():
    colour = np.full((16, 16, 3), (200, 30, 30), np.uint8)
    alpha = np.zeros((16, 16, 1), np.uint8)
    alpha[:, 8:] = 255
    encoded = Encoded([simplejpeg.encode_jpeg(colour, 95)], None, 0.0, [simplejpeg.encode_jpeg(alpha, 95, "GRAY")])
    flat = flattened(encoded)
    assert np.abs(flat[:, :6].astype(int) - (205, 210, 216)).max() < 6
    assert np.abs(flat[:, 10:].astype(int) - (200, 30, 30)).max() < 8


def test_the_curves_go_back_five_minutes():
    history = History()
    for i in range(400):
        history.add({"fps": float(i), "stages": {"total": {"median": 5.0}}}, 0.25)
    told = history.fields()
    assert len(told["fps"]) == told["most"] == 150 and told["step"] * told["most"] == 300
    assert told["fps"][-1] == 399 and told["fps"] == sorted(told["fps"]) and set(told["load"]) == {0.25}
    history.add({"fps": 0.0, "stages": {"total": {"median": 5.0}}}, 0.0)
    assert history.fields()["age"][-2:] == [5.0, 0.0]  # nothing was sent: nothing has an age
    assert History().fields()["fps"] == []


def test_another_device_is_told_where_to_go(serve):
    ((_, body),) = asked(serve, "/reach")
    told = json.loads(body)
    assert told["local"] is True and told["svg"] == "" and told["page"].endswith("/vr")
    open_ = ServerConfig(port=0, access=Access(host="0.0.0.0", token=TOKEN, insecure=True))
    answers = asked(serve, *["/reach"] * 20, config=open_, headers={"Authorization": f"Bearer {TOKEN}"})
    told = [json.loads(body) for _, body in answers]  # as many codes as are asked for
    assert all(one["svg"].startswith("<svg") and f"#token={TOKEN}" in one["svg"] for one in told)
    assert told[0]["local"] is False and "127.0.0.1" not in told[0]["page"] and TOKEN not in told[0]["page"]
    without = replace(PLAIN, access=Access(host="0.0.0.0", insecure=True))  # no token in the code, even an invented one
    ((status, body),) = asked(serve, "/reach", config=without, headers={"Authorization": "Bearer invented"})
    assert status == 200 and "invented" not in json.loads(body)["svg"]


async def test_who_asks_at_once_waits_for_one_drawing(serve):
    backend = FakeBackend(delay=0.05)
    async with serve(backend, config=PLAIN) as server, aiohttp.ClientSession() as http:
        url = f"http://127.0.0.1:{server.port}/thumbnails/{server.session()['avatars'][0]['name']}"
        answers = await asyncio.gather(*(http.get(url) for _ in range(6)))
        assert [(one.status, one.headers["Cache-Control"]) for one in answers] == [(200, "no-store")] * 6
    assert len(backend.drawn) == 1


async def test_one_that_is_deleted_while_it_waits_to_be_drawn_is_no_failure(serve):
    async with serve(FakeBackend(), config=PLAIN) as server, aiohttp.ClientSession() as http:
        name = server.session()["avatars"][0]["name"]
        address = f"http://127.0.0.1:{server.port}/thumbnails/{name}"
        async with server.feature(Previews)._drawing:  # another's is drawn
            waiting = asyncio.create_task(http.get(address))
            while not server.feature(Previews)._drawing._waiters:
                await asyncio.sleep(0.01)
            server.catalogue.remove(name)
        assert (await waiting).status == 204 and (await http.get(address)).status == 404


async def test_the_curves_go_on_after_numbers_that_could_not_be_taken(monkeypatch, caplog):
    monkeypatch.setattr("glsplat.extras.operations.status.STEP_S", 0.005)
    count = 0

    def stats():
        nonlocal count
        count += 1
        if count in (2, 3):
            raise RuntimeError("a fault")
        return {"fps": float(count), "stages": {}}

    history = History()
    history.start(stats)
    while count < 6:
        await asyncio.sleep(0.005)
    await history.stop()
    fps = history.fields()["fps"]
    assert fps[:3] == [1.0, 4.0, 5.0] and caplog.text.count("cannot be measured") == 1


def test_the_status_page_asks_once_for_everything(serve, monkeypatch):
    """Each picture is made smaller once; thumbnails have tags."""
    made = []
    small = previews._small
    monkeypatch.setattr(previews, "_small", lambda encoded: made.append(encoded) or small(encoded))

    async def main():
        async with serve() as server, aiohttp.ClientSession() as http:

            async def get(path, **headers):
                async with http.get(f"http://127.0.0.1:{server.port}{path}", headers=headers) as answer:
                    return answer.status, answer.headers.copy(), await answer.read()

            told = json.loads((await get("/status.json"))[2])
            assert set(told) == {"stats", "history", "avatars", "pictures"} and told["pictures"] == {}
            assert told["avatars"] == [{"name": "default", "title": "", "tag": ""}]
            async with Client(server.url) as client:
                await client.render(eyes())
                answers = await asyncio.gather(*(get("/status.json") for _ in range(5)), get("/pictures/1"))
                told = json.loads(answers[0][2])
                (picture,) = told["pictures"].values()
                assert b64decode(picture) == answers[-1][2] and simplejpeg.is_jpeg(b64decode(picture))
                assert list(told["pictures"]) == ["1"] and len(made) == 1
                await client.render(eyes())
                await get("/status.json")
                assert len(made) == 2
            while server.stats()["clients"]:
                await asyncio.sleep(0.01)
            assert json.loads((await get("/status.json"))[2])["pictures"] == {}
            status, headers, body = await get("/thumbnails/default")
            tag = json.loads((await get("/status.json"))[2])["avatars"][0]["tag"]
            assert status == 200 and body and tag and headers["ETag"] == f'"{tag}"'
            assert (await get("/thumbnails/default", **{"If-None-Match": f'"{tag}"'}))[::2] == (304, b"")
            assert (await get("/thumbnails/default", **{"If-None-Match": '"x"'}))[2] == body

    asyncio.run(main())
