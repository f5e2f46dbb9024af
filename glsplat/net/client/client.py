"""Client: requests pictures from a server, one at a time (``render``) or pipelined (``send`` and ``receive``)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Unpack
from urllib.parse import urlencode

import aiohttp
import msgspec
import numpy as np

from glsplat.arrays import count, flag, number
from glsplat.camera import Camera
from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.client.connection import ClientConnection, VideoReader
from glsplat.net.client.dialing import check_token, checked_url, client_tls, not_connected, offered_avatars
from glsplat.net.flow import FlowControl
from glsplat.net.flow import ReceivedReply as ReceivedReply  # exported by the package
from glsplat.net.messages import MAX_MESSAGE_BYTES, VERSION, eye_fields
from glsplat.net.reply import Reply
from glsplat.net.wire_schema import PictureParams, Want
from glsplat.optional import missing, plugin
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES


def request_message(
    frame_id: int,
    cameras: Sequence[Camera] | None = None,
    *,
    pose: Pose | Mapping[str, Any] | None = None,
    tracking: Mapping[str, Any] | None = None,
    want: Want | None = None,
    t: float | None = None,
    **params: Unpack[PictureParams],
) -> dict[str, Any]:
    """Return a native request. ``cameras`` may be left out where ``tracking`` has a head. Raises ProtocolError."""
    message: dict[str, Any] = {"v": VERSION, "frame_id": frame_id}
    if t is not None:
        message["t"] = t
    if cameras is not None:
        message |= _eyes(cameras)
    if isinstance(pose, Pose):
        if len(pose.rotations) != len(JOINT_NAMES):
            raise ProtocolError('a pose of another rig than SMPL-X is sent as {"joints": {NAME: [x, y, z]}}')
        pose = pose.to_smplx()
    known = PictureParams.__annotations__
    if unknown := params.keys() - known.keys():
        raise TypeError(f"a request has no {', '.join(sorted(unknown))}: it has {', '.join(known)}")
    fields: dict[str, Any] = {"pose": pose, "tracking": tracking, "want": want, **params}
    for key in ("crop", "alpha", "box", "depth"):
        fields[key] = fields.get(key) or None
    hide, light = params.get("hide", ()), params.get("light")
    fields["hide"] = ([hide] if isinstance(hide, str) else list(hide)) or None
    fields["light"] = light if light is None or isinstance(light, str) else light.to_json()
    return message | {key: value for key, value in fields.items() if value is not None}


def _eyes(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Return ``eyes`` and ``size``. Raises ProtocolError for properties of cameras that the wire cannot hold."""
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


encoder: msgspec.json.Encoder = msgspec.json.Encoder(enc_hook=_plain)


_MAX_REPLY_BYTES = 64 * 1024 * 1024


