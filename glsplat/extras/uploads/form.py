"""A request to make an avatar, read from the wire: one picture as it is, or a form of several fields.

aiohttp's MultipartReader is not used: it takes seven times as long for two pictures of 20 MB, all of it in the event
loop, and accepts forms that are cut off.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Callable, Mapping

from aiohttp import ClientError, web

from glsplat.extras.uploads.job import VIEWS, Order, UploadConfig
from glsplat.net.options import NAME

__all__ = ["RateFloor", "RefusedError", "check_head", "discard", "read_order", "split_form"]

clock: Callable[[], float] = time.monotonic

_FIELDS = ("height", "anyway", "consent", "name")
_FIELD = 128  # bytes of a field: 32 letters of any script
_TYPES = ("image/jpeg", "image/png", "image/webp")
_HEIGHTS = 0.5, 2.8  # metres
_FORM = 65_536  # bytes of a form beside its pictures
_HEAD = 4096  # bytes of a part's headers that are looked at
_MOST_PARTS = 16
_BOUNDARY = re.compile(r"""boundary=(?:"([ !#-~]{1,70})"|([!#-:<-~]{1,70}))""", re.IGNORECASE)
_NAME = re.compile(rb'\ncontent-disposition: *form-data; *name="?([a-z]{1,20})"?', re.IGNORECASE)
_BROKEN = "the form cannot be read: expected multipart/form-data (RFC 7578)"


class RateFloor:
    """Minimum rate of a sender: each byte earns 1 / ``rate`` seconds, of which at most ``slack`` are kept."""

    __slots__ = ("_deadline", "_rate", "_slack")

    def __init__(self, rate: float, slack: float, now: float) -> None:
        self._rate, self._slack, self._deadline = rate, slack, now + slack

    def receive(self, nbytes: int, now: float) -> None:
        """Count received bytes."""
        self._deadline = min(now + self._slack, self._deadline + nbytes / self._rate)

    def left(self, now: float) -> float:
        """Return the seconds until the sender is too slow, if nothing more comes."""
        return self._deadline - now


class RefusedError(Exception):
    """An answer of HTTP: ``status`` and one line of text."""

    def __init__(self, status: int, text: str, wait: int | None = None) -> None:
        super().__init__(text)
        self.status, self.text = status, text
        self.headers: dict[str, str] = {} if wait is None else {"Retry-After": str(wait)}  # seconds


def check_head(request: web.Request, config: UploadConfig) -> None:
    """Raises RefusedError for what need not be read to be refused."""
    if request.headers.get("Content-Encoding", "identity").lower() != "identity":
        raise RefusedError(415, "pictures are sent as they are: leave out Content-Encoding")
    if (request.content_length or 0) > config.body_bytes + _FORM:
        raise _too_big(config)
    if request.content_type != "multipart/form-data" and request.content_type not in _TYPES:
        raise RefusedError(415, f"send one picture ({', '.join(_TYPES)}) or multipart/form-data")


async def read_order(request: web.Request, config: UploadConfig) -> Order:
    """What the body asks for. Raises RefusedError; ConnectionError when the client is gone."""
    try:
        async with asyncio.timeout(config.receive):
            body = await _whole(request, config)
    except TimeoutError:
        raise RefusedError(
            408,
            f"the pictures came too slowly: at least {config.rate / 1000:g} kB a second are needed, all of them within "
            f"{config.receive:g} s; send smaller ones, or try a better connection",
        ) from None
    except (ConnectionError, ClientError) as error:
        raise ConnectionError("gone in the middle of its pictures") from error
    if request.content_type in _TYPES:
        return _order(request.query, {VIEWS[0]: body}, config)
    boundary = _BOUNDARY.search(request.headers.get("Content-Type", ""))
    if boundary is None:
        raise RefusedError(400, _BROKEN)
    return _order(*split_form(body, (boundary[1] or boundary[2]).encode()), config)


def split_form(body: bytes, boundary: bytes) -> tuple[dict[str, str], dict[str, bytes]]:
    """Fields and pictures by name, of multipart/form-data (RFC 7578). Nothing is decoded, and no file's name read.

    Raises RefusedError for what no browser sends.
    """
    fields: dict[str, str] = {}
    pictures: dict[str, bytes] = {}
    first, *parts = (b"\r\n" + body).split(b"\r\n--" + boundary, _MOST_PARTS)
    if first or not parts or not parts.pop().startswith(b"--"):
        raise RefusedError(400, _BROKEN)
    for part in parts:
        head, blank, value = part.partition(b"\r\n\r\n")
        named = _NAME.search(head[:_HEAD])
        if not blank or named is None:
            raise RefusedError(400, _BROKEN)
        name = named[1].decode("ascii", "replace")
        if name not in (*VIEWS, *_FIELDS):
            raise RefusedError(400, f"a form has the fields {', '.join((*VIEWS, *_FIELDS))}, and no others")
        if name in fields or name in pictures:
            raise RefusedError(400, f"the form has two fields {name}")
        if name in VIEWS:
            pictures[name] = value
        else:
            fields[name] = value[:_FIELD].decode("utf-8", "replace").strip()
    return fields, pictures


async def discard(request: web.Request, config: UploadConfig, seconds: float = 3.0) -> None:
    """Read what a refused client goes on sending, within bounds: else it never hears why."""
    left = config.body_bytes
    try:
        async with asyncio.timeout(seconds):
            while left > 0 and (data := await request.content.readany()):
                left -= len(data)
    except (TimeoutError, ConnectionError, ClientError, RuntimeError):
        pass


async def _whole(request: web.Request, config: UploadConfig) -> bytes:
    data = bytearray()
    floor = RateFloor(config.rate, config.stall, clock())
    while True:
        async with asyncio.timeout(floor.left(clock())):
            piece = await request.content.readany()
        if not piece:
            return bytes(data)
        data += piece
        floor.receive(len(piece), clock())
        if len(data) > config.body_bytes + _FORM:
            raise _too_big(config)


def _order(fields: Mapping[str, str], pictures: Mapping[str, bytes], config: UploadConfig) -> Order:
    pictures = {name: data for name, data in pictures.items() if data}  # a browser sends what was left empty, too
    if max(map(len, pictures.values()), default=0) > config.picture_bytes:
        raise _too_big(config)
    if VIEWS[0] not in pictures:
        raise RefusedError(400, "a picture from the front is needed (front)")
    if fields.get("consent") != "yes":
        raise RefusedError(400, "consent=yes is needed: that this is you, or that this person agreed")
    if fields.get("anyway", "no") not in ("yes", "no"):
        raise RefusedError(400, "anyway needs yes or no")
    title = fields.get("name", "")
    if title and not NAME.fullmatch(title):
        raise RefusedError(400, "name needs 1 to 32 letters, digits, blanks or _.'- between them")
    return Order(
        pictures=pictures,
        height=_height(fields.get("height", "")),
        anyway=fields.get("anyway") == "yes",
        title=title,
    )


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
