"""A client: asks a server for pictures, one at a time (``render``) or pipelined (``send`` and ``receive``)."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import urlencode, urlsplit

import aiohttp
import msgspec
import numpy as np

from glsplat.camera import Camera
from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.messages import VERSION, eye_fields
from glsplat.net.reply import Reply, parse_reply
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Arrived", "Client", "request_message"]

_MAX_REPLY = 64 * 1024 * 1024


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """A reply and when it came, on the clock of ``time.perf_counter``."""

    reply: Reply
    at: float  # seconds
    requested: float  # seconds; when its request was sent

    @property
    def communication_ms(self) -> float:
        """Round trip less the server's own time: both directions on the wire and in the sockets."""
        return max(0.0, (self.at - self.requested) * 1e3 - self.reply.info.get("times", {}).get("total", 0.0))


class Client:
    """``async with Client("ws://127.0.0.1:8000/ws") as client: reply = await client.render(cameras, pose=pose)``.

    ``window`` asks the server for that many pictures under way; ``mirror`` for the mirror image; ``height``
    (metres) fits the avatar to the user whose tracking is sent. ``cafile`` is the certificate to trust on wss.
    All methods raise ProtocolError when the server reports an error or goes away.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        *,
        window: int | None = None,
        mirror: bool = False,
        height: float | None = None,
        cafile: str | Path | None = None,
        timeout: float = 10.0,
    ) -> None:
        self.url = _checked_url(url)
        self._query = {"window": window, "mirror": int(mirror) or None, "height": height}
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._cafile = cafile
        self._timeout = timeout
        self._http: aiohttp.ClientSession | None = None
        self._ws: aiohttp.ClientWebSocketResponse | None = None
        self._sent: dict[int, float] = {}  # frame_id: seconds
        self._frame_id = 0
        self._received = 0

    @property
    def newest(self) -> int:
        """The frame_id of the newest request; 0 before the first."""
        return self._frame_id

    @property
    def waiting(self) -> bool:
        """True while the newest request has no answer."""
        return self._frame_id in self._sent

    async def __aenter__(self) -> Client:
        await self.connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def connect(self) -> None:
        """Open the connection."""
        tls = _client_tls(self._cafile) if self._cafile else True
        query = urlencode({key: value for key, value in self._query.items() if value is not None})
        url = self.url + (("&" if "?" in self.url else "?") + query if query else "")
        self._http = aiohttp.ClientSession()
        try:
            async with asyncio.timeout(self._timeout):
                self._ws = await self._http.ws_connect(
                    url, headers=self._headers, ssl=tls, max_msg_size=_MAX_REPLY, compress=0
                )
        except (aiohttp.ClientError, OSError, TimeoutError) as error:
            await self.close()
            raise await _not_connected(self.url, error) from None

    async def close(self) -> None:
        """Close the connection; harmless when there is none."""
        if self._ws is not None:
            await self._ws.close()
        if self._http is not None:
            await self._http.close()
        self._ws = self._http = None

    async def render(
        self,
        cameras: Sequence[Camera] | None = None,
        *,
        pose: Pose | Mapping[str, Any] | None = None,
        tracking: Mapping[str, Any] | None = None,
        quality: int | None = None,
        crop: bool = False,
    ) -> Reply:
        """Ask for one picture and wait for it."""
        frame_id = await self.send(cameras, pose=pose, tracking=tracking, quality=quality, crop=crop)
        while True:
            arrived = await self.receive()
            if arrived.reply.frame_id == frame_id:
                return arrived.reply

    async def send(
        self,
        cameras: Sequence[Camera] | None = None,
        *,
        pose: Pose | Mapping[str, Any] | None = None,
        tracking: Mapping[str, Any] | None = None,
        quality: int | None = None,
        crop: bool = False,
    ) -> int:
        """Send a request without waiting for its picture, which may never come (a newer one replaces it)."""
        self._frame_id += 1
        now = time.perf_counter()
        message = request_message(
            self._frame_id, cameras, pose=pose, tracking=tracking, quality=quality, crop=crop, t=now * 1e3
        )
        message["ack"] = self._received
        self._sent[self._frame_id] = now
        await self.send_text(_encoder.encode(message).decode())
        return self._frame_id

    async def send_text(self, text: str) -> None:
        """Send any text as it is."""
        try:
            await self._socket.send_str(text)
        except (ConnectionError, aiohttp.ClientError):
            raise ProtocolError(f"{self.url}: the server closed the connection", "closed") from None

    async def acknowledge(self) -> None:
        """Tell the server what has arrived, without asking for a picture; also keeps a quiet connection alive."""
        await self.send_text(f'{{"v":{VERSION},"ack":{self._received}}}')

    async def receive(self) -> Arrived:
        """The next picture. Acknowledges it at once when newer requests are under way, so that they can be drawn."""
        while True:
            try:
                message = await self._socket.receive(timeout=self._timeout)
            except TimeoutError:
                raise ProtocolError(f"{self.url}: no picture within {self._timeout:g} s", "timeout") from None
            at = time.perf_counter()
            if message.type == aiohttp.WSMsgType.TEXT:
                error = _server_error(message.data)
                self._sent.pop(error.frame_id or 0, None)
                raise error
            if message.type != aiohttp.WSMsgType.BINARY:
                raise ProtocolError(f"{self.url}: the server closed the connection{_why(self._socket)}", "closed")
            reply = parse_reply(message.data)
            if reply.frame_id not in self._sent:  # answered before, or never asked for
                continue
            requested = self._sent[reply.frame_id]
            self._sent = {frame_id: t for frame_id, t in self._sent.items() if frame_id > reply.frame_id}
            self._received = reply.frame_id
            if self._sent:
                await self.acknowledge()
            return Arrived(reply, at, requested)

    @property
    def _socket(self) -> aiohttp.ClientWebSocketResponse:
        if self._ws is None:
            raise ProtocolError(f"{self.url}: not connected", "closed")
        return self._ws


def request_message(
    frame_id: int,
    cameras: Sequence[Camera] | None = None,
    *,
    pose: Pose | Mapping[str, Any] | None = None,
    tracking: Mapping[str, Any] | None = None,
    quality: int | None = None,
    crop: bool = False,
    t: float | None = None,
) -> dict[str, Any]:
    """The native request (docs/protocol.md) as a JSON object. Cameras may be left out where tracking has a head."""
    message: dict[str, Any] = {"v": VERSION, "frame_id": frame_id}
    if t is not None:
        message["t"] = t
    if cameras:
        message["eyes"] = [eye_fields(camera) for camera in cameras]
        message["size"] = [cameras[0].width, cameras[0].height]
    if isinstance(pose, Pose):
        if len(pose.rotations) != len(JOINT_NAMES):
            raise ProtocolError('a pose of another rig than SMPL-X is sent as {"joints": {NAME: [x, y, z]}}')
        pose = pose.to_smplx()
    for key, value in (("pose", pose), ("tracking", tracking), ("quality", quality), ("crop", crop or None)):
        if value is not None:
            message[key] = value
    return message


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"a request holds numbers, lists and arrays, not {type(value).__name__}")


_encoder = msgspec.json.Encoder(enc_hook=_plain)


def _checked_url(url: str) -> str:
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        valid = False
    if not valid:
        raise GlsplatError(f"{url}: expected ws://HOST:PORT/ws or wss://HOST:PORT/ws")
    return parts._replace(path="/ws").geturl() if parts.path in ("", "/") else url


def _client_tls(cafile: str | Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=str(cafile))
    except (OSError, ssl.SSLError):
        raise GlsplatError(f"{cafile}: expected a certificate in PEM") from None


async def _not_connected(url: str, error: Exception) -> ProtocolError:
    """What stands between us and the server, and what to do about it."""
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return ProtocolError(f"{url}: its certificate is not trusted; give it with --tls-ca", "tls")
    if isinstance(error, aiohttp.ClientConnectorSSLError):
        reason = getattr(error.os_error, "reason", None)
        if reason in _NO_TLS:
            return ProtocolError(f"{url}: this server does not speak TLS; the address begins with ws://", "tls")
        return ProtocolError(f"{url}: no agreement on TLS ({reason or error.os_error})", "tls")
    reached = not isinstance(error, aiohttp.ClientConnectorError | TimeoutError)
    if reached and url.startswith("ws:") and await _speaks_tls(url):
        return ProtocolError(f"{url}: this server speaks TLS; the address begins with wss://", "tls")
    if isinstance(error, aiohttp.WSServerHandshakeError):
        return ProtocolError(_refused(url, error.status), "refused")
    if reached:
        return ProtocolError(f"{url}: what listens there closed the connection; is it a glsplat server?", "unreachable")
    return ProtocolError(f"no server at {url}: start one with `glsplat serve`", "unreachable")


# what OpenSSL calls an answer that is not TLS: plain HTTP, in old and new versions
_NO_TLS = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST", "UNEXPECTED_MESSAGE")


async def _speaks_tls(url: str) -> bool:
    """True if a TLS handshake succeeds there; whose certificate it is does not matter."""
    parts = urlsplit(url)
    tls = ssl.create_default_context()
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    try:
        async with asyncio.timeout(2.0):
            _, writer = await asyncio.open_connection(parts.hostname, parts.port or 80, ssl=tls)
    except (OSError, TimeoutError):
        return False
    writer.close()
    return True


def _refused(url: str, status: int) -> str:
    reasons = {
        400: "it does not know an option of the address (mirror is 0 or 1, window 1 to 8, height 0.5 to 2.8)",
        401: "it wants a token; give it with --token-file",
        403: "it does not serve this origin",
        404: "there is no WebSocket at this path; it is /ws",
        503: "it is full or stopping; try again later",
    }
    return f"{url}: the server refuses ({status}): {reasons.get(status, 'no glsplat server?')}"


def _server_error(text: str) -> ProtocolError:
    try:
        error = msgspec.json.decode(text)["error"]
        return ProtocolError(str(error["message"]), str(error["code"]), error.get("frame_id"))
    except (msgspec.MsgspecError, KeyError, TypeError, AttributeError):
        return ProtocolError("the server sent a text message that is not an error", "bad_reply")


def _why(ws: aiohttp.ClientWebSocketResponse) -> str:
    return "" if ws.close_code is None else f" ({ws.close_code})"
