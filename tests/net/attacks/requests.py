"""Requests that are legal, or nearly, and expensive."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np

from glsplat.data import default_avatar

__all__ = ["collapsed", "eye", "hands", "legacy", "pair", "request", "stale", "tracking"]


def eye(width: int, height: int, focal: float = 1.2, z: float = 2.2, x: float = 0.0, y: float = 1.0) -> dict[str, Any]:
    """A camera at (x, y, z) metres that looks along -z; ``focal`` in image heights."""
    viewmat = [1, 0, 0, -x, 0, -1, 0, y, 0, 0, -1, z, 0, 0, 0, 1]
    return {"viewmat": viewmat, "K": [focal * height, focal * height, width / 2, height / 2]}


def pair(width: int, height: int, **at: float) -> list[dict[str, Any]]:
    """Both eyes."""
    return [eye(width, height, x=side * 0.03, **at) for side in (-1, 1)]


def request(frame_id: int, size: tuple[int, int] = (256, 256), **more: Any) -> bytes:
    """A native request; ``eyes`` default to both, 2.2 m in front of the avatar. ``None`` leaves a field out."""
    fields = {"v": 1, "frame_id": frame_id, "ack": 0, "size": size, "eyes": pair(*size)} | more
    return json.dumps({key: value for key, value in fields.items() if value is not None}).encode()


@cache
def collapsed() -> dict[str, Any]:
    """A pose whose bone translations pull every joint into the pelvis: the whole body lies in one heap."""
    skeleton = default_avatar().skeleton
    heads = skeleton.rest[:, :3, 3]
    offsets = [heads[i] - heads[p] if p >= 0 else np.zeros(3) for i, p in enumerate(skeleton.parents)]
    return {"joints": {}, "translations": {n: (-o).tolist() for n, o in zip(skeleton.names, offsets, strict=True)}}


def heap() -> tuple[float, float]:
    """Height and depth (metres) of that heap."""
    skeleton = default_avatar().skeleton
    place = skeleton.rest[0, :3, 3]
    return float(place[1]), float(place[2])


def hands(spread: float) -> list[list[float]]:
    """25 joints of a hand, of 7 numbers each."""
    return [[0.3 + 0.01 * i, 1.0 + spread * (i % 5), -0.3, 0.0, 0.0, 0.0, 1.0] for i in range(25)]


def tracking(i: int) -> dict[str, Any]:
    """A sample with full hands that lies somewhere else each time."""
    far = float(i % 7) * 0.2
    return {
        "head": [far, 1.6, 0.0, 0, 0, 0, 1],
        "left": [far - 0.4, 1.0 + far, -0.3, 0, 0, 0, 1],
        "right": [far + 0.4, 1.5 - far, -0.3, 0, 0, 0, 1],
        "left_joints": hands(0.02 + far / 10),
        "right_joints": hands(0.02),
    }


def legacy(i: int, side: str = "left") -> bytes:
    """The oldest form: one eye a message, each with a mailbox of its own."""
    head = {"pos_x": 0, "pos_y": 1.6, "pos_z": 2, "rot_x": 0, "rot_y": 1, "rot_z": 0, "rot_w": 0, "eye": side}
    return json.dumps({"camera": head, "smplx": {"root_pose": [0, i % 6, 0]}}).encode()


@cache
def stale(nbytes: int = 63_000, filling: str = "0,") -> bytes:
    """A request of that many bytes whose frame_id is old: all of it is parsed and then ignored."""
    plain = request(1)[:-1] + b', "more": ['
    body = (filling.encode() * (nbytes // len(filling)))[: nbytes - len(plain) - 4].rpartition(b",")[0]
    return plain + body + b"]}"
