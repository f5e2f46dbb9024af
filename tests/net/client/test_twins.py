"""Vectors for a client (docs/write-a-client.md): Python's client and the page's give the same answers."""

from __future__ import annotations

import base64
import json
from math import sqrt
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import ProtocolError
from glsplat.net.client import Client
from glsplat.net.codec.encoded import DepthGrid, grid_of
from glsplat.net.flow import FlowControl, server_error
from glsplat.net.messages import eye_fields
from glsplat.net.reply import pack_reply, parse_reply
from tests.twins import ROOT, Twin, both_sides, text_of

VECTORS = ROOT / "docs" / "examples" / "vectors"


def address(url: str, options: dict[str, Any], resume: str | None = None) -> dict[str, Any]:
    """Return path and query of the address to open; ``resume`` is the token that a reply of the last connection had."""
    at = options.get("at")
    given = options | ({"at": tuple(map(float, at.split(",")))} if at else {}) | {"mirror": "mirror" in options}
    client = Client(url, **given)
    client._resume = resume or ""
    parts = urlsplit(client._address())
    return {"path": parts.path, "query": dict(parse_qsl(parts.query))}


def addresses() -> list[dict[str, Any]]:
    everything = {"avatar": "photo-k3v9xm2p", "window": 3, "mirror": 1, "height": 1.74, "span": 1.4}
    someone = {"room": "lab", "name": "Jürgen O'Neil-B.", "at": "1.5,-2,90"}
    return [
        {"url": "ws://127.0.0.1:8000/ws", "options": {}},
        {"url": "wss://lab.example/people/ws", "options": everything},
        {"url": "ws://127.0.0.1:8000/ws", "options": someone},
        {"url": "ws://127.0.0.1:8000/ws", "options": {"room": "lab"}, "resume": "f3Wn0mQ0t1c_Zr-8y2KpXA"},
    ]


def eye(pose: list[float], projection: list[float], size: list[int]) -> dict[str, Any]:
    """Return an entry of ``eyes`` for an eye's pose (x y z, quaternion x y z w) and projection matrix, by columns."""
    width, height = size
    fx, fy = projection[0] * width / 2, projection[5] * height / 2
    k = [[fx, 0, (1 - projection[8]) * width / 2], [0, fy, (1 + projection[9]) * height / 2], [0, 0, 1]]
    fields = eye_fields(stereo_cameras(head_matrix(pose[:3], pose[3:]), ipd=0, K=k, size=(width, height))[0])
    return {key: fields[key] for key in ("viewmat", "K")}


def eyes() -> list[dict[str, Any]]:
    half = sqrt(0.5)
    symmetric = [1.2, 0, 0, 0, 0, 1.5, 0, 0, 0, 0, -1.002, -1, 0, 0, -0.2, 0]
    off_centre = [0.9, 0, 0, 0, 0, 0.95, 0, 0, -0.18, 0.07, -1.002, -1, 0, 0, -0.2, 0]
    poses = [(0, 1.6, 0, 0, 0, 0, 1), (0, 1.6, 2, 0, half, 0, half), (0.4, 1.5, -0.3, half, 0, 0, half)]
    poses += [(-0.2, 1.7, 0.1, 0.1, -0.3, 0.2, sqrt(0.86))]
    return [
        {"pose": list(pose), "projection": matrix, "size": size}
        for pose in poses
        for matrix, size in ((symmetric, [512, 512]), (off_centre, [1024, 960]))
    ]


def reply(data: str) -> dict[str, Any] | None:
    """Return the parts of a reply, bytes in base64 and depth as inverse metres; None if it must be refused."""
    try:
        found = parse_reply(base64.b64decode(data))
    except ProtocolError:
        return None
    return {
        "id": found.frame_id,
        "eyes": [[eye, text_of(one), text_of(found.alphas.get(eye, b""))] for eye, one in found.pictures.items()],
        "info": found.info,
        "depth": [[grid.columns, grid.rows, *(1 / grid.metres()).ravel().tolist()] for grid in found.depth],
    }


