"""Read an upload's HTTP body: one picture, or a form of several fields.

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

clock: Callable[[], float] = time.monotonic

_FIELDS = ("height", "anyway", "consent", "name")
MAX_FIELD_BYTES = 128  # 32 letters of any script
_TYPES = ("image/jpeg", "image/png", "image/webp")
MIN_HEIGHT_M, MAX_HEIGHT_M = 0.5, 2.8
MAX_FORM_BYTES = 65_536  # of a form without its pictures
MAX_PART_HEAD_BYTES = 4096
MAX_PARTS = 16
_BOUNDARY = re.compile(r"""boundary=(?:"([ !#-~]{1,70})"|([!#-:<-~]{1,70}))""", re.IGNORECASE)
_NAME = re.compile(rb'\ncontent-disposition: *form-data; *name="?([a-z]{1,20})"?', re.IGNORECASE)
_BROKEN = "the form cannot be read: expected multipart/form-data (RFC 7578)"


class RateFloor:
    """Minimum rate of a sender: ``rate`` bytes per second, with up to ``slack`` seconds of delay."""

    __slots__ = ("_deadline", "_rate", "_slack")

    def __init__(self, rate: float, slack: float, now: float) -> None:
        self._rate, self._slack, self._deadline = rate, slack, now + slack

    def receive(self, nbytes: int, now: float) -> None:
        """Count received bytes."""
        self._deadline = min(now + self._slack, self._deadline + nbytes / self._rate)

    def left(self, now: float) -> float:
        """Return the seconds until a sender that sends nothing more is too slow."""
        return self._deadline - now


class RefusedError(Exception):
    """A refused request: HTTP ``status``, one line of text, and seconds to ``wait`` before another try."""

    def __init__(self, status: int, text: str, wait: int | None = None) -> None:
        super().__init__(text)
        self.status, self.text = status, text
        self.headers: dict[str, str] = {} if wait is None else {"Retry-After": str(wait)}


def check_head(request: web.Request, config: UploadConfig) -> None:
    """Check the request's headers. Raises RefusedError."""
    if request.headers.get("Content-Encoding", "identity").lower() != "identity":
        raise RefusedError(415, "pictures are sent as they are: leave out Content-Encoding")
    if (request.content_length or 0) > config.body_bytes + MAX_FORM_BYTES:
        raise _too_big(config)
    if request.content_type != "multipart/form-data" and request.content_type not in _TYPES:
        raise RefusedError(415, f"send one picture ({', '.join(_TYPES)}) or multipart/form-data")


async def read_order(request: web.Request, config: UploadConfig) -> Order:
    """Return the order in the body. Raises RefusedError; ConnectionError when the client has disconnected."""
    try:
        async with asyncio.timeout(config.receive_timeout):
            body = await _read_body(request, config)
    except TimeoutError:
        raise RefusedError(
            408,
            f"the pictures came too slowly: at least {config.rate / 1000:g} kB a second are needed, all of them within "
            f"{config.receive_timeout:g} s; send smaller ones, or try a better connection",
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
    """Return the fields and the pictures of multipart/form-data (RFC 7578) by name.

    Nothing is decoded; file names are ignored. Raises RefusedError.
    """
    fields: dict[str, str] = {}
    pictures: dict[str, bytes] = {}
    first, *parts = (b"\r\n" + body).split(b"\r\n--" + boundary, MAX_PARTS)
    if first or not parts or not parts.pop().startswith(b"--"):
        raise RefusedError(400, _BROKEN)
    for part in parts:
        head, blank, value = part.partition(b"\r\n\r\n")
        named = _NAME.search(head[:MAX_PART_HEAD_BYTES])
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
            fields[name] = value[:MAX_FIELD_BYTES].decode("utf-8", "replace").strip()
    return fields, pictures


async def discard(request: web.Request, config: UploadConfig, seconds: float = 3.0) -> None:
    """Read and drop the rest of a refused body, within bounds: browsers show the answer only then."""
    left = config.body_bytes
    try:
        async with asyncio.timeout(seconds):
            while left > 0 and (data := await request.content.readany()):
                left -= len(data)
    except (TimeoutError, ConnectionError, ClientError, RuntimeError):
        pass


async def _read_body(request: web.Request, config: UploadConfig) -> bytes:
    data = bytearray()
    floor = RateFloor(config.rate, config.stall, clock())
    while True:
        async with asyncio.timeout(floor.left(clock())):
            piece = await request.content.readany()
        if not piece:
            return bytes(data)
        data += piece
        floor.receive(len(piece), clock())
        if len(data) > config.body_bytes + MAX_FORM_BYTES:
            raise _too_big(config)


def _order(fields: Mapping[str, str], pictures: Mapping[str, bytes], config: UploadConfig) -> Order:
    pictures = {name: data for name, data in pictures.items() if data}  # browsers also send empty fields
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
    if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
        raise RefusedError(400, f"height needs {MIN_HEIGHT_M:g} to {MAX_HEIGHT_M:g} metres")
    return height


def _too_big(config: UploadConfig) -> RefusedError:
    one, all_ = config.picture_bytes / 1e6, config.body_bytes / 1e6
    return RefusedError(413, f"a picture has at most {one:g} MB, all of them together {all_:g} MB; send smaller ones")
