"""A request to make an avatar, read from the wire: one picture as it is, or a form of several fields."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import TypeVar

from aiohttp import BodyPartReader, ClientError, web
from aiohttp.http_exceptions import HttpProcessingError

from glsplat.net.uploads.job import VIEWS, Order, UploadConfig

__all__ = ["RefusedError", "check_head", "discard", "read_order"]

T = TypeVar("T")

_FIELDS = ("height", "anyway", "consent")
_FIELD = 64  # characters of a field
_TYPES = ("image/jpeg", "image/png", "image/webp")
_HEIGHTS = 0.5, 2.8  # metres
_CHUNK = 256 * 1024  # bytes read at once


class RefusedError(Exception):
    """An answer of HTTP: ``status`` and one line of text."""

    def __init__(self, status: int, text: str, wait: int | None = None) -> None:
        super().__init__(text)
        self.status, self.text = status, text
        self.wait = wait  # seconds after which it may be tried again


def check_head(request: web.Request, config: UploadConfig) -> None:
    """Raises RefusedError for what need not be read to be refused."""
    if request.headers.get("Content-Encoding", "identity").lower() != "identity":
        raise RefusedError(415, "pictures are sent as they are: leave out Content-Encoding")
    if (request.content_length or 0) > config.body_bytes:
        raise _too_big(config)
    if request.content_type != "multipart/form-data" and request.content_type not in _TYPES:
        raise RefusedError(415, f"send one picture ({', '.join(_TYPES)}) or multipart/form-data")


async def read_order(request: web.Request, config: UploadConfig) -> Order:
    """What the body asks for. Raises RefusedError; ConnectionError when the client is gone."""
    try:
        async with asyncio.timeout(config.receive):
            if request.content_type in _TYPES:
                fields: Mapping[str, str] = request.query
                picture = await _whole(request.content.read, config, config.picture_bytes)
                pictures = {VIEWS[0]: picture}
            else:
                fields, pictures = await _form(request, config)
    except TimeoutError:
        raise RefusedError(408, "the pictures came too slowly; try again on a better connection") from None
    except (ConnectionError, ClientError) as error:
        raise ConnectionError("gone in the middle of its pictures") from error
    except (ValueError, RuntimeError, LookupError, AssertionError, HttpProcessingError):  # aiohttp's parser has all
        raise RefusedError(400, "the form cannot be read: expected multipart/form-data (RFC 7578)") from None
    except web.HTTPRequestEntityTooLarge:
        raise _too_big(config) from None
    return _order(fields, pictures)


async def discard(request: web.Request, config: UploadConfig, seconds: float = 3.0) -> None:
    """Read what a refused client goes on sending, within bounds: else it never hears why."""
    left = config.body_bytes
    try:
        async with asyncio.timeout(seconds):
            while left > 0 and (data := await request.content.readany()):
                left -= len(data)
    except (TimeoutError, ConnectionError, ClientError, RuntimeError):
        pass


async def _form(request: web.Request, config: UploadConfig) -> tuple[dict[str, str], dict[str, bytes]]:
    fields: dict[str, str] = {}
    pictures: dict[str, bytes] = {}
    left = config.body_bytes
    reader = await request.multipart()
    while (part := await _soon(reader.next(), config)) is not None:
        name = part.name if isinstance(part, BodyPartReader) else None
        if not isinstance(part, BodyPartReader) or name not in (*VIEWS, *_FIELDS):
            raise RefusedError(400, f"a form has the fields {', '.join((*VIEWS, *_FIELDS))}, and no others")
        if name in fields or name in pictures:
            raise RefusedError(400, f"the form has two fields {name}")
        if name in _FIELDS:
            text = await _whole(part.read_chunk, config, _FIELD)
            fields[name] = text.decode("utf-8", "replace").strip()
            continue
        picture = await _whole(part.read_chunk, config, min(left, config.picture_bytes))
        left -= len(picture)
        if picture:  # a browser sends what was left empty, too
            pictures[name] = picture
    return fields, pictures


async def _whole(read: Callable[[int], Awaitable[bytes]], config: UploadConfig, most: int) -> bytes:
    """All that ``read`` gives, piece by piece, at most that many bytes."""
    data = bytearray()
    while piece := await _soon(read(_CHUNK), config):
        data += piece
        if len(data) > most:
            raise _too_big(config)
    return bytes(data)


async def _soon(reading: Awaitable[T], config: UploadConfig) -> T:
    async with asyncio.timeout(config.stall):
        return await reading


def _order(fields: Mapping[str, str], pictures: Mapping[str, bytes]) -> Order:
    if not pictures.get(VIEWS[0]):
        raise RefusedError(400, "a picture from the front is needed (front)")
    if fields.get("consent") != "yes":
        raise RefusedError(400, "consent=yes is needed: that this is you, or that this person agreed")
    if fields.get("anyway", "no") not in ("yes", "no"):
        raise RefusedError(400, "anyway needs yes or no")
    return Order(pictures=pictures, height=_height(fields.get("height", "")), anyway=fields.get("anyway") == "yes")


def _height(text: str) -> float | None:
    if not text:
        return None
    try:
        height = float(text)
    except ValueError:
        height = 0.0
    if not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        raise RefusedError(400, f"height needs {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} metres")
    return height


def _too_big(config: UploadConfig) -> RefusedError:
    one, all_ = config.picture_bytes / 1e6, config.body_bytes / 1e6
    return RefusedError(413, f"a picture has at most {one:g} MB, all of them together {all_:g} MB; send smaller ones")
