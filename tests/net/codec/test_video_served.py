"""Video over real sockets: for clients that ask for it, in order."""

from __future__ import annotations

import asyncio
import json
import threading

import aiohttp
import pytest

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.far_links.video import VideoStream
from glsplat.net.messages import Decoder
from glsplat.net.reply import parse_reply
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from glsplat.net.worker.encoding import MAX_VIDEO_PICTURES
from tests.net.wire import EYE, HANG, until

av = pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")

WATCHES = ServerConfig(port=0, video=True)


def asking(number, **fields):
    return json.dumps({"v": 1, "frame_id": number, "eyes": [EYE, EYE], "size": [64, 64], **fields})


def test_the_video_field_is_read():
    video = Decoder().decode(asking(1, video={"codecs": ["av1", "vp9"], "key": True})).options.video
    assert video.codecs == ("av1", "vp9") and video.key
    assert Decoder().decode(asking(1)).options.video is None
    assert not Decoder().decode(asking(1, video={"codecs": ["h264"]})).options.video.key


@pytest.mark.parametrize(
    "video",
    [
        *({"codecs": codecs} for codecs in ([], ["x"] * 9, ["x" * 33], [""], [1], "vp9", None)),
        *({}, [], True, "vp9", {"codecs": ["vp9"], "key": 1}),
    ],
)
def test_what_is_no_video_field_is_refused(video):
    with pytest.raises(ProtocolError) as caught:
        Decoder().decode(asking(1, video=video))
    assert caught.value.code in ("bad_request", "bad_field")
    with pytest.raises(ProtocolError, match="video"):
        Decoder().decode('{"v": 1, "ack": 3, "video": {"codecs": ["vp9"]}}')


async def replies(server, count, **fields):
    """One after the other."""
    out = []
    async with aiohttp.ClientSession() as http, http.ws_connect(server.url, max_msg_size=0) as ws:
        for number in range(1, count + 1):
            await ws.send_str(asking(number, ack=number - 1, **fields))
            out.append(parse_reply((await ws.receive(timeout=HANG)).data))
    return out


async def test_others_get_the_same_bytes_as_ever(serve, fake_backend):
    async with serve(fake_backend()) as server:
        found = [await replies(server, 4), await replies(server, 4, video={"codecs": ["vp9"]})]
    async with serve(fake_backend(), WATCHES) as server:
        assert list(server.session()["video"]) == ["vp9", "h264"]
        found = [*found, await replies(server, 4), await replies(server, 4, video={"codecs": ["av9"]})]
    assert all("video" not in reply.info for some in found for reply in some)
    pictures = [[reply.pictures for reply in some] for some in found]
    assert pictures[0] == pictures[1] == pictures[2] == pictures[3]


async def test_what_was_sent_last_is_no_old_jpeg(serve, fake_backend):
    """The status page shows no JPEG of a client that has gone over to video."""
    async with serve(fake_backend(), WATCHES) as server, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url, max_msg_size=0) as ws:
            out = []
            for number, more in ((1, {}), (2, {"video": {"codecs": ["vp9"]}})):
                await ws.send_str(asking(number, ack=number - 1, **more))
                await ws.receive(timeout=HANG)
                out += [one.newest is not None for one in server.clients.values()]
            assert out == [True, False]


async def test_a_picture_that_fails_leaves_no_gap(serve, fake_backend):
    backend = fake_backend(fail=lambda job: RuntimeError("no") if job.frame_id == 3 else None)
    async with serve(backend, WATCHES) as server, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url, max_msg_size=0) as ws:
            out = []
            for number in range(1, 6):
                await ws.send_str(asking(number, ack=out[-1].frame_id if out else 0, video={"codecs": ["vp9"]}))
                message = await ws.receive(timeout=HANG)
                if message.type == aiohttp.WSMsgType.BINARY:
                    out.append(parse_reply(message.data))
    assert [reply.frame_id for reply in out] == [1, 2, 4, 5]
    assert [reply.info["video"]["number"] for reply in out] == [1, 2, 3, 4]


async def test_nobody_waits_for_the_video_of_others(serve, fake_backend, monkeypatch):
    """While coding hangs, JPEGs of others come as ever."""
    gate, coded = threading.Event(), []
    encode = VideoStream.encode

    def slow(self, *how):
        coded.append(how)
        assert gate.wait(HANG)
        return encode(self, *how)

    monkeypatch.setattr(VideoStream, "encode", slow)
    backend = fake_backend()
    async with serve(backend, WATCHES) as server, aiohttp.ClientSession() as http:
        sockets = [await http.ws_connect(server.url + "?window=8", max_msg_size=0) for _ in range(4)]
        for number in range(1, 9):  # without an ack, as many as the window holds
            for ws in sockets:
                await ws.send_str(asking(number, video={"codecs": ["vp9"]}))
            await asyncio.sleep(0.03)
        await until(lambda: coded)
        begun = len(backend.drawn)
        plain = await replies(server, 5)
        videos = [job for job in backend.drawn if job.options.video]
        gate.set()
        late = [parse_reply((await ws.receive(timeout=HANG)).data) for ws in sockets]  # nobody is forgotten
        for ws in sockets:
            await ws.close()
    assert len(plain) == 5 and all("video" not in reply.info for reply in plain)
    assert 0 < begun <= len(videos) <= MAX_VIDEO_PICTURES
    assert all("video" in reply.info for reply in late)


def test_a_server_that_cannot_does_not_begin(monkeypatch, fake_backend):
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    with pytest.raises(GlsplatError, match=r"pip install 'glsplat\[video\]'"):
        server_of(fake_backend(), WATCHES)