def replies() -> list[dict[str, str]]:
    rng = np.random.default_rng(8)
    left, right, alpha = (b"\xff\xd8" + rng.bytes(size) for size in (20, 31, 9))
    grids = tuple(grid_of(rng.uniform(0.3, 2, (3, 4))) for _ in range(2))
    deep = {"size": [8, 8], "depth": DepthGrid.fields(grids)}
    later = {"size": [8, 8], "crop": None, "colours": {"space": [None, True, -1.5e-3]}, "note": 'a "\\\t/ü😀'}
    both = pack_reply(7, [0, 1], [left, right], {"size": [8, 8], "driver": "Ä"})
    return [
        {"data": text_of(one)}
        for one in (
            both,
            pack_reply(2**32 - 1, [1], [right], {}, [alpha]),
            pack_reply(9, [0, 1], [left, right], deep, [alpha, alpha], [grid.data for grid in grids]),
            pack_reply(10, [0, 1], [left, right], later) + b"a later version's bytes",
            *(both[:end] for end in (8, 12, 30, len(both) - 1)),
            both[:2] + b"\x02\x00" + both[4:],
            b"VX" + both[2:],
        )
    ]


def conversation(steps: list[dict[str, Any]]) -> list[Any]:
    """Return what a client does at each step: the request it sends; what it shows of a reply and sends at once, ..."""
    flow, out = FlowControl(), []
    for step in steps:
        now, found = step["at"] / 1e3, None
        if step["do"] == "open":
            flow = FlowControl()
        elif step["do"] == "request":
            number = flow.newest + 1
            found = {"v": 1, "frame_id": number, **flow.acknowledging(now)}
            flow.request(number, now)
        elif step["do"] == "binary":
            found = _binary(flow, base64.b64decode(step["data"]), now)
        elif step["do"] == "text":
            error = server_error(step["data"])
            flow.failed(error)
            found = {"code": error.code, "message": str(error), "frame_id": error.frame_id}
        out.append(found)
    return out


def _binary(flow: FlowControl, data: bytes, now: float) -> dict[str, Any]:
    try:
        arrived = flow.arrived(parse_reply(data).frame_id, now).frame_id
    except ProtocolError:
        return {"shown": False, "sent": None}
    blocked = arrived is not None and flow.take(arrived)
    return {"shown": arrived, "sent": json.loads(flow.acknowledgement(now)) if blocked else None}


def conversations() -> list[dict[str, Any]]:
    def picture(frame_id: int, **info: Any) -> bytes:
        return pack_reply(frame_id, [0], [b"\xff\xd8\xff\xd9"], {"size": [8, 8], **info})

    def error(code: str, **more: Any) -> str:
        return json.dumps({"error": {"code": code, "message": f"because of {code}", **more}, "v": 2})

    said = [
        (0, "open", None),
        (0, "request", None),
        (14, "request", None),
        (30, "binary", picture(1)),  # 2 waits for the window
        (40, "request", None),
        (50, "binary", picture(3, colours={"space": "later"})),  # 2 will never be answered
        (55, "binary", picture(2)),  # late
        (60, "request", None),
        (61, "binary", picture(4)[:-1]),
        (62, "binary", b"VR\x02\x00" + picture(4)[4:]),
        (65, "text", error("bad_pose", frame_id=4, hint="later")),
        (70, "text", error("rate")),
        (75, "request", None),
        (80, "closed", None),
        (600, "open", None),
        (600, "request", None),
        (620, "binary", picture(1)),
        (640, "binary", picture(9)),  # never requested
        (650, "request", None),
    ]
    texts = [text_of(data) if isinstance(data, bytes) else data for _, _, data in said]
    return [{"steps": [{"at": at, "do": what, "data": text} for (at, what, _), text in zip(said, texts, strict=True)]}]


TWINS = {
    "address": Twin(address, addresses),
    "eye": Twin(eye, eyes, 1e-5),  # single precision is enough
    "reply": Twin(reply, replies, 1e-6),
    "conversation": Twin(conversation, conversations, 1e-6),
}

test_python_gives_the_vectors, test_the_page_gives_the_vectors = both_sides(Path(__file__).parent, TWINS, VECTORS)
