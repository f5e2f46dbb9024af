"""Small pictures for the pages: one of each avatar, drawn once, and what clients were sent last."""

from __future__ import annotations

import asyncio
import json
from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
import simplejpeg
from aiohttp import web
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.extras.operations.history import History
from glsplat.net.backend import AvatarInfo
from glsplat.net.client_stream import ClientStream
from glsplat.net.codec.encoded import Encoded
from glsplat.net.feature import Feature, ServerView
from glsplat.net.rights import user_of

if TYPE_CHECKING:
    from glsplat.net.rights import User

__all__ = ["Previews", "flattened"]

SIDE = 192
"""Pixels of an avatar's picture."""

_SMALL = 240  # pixels that the larger side of a client's last picture has at most
_GROUND = np.array([205, 210, 216], np.float32)  # behind whom alpha cuts out, sRGB
_QUALITY = 85
_UNKEPT = {"Cache-Control": "no-store"}  # people's faces


class Previews(Feature):
    """GET /thumbnails/NAME, /pictures/NUMBER and /status.json, which has the curves of ``history``."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._kept: dict[tuple[str, str], tuple[bytes, str]] = {}  # with what changes with it
        self._small: dict[int, tuple[Encoded, asyncio.Task[bytes]]] = {}  # by client, of what it was sent last
        self._drawing = asyncio.Lock()

    async def start(self, server: ServerView) -> None:
        """Nothing is drawn before it is asked for."""
        self._server, self._offers = server, server.catalogue
        self._rights, self._clients = server.gate.rights, server.clients

    def routes(self) -> list[web.RouteDef]:
        """Return the three addresses."""
        return [
            web.get("/thumbnails/{name}", self._thumbnail),
            web.get("/pictures/{number:[0-9]{1,9}}", self._picture),
            web.get("/status.json", self._status),
        ]

    def client_stats(self, user: User | None, client: ClientStream) -> Mapping[str, Any]:
        """Return whether /pictures has something of the client for the account."""
        return {"picture": self.shows(user, client.number)}

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Forget what the client saw."""
        self._small.pop(client.number, None)

    def avatar_withdrawn(self, name: str) -> None:
        """Forget its picture."""
        self._kept = {key: data for key, data in self._kept.items() if key[0] != name}

    def shows(self, user: User | None, number: int) -> bool:
        """Whether /pictures has something of that client for the account."""
        client = self._clients.get(number)
        if client is None or client.newest is None:
            return False
        return self._rights.sees(user, "identity", client.account)

    def tag(self, name: str, user: User | None) -> str:
        """What changes with the picture of an avatar that ``user`` may drive; "" while it is not drawn."""
        return self._kept.get((name, self._rights.label(user, name)), (b"", ""))[1]

    async def small(self, number: int) -> bytes:
        """JPEG of what a client was sent last, which ``shows`` says there is: made once a picture, whoever asks."""
        encoded = self._clients[number].newest
        assert encoded is not None
        made = self._small.get(number)
        if made is None or made[0] is not encoded:
            self._small = {key: one for key, one in self._small.items() if key in self._clients}
            made = self._small[number] = encoded, asyncio.create_task(asyncio.to_thread(_small, encoded))
        return await asyncio.shield(made[1])

    async def _thumbnail(self, request: web.Request) -> web.Response:
        name, user = request.match_info["name"], user_of(request)
        if name not in self._rights.drivable(user, self._offers.names):
            return web.Response(status=404, text="there is no such avatar here\n")
        key = name, self._rights.label(user, name)
        found = self._kept.get(key)
        if found is None:
            try:
                found = await self._drawn(name, key)
            except GlsplatError as error:
                return web.Response(status=503, text=f"{error}\n", headers={"Retry-After": "5"})
        if found is None:  # it was there when it was asked for: no failure that a page's console tells
            return web.Response(status=204)
        data, tag = found
        headers = _UNKEPT | {"ETag": f'"{tag}"'}
        if any(known.value == tag for known in request.if_none_match or ()):
            return web.Response(status=304, headers=headers)
        return web.Response(body=data, content_type="image/jpeg", headers=headers)

    async def _drawn(self, name: str, key: tuple[str, str]) -> tuple[bytes, str] | None:
        """An avatar's picture and its tag, drawn once, whoever waits for it; None: it is gone."""
        async with self._drawing:
            found = self._kept.get(key)
            if found is None and name in self._offers.names:
                one = self._offers[name]
                encoded, _ = await self._server.internal_client.draw(one, _portrait(one), lambda: key[1])
                data = await asyncio.to_thread(_thumbnail_of, encoded)
                found = data, sha256(data).hexdigest()[:16]
                if name in self._offers.names and self._offers[name] is one:  # another may have the name meanwhile
                    self._kept[key] = found
        return found

    async def _picture(self, request: web.Request) -> web.Response:
        number = int(request.match_info["number"])
        if not self.shows(user_of(request), number):
            return web.Response(status=404, text="there is no such picture for you\n")
        return web.Response(body=await self.small(number), content_type="image/jpeg", headers=_UNKEPT)

    async def _status(self, request: web.Request) -> web.Response:
        """All that the status page shows, in one answer; of avatars what tells whether their pictures are new."""
        user = user_of(request)
        offer, stats = self._server.session(user), self._server.stats(user)
        shown = [one["id"] for one in stats["clients"] if one["picture"]]
        pictures = {
            number: b64encode(await self.small(number)).decode() for number in shown if self.shows(user, number)
        }
        avatars = [{name: one[name] for name in ("name", "title")} for one in offer["avatars"]]
        for one in avatars:
            one["tag"] = self.tag(one["name"], user)
        told = {"stats": stats, "history": self._history.fields(), "avatars": avatars, "pictures": pictures}
        return web.json_response(told, headers=_UNKEPT)


