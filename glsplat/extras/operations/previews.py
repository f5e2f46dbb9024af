"""Small pictures for the pages: a portrait of each avatar, and the last picture of each client."""

from __future__ import annotations

import asyncio
import json
from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import Any

import numpy as np
import simplejpeg
from aiohttp import web
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.extras.operations.status import History
from glsplat.net.backend import AvatarInfo
from glsplat.net.client_stream import ClientStream
from glsplat.net.codec.encoded import Encoded
from glsplat.net.feature import Feature, ServerView
from glsplat.net.rights import User, user_of

PORTRAIT_PX = 192
"""Side of an avatar's portrait."""

MAX_PREVIEW_PX = 240  # larger side of a client's last picture
_BACKGROUND = np.array([205, 210, 216], np.float32)  # sRGB, behind transparent pixels
_QUALITY = 85
_NO_STORE = {"Cache-Control": "no-store"}  # pictures show people's faces


class Previews(Feature):
    """GET /thumbnails/NAME, /pictures/NUMBER and /status.json, which has the curves of ``history``."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._portraits: dict[tuple[str, str], tuple[bytes, str]] = {}  # JPEG and tag, by name and label
        self._small: dict[int, tuple[Encoded, asyncio.Task[bytes]]] = {}  # by client, of its last picture
        self._drawing = asyncio.Lock()

    async def start(self, server: ServerView) -> None:
        """Keep the server; pictures are drawn on request."""
        self._server, self._offers = server, server.catalogue
        self._rights, self._clients = server.gate.rights, server.clients

    def routes(self) -> list[web.RouteDef]:
        """Return the routes of /thumbnails, /pictures and /status.json."""
        return [
            web.get("/thumbnails/{name}", self._thumbnail),
            web.get("/pictures/{number:[0-9]{1,9}}", self._picture),
            web.get("/status.json", self._status),
        ]

    def client_stats(self, user: User | None, client: ClientStream) -> Mapping[str, Any]:
        """Return whether /pictures shows the client's picture to the account."""
        return {"picture": self.shows(user, client.number)}

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Forget the client's picture."""
        self._small.pop(client.number, None)

    def avatar_withdrawn(self, name: str) -> None:
        """Forget the avatar's portrait."""
        self._portraits = {key: data for key, data in self._portraits.items() if key[0] != name}

    def shows(self, user: User | None, number: int) -> bool:
        """Return whether /pictures shows a client's picture to the account."""
        client = self._clients.get(number)
        if client is None or client.newest is None:
            return False
        return self._rights.sees(user, "identity", client.account)

    def tag(self, name: str, user: User | None) -> str:
        """Return the tag of an avatar's portrait, which changes with it; "" before it is drawn."""
        return self._portraits.get((name, self._rights.label(user, name)), (b"", ""))[1]

    async def small(self, number: int) -> bytes:
        """Return a JPEG of the client's last picture, made once per picture. Requires ``shows``."""
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
        found = self._portraits.get(key)
        if found is None:
            try:
                found = await self._portrait_of(name, key)
            except GlsplatError as error:
                return web.Response(status=503, text=f"{error}\n", headers={"Retry-After": "5"})
        if found is None:  # withdrawn meanwhile; 204 leaves no error in the browser's console
            return web.Response(status=204)
        data, tag = found
        headers = _NO_STORE | {"ETag": f'"{tag}"'}
        if any(known.value == tag for known in request.if_none_match or ()):
            return web.Response(status=304, headers=headers)
        return web.Response(body=data, content_type="image/jpeg", headers=headers)

    async def _portrait_of(self, name: str, key: tuple[str, str]) -> tuple[bytes, str] | None:
        """Return an avatar's portrait and its tag, drawn once for all requests; None if the avatar is gone."""
        async with self._drawing:
            found = self._portraits.get(key)
            if found is None and name in self._offers.names:
                one = self._offers[name]
                encoded, _ = await self._server.internal_client.draw(one, _portrait(one), lambda: key[1])
                data = await asyncio.to_thread(_thumbnail_of, encoded)
                found = data, sha256(data).hexdigest()[:16]
                if name in self._offers.names and self._offers[name] is one:  # not replaced meanwhile
                    self._portraits[key] = found
        return found

    async def _picture(self, request: web.Request) -> web.Response:
        number = int(request.match_info["number"])
        if not self.shows(user_of(request), number):
            return web.Response(status=404, text="there is no such picture for you\n")
        return web.Response(body=await self.small(number), content_type="image/jpeg", headers=_NO_STORE)

    async def _status(self, request: web.Request) -> web.Response:
        """Answer with all data of the status page; tags tell it which portraits are new."""
        user = user_of(request)
        offer, stats = self._server.session(user), self._server.stats(user)
        shown = [one["id"] for one in stats["clients"] if one["picture"]]
        pictures = {
            number: b64encode(await self.small(number)).decode() for number in shown if self.shows(user, number)
        }
        avatars = [{name: one[name] for name in ("name", "title")} for one in offer["avatars"]]
        for one in avatars:
            one["tag"] = self.tag(one["name"], user)
        fields = {"stats": stats, "history": self._history.fields(), "avatars": avatars, "pictures": pictures}
        return web.json_response(fields, headers=_NO_STORE)


def flattened(encoded: Encoded) -> NDArray[np.uint8]:
    """Return the first picture [H, W, 3], on a light background where its alpha was sent with it."""
    colour = simplejpeg.decode_jpeg(encoded.pictures[0]).astype(np.float32)
    if encoded.alphas is not None:
        alpha = simplejpeg.decode_jpeg(encoded.alphas[0], "GRAY").astype(np.float32) / 255
        colour = colour * alpha + _BACKGROUND * (1 - alpha)
    flat: NDArray[np.uint8] = np.clip(np.round(colour), 0, 255).astype(np.uint8)
    return flat


def _thumbnail_of(encoded: Encoded) -> bytes:
    data: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(flattened(encoded)), _QUALITY, "RGB")
    return data


def _small(encoded: Encoded) -> bytes:
    """Return a small JPEG of a picture, which may be empty after cropping."""
    image = flattened(encoded)
    step = -(-max(image.shape[:2]) // MAX_PREVIEW_PX)
    height, width = (side // step * step for side in image.shape[:2])
    if height and width and step > 1:  # average whole blocks
        blocks = image[:height, :width].reshape(height // step, step, width // step, step, 3)
        image = blocks.mean((1, 3)).astype(np.uint8)
    data: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(image), _QUALITY, "RGB")
    return data


def _portrait(one: AvatarInfo) -> dict[str, object]:
    """Return a request for a picture of head and shoulders, seen from the front (+z)."""
    height = one.height or 1.7
    middle, away, across = 0.9 * height, 1.6, 0.36 * height  # metres
    focal = PORTRAIT_PX * away / across
    viewmat = [1, 0, 0, 0, 0, -1, 0, middle, 0, 0, -1, away, 0, 0, 0, 1]  # OpenCV axes, row by row
    request: dict[str, object] = {
        "eyes": [{"viewmat": viewmat, "K": [focal, focal, PORTRAIT_PX / 2, PORTRAIT_PX / 2]}],
        "size": [PORTRAIT_PX, PORTRAIT_PX],
        "quality": _QUALITY,
        "alpha": "straight",
    }
    return request if one.solver is None else request | {"pose": _standing()}


@cache
def _standing() -> dict[str, object]:
    """Return a standing pose of SMPL-X with arms down."""
    motion = json.loads((resources.files("glsplat.data") / "idle.json").read_text(encoding="utf-8"))
    pose: dict[str, object] = motion["frames"][0]
    return pose
