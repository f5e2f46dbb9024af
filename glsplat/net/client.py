"""A client: asks a server for pictures, one at a time (``render``) or pipelined (``send`` and ``receive``)."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Unpack
from urllib.parse import urlencode, urlsplit

import aiohttp
import msgspec
import numpy as np

from glsplat.arrays import count, flag, number
from glsplat.camera import Camera
from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.client_connection import ClientConnection
from glsplat.net.fields import Want, Wishes
from glsplat.net.flow import FlowControl, ReceivedReply
from glsplat.net.messages import MAX_BYTES, VERSION, eye_fields
from glsplat.net.reply import Reply
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

if TYPE_CHECKING:
    from glsplat.net.codec.video_reader import VideoReader

__all__ = ["Client", "ReceivedReply", "request_message"]

_MAX_REPLY = 64 * 1024 * 1024


class Client:
    """``async with Client("ws://127.0.0.1:8000/ws") as client: reply = await client.render(cameras, pose=pose)``.

    ``avatar`` chooses one of those the server offers; ``window`` asks for that many pictures under way, ``mirror`` for
    the mirror image; ``height`` and arm ``span`` from wrist to wrist (metres) fit the avatar to the user whose
    tracking is sent. ``room`` is where to meet others, as ``name``, who stands ``at`` x, z metres from its centre and
    degrees about y (None: where there is a free place). ``cafile`` is the certificate to trust on wss.
    ``timeout`` is in seconds, of connecting and of each picture. ``adapt`` tells the server when each arrives; one
    that adapts, as ``glsplat serve`` does, fits them to the link: smaller, cropped, coarser (``Reply.info`` says so).
    ``video`` takes video where the server has it (``serve --video``) and decodes it, which needs PyAV.

    May be connected again after ``close``, or after the server went away: a new session, whose frame_ids begin at 1.
    All methods raise ProtocolError when the server reports an error or goes away (``code`` "closed", "timeout", ...).
    A Client belongs to the event loop it is connected in; its methods may be called by many tasks there.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        *,
        window: int | None = None,
        mirror: bool = False,
        height: float | None = None,
        span: float | None = None,
        avatar: str | None = None,
        room: str | None = None,
        name: str | None = None,
        at: tuple[float, float, float] | None = None,
        cafile: str | Path | None = None,
        timeout: float = 10.0,
        adapt: bool = False,
        video: bool = False,
    ) -> None:
        self.url: str = _checked_url(url)
        _check_token(token)
        mirror = flag(mirror, "mirror", GlsplatError)
        window = None if window is None else count(window, "window", GlsplatError, 1)
        height = None if height is None else number(height, "height", GlsplatError)
        span = None if span is None else number(span, "span", GlsplatError)
        asked = {"avatar": avatar, "window": window, "mirror": int(mirror) or None, "height": height, "span": span}
        place = None if at is None else ",".join(f"{number(v, 'at', GlsplatError):g}" for v in _three(at))
        asked |= {"room": room, "name": name, "at": place}
        self._query = {key: value for key, value in asked.items() if value is not None}
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._cafile, self._adapt = cafile, flag(adapt, "adapt", GlsplatError)
        self._reader: Callable[[], VideoReader | None] = lambda: None
        if flag(video, "video", GlsplatError):
            from glsplat.net.codec.video_reader import VideoReader  # here: it needs what most have not

            VideoReader()  # raises now what would come with the connection
            self._reader = VideoReader
        self._timeout: float = number(timeout, "timeout", GlsplatError)
        if self._timeout <= 0:
            raise GlsplatError(f"timeout needs seconds above 0, not {self._timeout:g}")
        self._connection: ClientConnection | None = None

    @property
    def newest(self) -> int:
        """The frame_id of the newest request; 0 before the first."""
        return self.flow.newest

    @property
    def waiting(self) -> bool:
        """True while the newest request has no answer."""
        return self.flow.waiting

    @property
    def flow(self) -> FlowControl:
        """What is under way on this connection; an empty one before the first."""
        return FlowControl() if self._connection is None else self._connection.flow

    async def __aenter__(self) -> Client:
        await self.connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def connect(self) -> None:
        """Open the connection; harmless while there is one."""
        if self._ours():
            return
        await self.close()
        tls = _client_tls(self._cafile) if self._cafile else True
        query = urlencode(self._query)
        url = self.url + (("&" if "?" in self.url else "?") + query if query else "")
        http = aiohttp.ClientSession()
        try:
            async with asyncio.timeout(self._timeout):
                ws = await http.ws_connect(url, headers=self._headers, ssl=tls, max_msg_size=_MAX_REPLY, compress=0)
        except (aiohttp.ClientError, OSError, TimeoutError) as error:
            await http.close()
            raise await _not_connected(self.url, error, self._timeout) from None
        except BaseException:
            await http.close()
            raise
        connection = ClientConnection(self.url, http, ws, self._adapt, self._reader())
        if self._ours():  # another task was quicker
            await connection.close()
        else:
            self._connection = connection

    async def close(self) -> None:
        """Close the connection; harmless when there is none. Who waits for a picture gets a ProtocolError."""
        connection, self._connection = self._connection, None
        if connection is not None and connection.loop is asyncio.get_running_loop():
            await connection.close()

    async def render(
        self,
        cameras: Sequence[Camera] | None = None,
        *,
        pose: Pose | Mapping[str, Any] | None = None,
        tracking: Mapping[str, Any] | None = None,
        **wishes: Unpack[Wishes],
    ) -> Reply:
        """Ask for one picture and wait for it. Calls at the same time are served one after the other.

        Raises ProtocolError with ``code`` "dropped" when a ``send`` of another task went out meanwhile and its picture
        came first: the newest request wins, and the server never answers the one it replaced.
        """
        connection = self._open()
        async with connection.turn:
            connection.take_all()
            request = self._request(connection, cameras, pose=pose, tracking=tracking, **wishes)
            return (await connection.ask_and_wait(*request, self._timeout)).reply

    async def poses(
        self, *, pose: Pose | Mapping[str, Any] | None = None, tracking: Mapping[str, Any] | None = None
    ) -> Reply:
        """Ask how everybody stands (``Reply.bodies``) instead of for a picture, and wait for it, as ``render`` does.

        In a room only those come of whom there is news. ProtocolError with ``code`` "no_pose": the avatar's splats are
        not handed out.
        """
        connection = self._open()
        async with connection.turn:
            connection.take_all()
            request = self._request(connection, None, pose=pose, tracking=tracking, want="pose")
            return (await connection.ask_and_wait(*request, self._timeout)).reply

    async def send(
        self,
        cameras: Sequence[Camera] | None = None,
        *,
        pose: Pose | Mapping[str, Any] | None = None,
        tracking: Mapping[str, Any] | None = None,
        want: Want | None = None,
        subject: object = None,
        **wishes: Unpack[Wishes],
    ) -> int:
        """Send a request without waiting for its picture, which may never come (a newer one replaces it).

        The picture comes by ``receive``. Returns the frame_id. ``subject`` is not sent: ``flow.about(frame_id)`` gives
        it back when the answer is there. ``want`` "pose": as ``poses``.
        """
        connection = self._open()
        request = self._request(connection, cameras, pose=pose, tracking=tracking, want=want, **wishes)
        await connection.ask(*request, subject)
        return request[0]

    async def send_text(self, text: str) -> None:
        """Send any text as it is."""
        await self._open().send_text(text)

    async def acknowledge(self) -> None:
        """Tell the server what has arrived, without asking for a picture; also keeps a quiet connection alive."""
        await self._open().acknowledge()

    async def receive(self) -> ReceivedReply:
        """The next picture of a ``send``. Acknowledges it at once when newer requests are under way.

        The newest 8 that nobody has taken are kept. Raises the server's errors that no ``render`` waits for.
        """
        return await self._open().next(self._timeout)

    def _request(
        self, connection: ClientConnection, cameras: Sequence[Camera] | None, **fields: Any
    ) -> tuple[int, str, float]:
        """The next request: its frame_id, its text, and when it was made, in seconds."""
        now = time.perf_counter()
        number = connection.flow.newest + 1
        message = request_message(number, cameras, t=now * 1e3, **fields)
        message |= connection.flow.acknowledging(now)
        if connection.video is not None and message.get("want") != "pose":
            message["video"] = connection.video.wish()
        try:
            data = _encoder.encode(message)
        except (TypeError, ValueError, RecursionError) as error:  # what JSON cannot say
            raise ProtocolError(f"a request cannot be sent: {str(error)[:160]}", "bad_field") from None
        if len(data) > MAX_BYTES:
            raise ProtocolError(f"a request needs at most {MAX_BYTES} bytes, not {len(data)}", "too_big")
        return number, data.decode(), now

    def _ours(self) -> bool:
        """Whether there is an open connection in this event loop."""
        connection = self._connection
        return connection is not None and connection.alive and connection.loop is asyncio.get_running_loop()

    def _open(self) -> ClientConnection:
        if self._connection is None:
            raise ProtocolError(f"{self.url}: not connected; await connect() first", "closed")
        if self._connection.loop is not asyncio.get_running_loop():
            raise ProtocolError(f"{self.url}: connected in another event loop; await connect() in this one", "closed")
        return self._connection


