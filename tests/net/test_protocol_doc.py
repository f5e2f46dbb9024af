"""docs/protocol.md says what the code does: the example client runs, the tables hold the code's numbers."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path

import aiohttp
import numpy as np
import simplejpeg

from apps.serve.command import HELP
from glsplat.net import conversation, messages, options, render_loop, server, session
from glsplat.net.guard import reading
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import Decoder
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from glsplat.net.uploads import form
from glsplat.net.uploads.job import VIEWS, Job, UploadConfig
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS, POSE_KEYS
from glsplat.tracking.sample import HAND_JOINTS
from tests.net.wire import EYE, HANG

TEXT = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")
WORDS = " ".join(TEXT.split())  # wherever its lines end

DEPLOYING = Path(__file__).parents[2] / "docs" / "deploying.md"


def test_the_request_of_the_page_is_a_request():
    block = re.search(r"```json\n(\{\"v\": 1, \"frame_id\": 7.*?)```", TEXT, re.S).group(1)
    request = Decoder().decode(block.replace('[[0,0,0], "21 in all"]', json.dumps(np.zeros((21, 3)).tolist())))
    assert request.frame_id == 7 and len(request.cameras) == 2


def test_the_example_client_runs(serve, tmp_path, monkeypatch):
    """With aiohttp under the three calls it makes of the websockets package."""
    code = re.search(r"```python\n(.*?)```", TEXT, re.S).group(1)

    class Connection:
        def __init__(self, url):
            self.url = url

        async def __aenter__(self):
            self.http = aiohttp.ClientSession()
            self.ws = await self.http.ws_connect(self.url)
            self.send = self.ws.send_str
            return self

        async def recv(self):
            return (await self.ws.receive(timeout=HANG)).data

        async def __aexit__(self, *_):
            await self.ws.close()
            await self.http.close()

    class FakeWebsockets:
        @staticmethod
        def connect(url, compression, max_size):
            return Connection(url)

    async def main():
        async with serve() as running:
            names = {"websockets": FakeWebsockets, "__name__": "example"}
            source = code.replace("struct, websockets", "struct")
            source = source.replace("ws://127.0.0.1:8000/ws", running.url).replace("asyncio.run(main())", "")
            exec(compile(source, "protocol.md", "exec"), names)
            await names["main"]()

    monkeypatch.chdir(tmp_path)
    asyncio.run(main())
    pictures = sorted(tmp_path.glob("*.jpg"))
    assert len(pictures) == 20
    assert simplejpeg.decode_jpeg(pictures[0].read_bytes()).shape == (512, 512, 3)


def test_what_a_server_offers_has_the_keys_of_the_page(serve):
    """Those of /session, by the example and by the table."""
    block = json.loads(re.search(r"`/session`:\n\n```json\n(.*?)```", TEXT, re.S).group(1))

    async def main():
        async with serve() as running, aiohttp.ClientSession() as http:
            answer = await http.get(running.url.replace("ws:", "http:").replace("/ws", "/session"))
            return await answer.json()

    offer = asyncio.run(main())
    assert set(block) == set(offer) and set(block["avatars"][0]) == set(offer["avatars"][0])
    table = TEXT.split("`/session`:")[1].split("## 9.")[0].split("| key | |")[1]
    explained = {*offer, *offer["avatars"][0]} - {"v", "name", "driver"}
    assert not [key for key in explained if f"`{key}`" not in table]
    assert block["motions"] == offer["motions"]


def test_every_error_code_is_in_the_table():
    sources = [Path(module.__file__).read_text() for module in (messages, session, server, render_loop)]
    codes = set(re.findall(r'ProtocolError\(\s*f?[^()]*?,\s*"([a-z_]+)"', "\n".join(sources), re.S))
    codes |= set(re.findall(r'error_text\("([a-z_]+)"', "\n".join(sources)))
    codes |= set(re.findall(r'frame\.error = \("([a-z_]+)"', "\n".join(sources))) | {"bad_request", "encode"}
    assert len(codes) >= 10
    table = TEXT.split("## 6. Errors")[1].split("## 7.")[0]
    missing = {code for code in codes if f"`{code}`" not in table}
    assert not missing


def test_the_numbers_of_the_limits():
    """The page and the help of the command hold the defaults; deploying.md: tests/net/guard/test_limits_doc.py."""
    limits, mib = Limits(), 2**20
    for phrase in (
        f"{limits.frames:g} frames a second ({limits.frames_burst:g} at once), {limits.control:g} control frames",
        f"({limits.control_burst:g}) and {limits.bytes / mib:g} MiB ({limits.bytes_burst / mib:g} MiB)",
        f"{limits.work:g} s of each second to read",
        f"{limits.samples:g} samples a second of a client ({limits.samples_burst:g} at once)",
        f"429 for {limits.hold_off:g} s",
        f"those of up to {reading._SHORT} characters",
    ):
        assert phrase in WORDS, phrase
    for phrase in (f"{limits.frames:g} frames", f"{limits.control:g} control", f"make {limits.visits:g} connections"):
        assert phrase in HELP, phrase


def test_the_numbers_of_photographs():
    """Both pages hold the defaults."""
    deploying = " ".join(DEPLOYING.read_text(encoding="utf-8").split())
    config, limits = UploadConfig(folder=Path(), make=lambda order, progress: None), Limits()
    for phrase in (
        f"at less than {config.rate / 1000:g} kB a second, of which {config.stall:g} s are forgiven, or in more than "
        f"{config.receive:g} s",
        f"more than {config.picture_bytes / 1e6:g} MB a picture or {config.body_bytes / 1e6:g} MB in all",
        f"more than {limits.uploads_burst:g} requests to make an avatar from one address; one more every "
        f"{1 / limits.uploads:g} s",
        f"the folder holds {config.most_files} avatars or {config.folder_bytes / 1e9:g} GB",
        f"in {config.seconds:g} s at most",
    ):
        assert phrase in WORDS, phrase
    assert config.waiting == 2 and "three avatars are being made, wait, or are being sent" in TEXT
    assert config.per_address == 2 and "or two from this address" in TEXT
    assert config.senders == 1 and "other pictures from it are on their way" in TEXT
    assert limits.uploads_unfinished == 1 / 4 and "counts as a quarter of one" in TEXT
    for phrase in (
        f"`nice` {config.nice}, which holds",
        f"ended after {config.seconds:g} s",
        f"{config.picture_bytes / 1e6:g} MB a picture and {config.body_bytes / 1e6:g} MB in all",
        f"{config.most_files} avatars and {config.folder_bytes / 1e9:g} GB in DIR",
        f"keeps up {config.rate / 1000:g} kB a second, may be {config.stall:g} s behind that at any time, and has "
        f"{config.receive:g} s in all",
        f"a second, of a sender | {config.rate:g} at least | {config.stall:g} s behind | 408",
        f"pictures of an avatar | {config.receive:g} | | 408",
        f"of one address | {config.senders} | | 503",
    ):
        assert phrase in deploying, phrase


def test_the_object_of_a_job_is_that_of_the_page():
    job = Job("photo-k3v9xm2p", "")
    block = json.loads(re.search(r"```json\n(\{\"name\": \"photo-.*?)```", TEXT, re.S).group(1))
    assert set(block) == set(job.status(0))
    section = TEXT.split("## 9. Avatars")[1].split("## 10.")[0]
    assert not [name for name in (*job.status(0), *VIEWS, *form._FIELDS) if f"`{name}`" not in section]


def test_the_joint_orders_of_the_page():
    """Row by row: number, name, parent; and which pose key holds which."""
    cells = re.findall(r"(?<=\| )(\d+) \| ([a-z0-9_]+) \| (-?\d+)(?= \|)", TEXT)
    joints = {int(number): (name, int(parent)) for number, name, parent in cells}
    assert joints == dict(enumerate(zip(JOINT_NAMES, PARENTS.tolist(), strict=True)))
    hand = dict(re.findall(r"(?<=\| )(\d+) \| ([a-z]+(?:-[a-z]+)*)(?= \|)", TEXT.split("WebXR's hand joints (")[1]))
    assert {int(number): name for number, name in hand.items()} == dict(enumerate(HAND_JOINTS))
    for key, first, last in (("body_pose", 1, 21), ("lhand_pose", 25, 39), ("rhand_pose", 40, 54)):
        assert re.search(rf"`{key}`\s(is\s)?{first} to\s{last}", TEXT) and POSE_KEYS[key] == slice(first, last + 1)


def test_translations_are_in_the_frame_that_the_page_says():
    """A joint whose rest frame is turned, under a parent that is turned and posed: only the parent's axes fit."""
    assert "the **parent's** frame as posed" in WORDS
    rest = np.tile(np.eye(4), (2, 1, 1))
    rest[0, :3, :3] = rotation_matrices([0.3, -0.5, 0.2])
    rest[1, :3, :3] = rotation_matrices([1.0, 0.4, -0.7])
    rest[1, :3, 3] = 0.1, 0.5, 0.0
    skeleton = Skeleton(("root", "tip"), np.array([-1, 0]), rest)
    message = {"v": 1, "frame_id": 1, "eyes": [EYE], "size": [64, 64]}
    posed = {"joints": {"root": [0, 0, 1.2]}}
    moved = posed | {"translations": {"tip": [0.2, -0.1, 0.05]}}
    frames = []
    for pose in (posed, moved):
        given = Decoder(skeleton=skeleton).decode(json.dumps(message | {"pose": pose})).pose
        frames.append(skeleton.forward(given.rotations, given.trans, given.translations))
    expected = frames[0][0, :3, :3] @ [0.2, -0.1, 0.05]
    assert np.allclose(frames[1][1, :3, 3] - frames[0][1, :3, 3], expected)


def test_the_numbers_of_the_page():
    config, limits = ServerConfig(), SessionConfig()
    for phrase in (
        f"{messages.MAX_BYTES // 1000} {messages.MAX_BYTES % 1000:03d} bytes",
        f"pings every {config.heartbeat:g} s",
        f"within {config.write_timeout:g} s",
        f"{limits.rate:g} messages a second are read, {limits.burst} more",
        f"within {limits.handshake:g} s of connecting, or no message for {limits.idle:g} s",
        f"More than {limits.errors} of them at once",
        f"within {conversation._FAREWELL:g} s is cut off",
        "`window=1..8`",
        "`height=0.5..2.8`",
        "`span=0.3..2.5`",
        f"port {config.port}",
    ):
        assert phrase in WORDS, phrase
    assert options.MAX_WINDOW == 8