def flattened(encoded: Encoded) -> NDArray[np.uint8]:
    """The first picture [H, W, 3], on a light ground where its alpha was sent with it."""
    colour = simplejpeg.decode_jpeg(encoded.pictures[0]).astype(np.float32)
    if encoded.alphas is not None:
        alpha = simplejpeg.decode_jpeg(encoded.alphas[0], "GRAY").astype(np.float32) / 255
        colour = colour * alpha + _GROUND * (1 - alpha)
    flat: NDArray[np.uint8] = np.clip(np.round(colour), 0, 255).astype(np.uint8)
    return flat


def _thumbnail_of(encoded: Encoded) -> bytes:
    data: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(flattened(encoded)), _QUALITY, "RGB")
    return data


def _small(encoded: Encoded) -> bytes:
    """Of a picture that was cropped there may be nothing."""
    image = flattened(encoded)
    step = -(-max(image.shape[:2]) // _SMALL)
    height, width = (side // step * step for side in image.shape[:2])
    if height and width and step > 1:  # means of whole blocks
        blocks = image[:height, :width].reshape(height // step, step, width // step, step, 3)
        image = blocks.mean((1, 3)).astype(np.uint8)
    data: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(image), _QUALITY, "RGB")
    return data


def _portrait(one: AvatarInfo) -> dict[str, object]:
    """Head and shoulders, from a little to the side of where it looks (+z)."""
    height = one.height or 1.7
    middle, away, across = 0.9 * height, 1.6, 0.36 * height  # metres
    focal = SIDE * away / across
    viewmat = [1, 0, 0, 0, 0, -1, 0, middle, 0, 0, -1, away, 0, 0, 0, 1]  # OpenCV axes, row by row
    request: dict[str, object] = {
        "eyes": [{"viewmat": viewmat, "K": [focal, focal, SIDE / 2, SIDE / 2]}],
        "size": [SIDE, SIDE],
        "quality": _QUALITY,
        "alpha": "straight",
    }
    return request if one.solver is None else request | {"pose": _standing()}


@cache
def _standing() -> dict[str, object]:
    """Arms down, of the rig that motions are made for."""
    motion = json.loads((resources.files("glsplat.data") / "idle.json").read_text(encoding="utf-8"))
    pose: dict[str, object] = motion["frames"][0]
    return pose