def request_message(
    frame_id: int,
    cameras: Sequence[Camera] | None = None,
    *,
    pose: Pose | Mapping[str, Any] | None = None,
    tracking: Mapping[str, Any] | None = None,
    want: Want | None = None,
    t: float | None = None,
    **wishes: Unpack[Wishes],
) -> dict[str, Any]:
    """The native request (docs/protocol.md) as a JSON object. Cameras may be left out where tracking has a head."""
    message: dict[str, Any] = {"v": VERSION, "frame_id": frame_id}
    if t is not None:
        message["t"] = t
    if cameras is not None:
        message |= _eyes(cameras)
    if isinstance(pose, Pose):
        if len(pose.rotations) != len(JOINT_NAMES):
            raise ProtocolError('a pose of another rig than SMPL-X is sent as {"joints": {NAME: [x, y, z]}}')
        pose = pose.to_smplx()
    if unknown := wishes.keys() - Wishes.__annotations__.keys():
        raise TypeError(f"a request has no {', '.join(sorted(unknown))}: it has {', '.join(Wishes.__annotations__)}")
    asked: dict[str, Any] = {"pose": pose, "tracking": tracking, "want": want, **wishes}
    for key in ("crop", "alpha", "box", "depth"):
        asked[key] = asked.get(key) or None
    hide, light = wishes.get("hide", ()), wishes.get("light")
    asked["hide"] = ([hide] if isinstance(hide, str) else list(hide)) or None
    asked["light"] = light if light is None or isinstance(light, str) else light.to_json()
    return message | {key: value for key, value in asked.items() if value is not None}


