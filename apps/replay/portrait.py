"""Portraits of a streamed person: whole body, waist up and face, lit, on a light background."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, stereo_cameras
from glsplat.errors import GlsplatError
from glsplat.light import Light
from glsplat.net.client import Client
from glsplat.net.reply import Reply
from glsplat.rotations import FLIP_YZ

from ..output import Image, stack
from .streaming import Drive, Driven, Later, observer, stream

_FPS = 30.0
_FOV_DEG = 30.0
_IPD_M = 0.063
_EXPOSURE = 1.8  # of the studio's light, for dark skin, too
_TOP, _BOTTOM = 235, 190  # grey behind the person

_GAP_PX = 4


@dataclass(frozen=True, slots=True)
class _Framing:
    """Pictures of ``size`` pixels from ``start`` on, for ``duration`` seconds."""

    size: tuple[int, int]
    start: float
    duration: float
    low: float  # lower and upper edge, as shares of the person's height
    high: float

    def cameras(self, root: NDArray[np.float64], height: float) -> tuple[Camera, Camera]:
        """Return the eyes of somebody who stands in front of the person at ``root`` [3]; metres."""
        distance = (self.high - self.low) * height / 2 / np.tan(np.radians(_FOV_DEG) / 2)
        target = np.array([root[0], (self.low + self.high) / 2 * height, root[2]])
        head = np.linalg.inv(FLIP_YZ @ look_at(target + (0.0, 0.0, distance), target))
        return stereo_cameras(head, _IPD_M, _FOV_DEG, size=self.size)


# the recording begins with a person who looks ahead, then waves, then turns
_FACE = _Framing((768, 1152), 0.0, 0.7, 0.80, 1.04)
_WHOLE = _Framing((384, 640), 0.7, 2.0, -0.04, 1.12)
_WAIST_UP = _Framing((384, 508), 2.7, 2.0, 0.52, 1.10)


async def portrait_sheet(client: Client, drive: Drive) -> Image:
    """Stream for some seconds and return a contact sheet: two moments in both eyes of each framing, and a face.

    Raises GlsplatError if no picture came.
    """
    start = drive.at(0.0)
    reply = await client.render(observer(0.0, start.root, (64, 64)), pose=start.pose, tracking=start.tracking, box=True)
    if reply.box is None:
        raise GlsplatError("the server drew nobody; give --avatar a person")
    height = float(reply.box[1, 1])
    face, whole, waist = [await _pictures(client, drive, one, height) for one in (_FACE, _WHOLE, _WAIST_UP)]
    rows = [[eye for pair in (pairs[len(pairs) // 2], pairs[-1]) for eye in _eyes(pair)] for pairs in (whole, waist)]
    left = [stack([row], _GAP_PX) for row in rows]
    line = np.full((_GAP_PX, left[0].shape[1], 3), left[0][0, rows[0][0].shape[1]], np.uint8)
    return np.concatenate([np.concatenate([left[0], line, left[1]]), _eyes(face[-1])[0]], axis=1)


async def _pictures(client: Client, drive: Drive, framing: _Framing, height: float) -> list[Reply]:
    def see(_seconds: float, driven: Driven, _size: tuple[int, int]) -> tuple[Camera, Camera]:
        return framing.cameras(driven.root, height)

    studio = Light.preset("studio")
    light = replace(studio, ambient=_EXPOSURE * studio.ambient, sun_colour=_EXPOSURE * studio.sun_colour)
    later, frames = Later(drive, framing.start), round(framing.duration * _FPS)
    run = await stream(client, later, frames=frames, fps=_FPS, keep=True, see=see, alpha="straight", light=light)
    if not run.kept:
        raise GlsplatError("no picture came; run `glsplat serve --verbose` and `glsplat replay` to see why")
    return [reply for _, reply in run.kept]


def _eyes(reply: Reply) -> list[Image]:
    """Return both eyes' pictures on the background."""
    pictures = []
    for eye in reply.rgba():
        behind = np.linspace(_TOP, _BOTTOM, eye.shape[0])[:, None, None]
        pictures.append(np.rint(eye[..., :3] + (1 - eye[..., 3:] / 255) * behind).clip(0, 255).astype(np.uint8))
    return pictures
