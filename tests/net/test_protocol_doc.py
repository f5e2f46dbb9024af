"""docs/protocol.md says what the code does: the example client runs, the tables hold the code's numbers."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import aiohttp
import numpy as np
import simplejpeg

from glsplat.extras.uploads.job import Job
from glsplat.net.messages import Decoder
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS, POSE_KEYS
from tests.net.wire import HANG

DOCS = Path(__file__).parents[2] / "docs"
TEXT = (DOCS / "protocol.md").read_text(encoding="utf-8")
EXTENSIONS = (DOCS / "protocol-extensions.md").read_text(encoding="utf-8")


def test_the_request_of_the_page_is_a_request():
    block = re.search(r"```json\n(\{\"v\": 1, \"frame_id\": 7.*?)```", TEXT, re.S).group(1)
    request = Decoder().decode(block.replace('[[0,0,0], "21 in all"]', json.dumps(np.zeros((21, 3)).tolist())))
    assert request.frame_id == 7 and len(request.cameras) == 2


class Connection:
    """The three calls that the example makes of the websockets package, with aiohttp under them."""

    def __init__(self, url, compression, max_size):
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


async def test_the_example_client_runs(serve, tmp_path, monkeypatch):
    code = re.search(r"```python\n(.*?)```", TEXT, re.S).group(1)
    monkeypatch.chdir(tmp_path)
    async with serve() as running:
        names = {"websockets": SimpleNamespace(connect=Connection), "__name__": "example"}
        source = code.replace("struct, websockets", "struct").replace("asyncio.run(main())", "")
        exec(compile(source.replace("ws://127.0.0.1:8000/ws", running.url), "protocol.md", "exec"), names)
        await names["main"]()
    pictures = sorted(tmp_path.glob("*.jpg"))
    assert len(pictures) == 20
    assert simplejpeg.decode_jpeg(pictures[0].read_bytes()).shape == (512, 512, 3)


async def test_what_a_server_offers_has_the_keys_of_the_page(serve):
    block = json.loads(re.search(r"`/session`:\n\n```json\n(.*?)```", TEXT, re.S).group(1))
    async with serve() as running, aiohttp.ClientSession() as http:
        async with http.get(running.url.replace("ws:", "http:").replace("/ws", "/session")) as answer:
            offer = await answer.json()
    assert set(block) == set(offer) and set(block["avatars"][0]) == set(offer["avatars"][0])


def test_the_object_of_a_job_is_that_of_the_page():
    block = json.loads(re.search(r"```json\n(\{\"name\": \"photo-.*?)```", EXTENSIONS, re.S).group(1))
    assert set(block) == set(Job("photo-k3v9xm2p", "").status(0))


def test_the_joint_orders_of_the_page():
    """Number, name and parent, and which pose key holds which."""
    table = TEXT.partition("# joint")[2].partition("```")[0]
    cells = re.findall(r"(\d+) ([a-z0-9_]+) +(-?\d+)", table)
    joints = {int(number): (name, int(parent)) for number, name, parent in cells}
    assert joints == dict(enumerate(zip(JOINT_NAMES, PARENTS.tolist(), strict=True)))
    for key, first, last in (("body_pose", 1, 21), ("lhand_pose", 25, 39), ("rhand_pose", 40, 54)):
        assert re.search(rf"`{key}`\s(is\s)?{first} to\s{last}", TEXT) and POSE_KEYS[key] == slice(first, last + 1)