def _eyes(cameras: Sequence[Camera]) -> dict[str, Any]:
    """The fields of the cameras; refuses what the wire has no place for, rather than leave it out."""
    views = [cameras] if isinstance(cameras, Camera) else list(cameras)
    if not 1 <= len(views) <= 2 or not all(isinstance(camera, Camera) for camera in views):
        raise ProtocolError("a request has one or two cameras (glsplat.Camera), left first; leave them out for a head")
    sizes = [(camera.width, camera.height) for camera in views]
    if sizes[0] != sizes[-1]:
        (w, h), (w2, h2) = sizes
        raise ProtocolError(f"both eyes need one size, not {w}x{h} and {w2}x{h2}", "bad_size")
    if any(tuple(camera.background) != (0, 0, 0) for camera in views):
        raise ProtocolError("a server draws on black: leave background at (0, 0, 0)", "bad_camera")
    if any((np.linalg.det(camera.viewmat[:3, :3])) < 0 for camera in views):
        raise ProtocolError("a viewmat that reflects is not sent: ask for mirror=True", "bad_camera")
    return {"eyes": [eye_fields(camera) for camera in views], "size": list(sizes[0])}


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"a request holds numbers, lists and arrays, not {type(value).__name__}")


_encoder = msgspec.json.Encoder(enc_hook=_plain)


def _checked_url(url: str) -> str:
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except (ValueError, AttributeError, TypeError):  # no text at all
        valid = False
    if not valid or not isinstance(url, str):
        raise GlsplatError(f"{url!s:.80}: expected ws://HOST:PORT/ws or wss://HOST:PORT/ws")
    return parts._replace(path="/ws").geturl() if parts.path in ("", "/") else url


def _client_tls(cafile: str | Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=str(cafile))
    except (OSError, ssl.SSLError):
        raise GlsplatError(f"{cafile}: expected a certificate in PEM") from None


def _check_token(token: Any) -> None:
    """A header's value: printable text without blanks, that is."""
    if token is not None and not (
        isinstance(token, str) and token.isascii() and token.isprintable() and " " not in token
    ):
        kind = "one with blanks, line ends or other signs" if isinstance(token, str) else type(token).__name__
        raise GlsplatError(f"a token is a word of printable ASCII, not {kind}; strip() what was read from a file")


def _three(at: Any) -> Sequence[Any]:
    if isinstance(at, str) or not isinstance(at, Sequence) or len(at) != 3:
        raise GlsplatError(f"at needs x, z in metres and degrees about y, not {at!r:.40}")
    return at


async def _not_connected(url: str, error: Exception, seconds: float) -> ProtocolError:
    """What stands between us and the server, and what to do about it."""
    if isinstance(error, TimeoutError):
        why = "is it a glsplat server, is it overloaded, is the timeout too short?"
        return ProtocolError(f"{url}: no answer within {seconds:g} s; {why}", "timeout")
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return ProtocolError(f"{url}: its certificate is not trusted; give it with --tls-ca", "tls")
    if isinstance(error, aiohttp.ClientConnectorSSLError):
        reason = getattr(error.os_error, "reason", None)
        if reason in _NO_TLS:
            return ProtocolError(f"{url}: this server does not speak TLS; the address begins with ws://", "tls")
        return ProtocolError(f"{url}: no agreement on TLS ({reason or error.os_error})", "tls")
    reached = not isinstance(error, aiohttp.ClientConnectorError)
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
    writer.transport.abort()  # a graceful end would outlive the event loop
    return True


def _refused(url: str, status: int) -> str:
    reasons = {
        400: "it does not know an option of the address: avatar is one of its /session, mirror 0 or 1, window 1 to 8, "
        "height 0.5 to 2.8, span 0.3 to 2.5, name letters and digits, at x,z,degrees",
        401: "it wants a token; give it with --token-file",
        403: "it does not serve this origin, or this account may not have this avatar, room or name now",
        404: "there is no such room, which /session lists, or no WebSocket at this path, which is /ws",
        409: "somebody of this name is in the room; choose another",
        421: "it does not go by this name; start it with --allow-host",
        429: "this address has too many clients there, or broke a limit; try again later",
        503: "it, or the room, is full, or it stops; try again later",
    }
    return f"{url}: the server refuses ({status}): {reasons.get(status, 'no glsplat server?')}"