class Client:
    """``async with Client("ws://127.0.0.1:8000/ws") as client: reply = await client.render(cameras, pose=pose)``.

    ``avatar`` is one of those that the server offers. ``window`` is the number of pictures under way. ``mirror``
    requests the mirror image. ``height`` and arm ``span`` (metres, from wrist to wrist) are the user's, for tracking.

    ``room`` is the room to enter, ``name`` the user's name there, ``at`` the position: x and z in metres from its
    centre, degrees about y. Without ``at`` the server chooses a free position.

    ``cafile`` is the certificate to trust on wss. ``timeout`` limits the seconds of connecting and of each picture.
    ``adapt`` reports to the server when pictures arrive, so that it fits them to the link. ``video`` accepts video from
    a server that offers it, and needs PyAV.

    A client can connect again after ``close`` or a lost connection; frame_ids then begin at 1, and in a room the user
    is the same person again. It belongs to one event loop, where many tasks may call it. All methods raise
    ProtocolError when the server reports an error or goes away (``code`` "closed", "timeout", ...).
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
        self.url: str = checked_url(url)
        check_token(token)
        mirror = flag(mirror, "mirror", GlsplatError)
        window = None if window is None else count(window, "window", GlsplatError, 1)
        height = None if height is None else number(height, "height", GlsplatError)
        span = None if span is None else number(span, "span", GlsplatError)
        options = {"avatar": avatar, "window": window, "mirror": int(mirror) or None, "height": height, "span": span}
        position = None if at is None else ",".join(f"{number(v, 'at', GlsplatError):g}" for v in _three(at))
        options |= {"room": room, "name": name, "at": position}
        self._query = {key: value for key, value in options.items() if value is not None}
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._cafile, self._adapt = cafile, flag(adapt, "adapt", GlsplatError)
        self._reader: Callable[[], VideoReader | None] = lambda: None
        if flag(video, "video", GlsplatError):
            module = plugin("far_links.video")
            if module is None:
                raise GlsplatError(missing("far_links", "video"))
            module.VideoReader()  # raise its errors now, not when the client connects
            self._reader = module.VideoReader
        self._timeout: float = number(timeout, "timeout", GlsplatError)
        if self._timeout <= 0:
            raise GlsplatError(f"timeout needs seconds above 0, not {self._timeout:g}")
        self._connection: ClientConnection | None = None
        self._resume = ""  # token with which the next connection is the same person in a room

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
        """State of this connection's requests; an empty one before the first connection."""
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
        tls = client_tls(self._cafile) if self._cafile else True
        url = self._address()
        http = aiohttp.ClientSession()
        try:
            async with asyncio.timeout(self._timeout):
                ws = await http.ws_connect(
                    url, headers=self._headers, ssl=tls, max_msg_size=_MAX_REPLY_BYTES, compress=0
                )
        except (aiohttp.ClientError, OSError, TimeoutError) as error:
            refused = isinstance(error, aiohttp.WSServerHandshakeError) and error.status in (400, 403)
            offered = await offered_avatars(http, url, self._headers, tls) if refused else ()
            await http.close()
            raise await not_connected(self.url, error, self._timeout, offered) from None
        except BaseException:
            await http.close()
            raise
        connection = ClientConnection(self.url, http, ws, self._adapt, self._reader())
        if self._ours():  # another task was quicker
            await connection.close()
        else:
            self._connection = connection

    async def close(self) -> None:
        """Close the connection; harmless when there is none. Waiting calls raise ProtocolError."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._resume = connection.resume or self._resume
            if connection.loop is asyncio.get_running_loop():
                await connection.close()

    async def render(
        self,
        cameras: Sequence[Camera] | None = None,
        *,
        pose: Pose | Mapping[str, Any] | None = None,
        tracking: Mapping[str, Any] | None = None,
        **params: Unpack[PictureParams],
    ) -> Reply:
        """Request one picture and wait for it. Concurrent calls are served one after the other.

        Raises ProtocolError with ``code`` "dropped" when a later ``send`` of another task replaced the request: the
        server answers the newest request only.
        """
        connection = self._open()
        async with connection.turn:
            connection.take_all()
            request = self._request(connection, cameras, pose=pose, tracking=tracking, **params)
            return (await connection.request_and_wait(*request, self._timeout)).reply

    async def poses(
        self, *, pose: Pose | Mapping[str, Any] | None = None, tracking: Mapping[str, Any] | None = None
    ) -> Reply:
        """Request poses (``Reply.bodies``) instead of a picture, and wait for them as ``render`` does.

        In a room, only the poses that changed are returned. Raises ProtocolError with ``code`` "no_pose" where the
        avatar's splats are not handed out.
        """
        connection = self._open()
        async with connection.turn:
            connection.take_all()
            request = self._request(connection, None, pose=pose, tracking=tracking, want="pose")
            return (await connection.request_and_wait(*request, self._timeout)).reply

    async def send(
        self,
        cameras: Sequence[Camera] | None = None,
        *,
        pose: Pose | Mapping[str, Any] | None = None,
        tracking: Mapping[str, Any] | None = None,
        want: Want | None = None,
        subject: object = None,
        **params: Unpack[PictureParams],
    ) -> int:
        """Send a request and return its frame_id, without waiting for its picture; ``receive`` returns that.

        A newer request may replace it: then no picture comes. ``subject`` is not sent; ``flow.about(frame_id)`` returns
        it. With ``want`` "pose" poses are requested instead.
        """
        connection = self._open()
        request = self._request(connection, cameras, pose=pose, tracking=tracking, want=want, **params)
        await connection.send_request(*request, subject)
        return request[0]

    async def send_text(self, text: str) -> None:
        """Send ``text`` as a message."""
        await self._open().send_text(text)

    async def acknowledge(self) -> None:
        """Acknowledge the pictures taken, without a request; also keeps a quiet connection alive."""
        await self._open().acknowledge()

    async def receive(self) -> ReceivedReply:
        """Return the next picture of a ``send``; acknowledge it at once when newer requests are under way.

        The newest 8 are kept. Raises the server's errors that no ``render`` waits for.
        """
        return await self._open().next(self._timeout)

    def _address(self) -> str:
        """Return the address of the next connection, with its options."""
        query = urlencode(self._query | ({"resume": self._resume} if self._resume else {}))
        return self.url + (("&" if "?" in self.url else "?") + query if query else "")

    def _request(
        self, connection: ClientConnection, cameras: Sequence[Camera] | None, **fields: Any
    ) -> tuple[int, str, float]:
        """Return the next request: its frame_id, its text, and when it was made, in seconds."""
        now = time.perf_counter()
        number = connection.flow.newest + 1
        message = request_message(number, cameras, t=now * 1e3, **fields)
        message |= connection.flow.acknowledging(now)
        if connection.video is not None and message.get("want") != "pose":
            message["video"] = connection.video.request_fields()
        try:
            data = encoder.encode(message)
        except (TypeError, ValueError, RecursionError) as error:  # JSON cannot hold it
            raise ProtocolError(f"a request cannot be sent: {str(error)[:160]}", "bad_field") from None
        if len(data) > MAX_MESSAGE_BYTES:
            raise ProtocolError(f"a request needs at most {MAX_MESSAGE_BYTES} bytes, not {len(data)}", "too_big")
        return number, data.decode(), now

    def _ours(self) -> bool:
        """Return whether there is an open connection in this event loop."""
        connection = self._connection
        return connection is not None and connection.alive and connection.loop is asyncio.get_running_loop()

    def _open(self) -> ClientConnection:
        if self._connection is None:
            raise ProtocolError(f"{self.url}: not connected; await connect() first", "closed")
        if self._connection.loop is not asyncio.get_running_loop():
            raise ProtocolError(f"{self.url}: connected in another event loop; await connect() in this one", "closed")
        return self._connection


def _three(at: Any) -> Sequence[Any]:
    if isinstance(at, str) or not isinstance(at, Sequence) or len(at) != 3:
        raise GlsplatError(f"at needs x, z in metres and degrees about y, not {at!r:.40}")
    return at
