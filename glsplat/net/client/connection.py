"""ClientConnection: sends requests, and hands each answer to the call that waits for it (flow.py matches them).

A call whose request was replaced raises at once instead of waiting for its timeout.
"""

from __future__ import annotations

import asyncio
import socket
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

import aiohttp
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ProtocolError
from glsplat.net.flow import FlowControl, ReceivedReply, server_error
from glsplat.net.reply import Reply, parse_reply


class VideoReader(Protocol):
    """Decodes the video of one connection (extras/far_links)."""

    def request_fields(self) -> dict[str, Any]:
        """Return ``video`` of the next request."""

    def eyes(self, data: bytes, video: Mapping[str, Any], size: Any) -> tuple[NDArray[np.uint8], ...]:
        """Return the pictures [H, W, 3 or 4] of a reply with that ``video``, left first; none if undecodable."""


_MAX_UNREAD = 8  # pictures kept for receive(): the largest window of a server
_GOODBYE_S = 1.0  # for a server to close its side of a TLS connection


class ClientConnection:
    """An open WebSocket and its requests. Belongs to the event loop that made it.

    ``adapt`` reports to the server when pictures arrive. ``video`` decodes pictures of a video.
    """

    def __init__(
        self,
        url: str,
        http: aiohttp.ClientSession,
        ws: aiohttp.ClientWebSocketResponse,
        adapt: bool = False,
        video: VideoReader | None = None,
    ) -> None:
        self.loop = asyncio.get_running_loop()
        self.turn = asyncio.Lock()  # one call at a time waits for its picture
        self.flow: FlowControl = FlowControl()
        self.video = video
        self.resume = ""  # token with which the next connection is the same person in a room
        self._url, self._adapt = url, adapt
        self._http, self._ws = http, ws
        self._socket = ws.get_extra_info("socket")
        self._waiting: dict[int, asyncio.Future[ReceivedReply]] = {}
        self._unread: deque[ReceivedReply | ProtocolError] = deque(maxlen=_MAX_UNREAD)
        self._news = asyncio.Event()
        self._failure: ProtocolError | None = None
        self._task = asyncio.create_task(self._read(), name="glsplat client")

    @property
    def alive(self) -> bool:
        """False once the server has gone away or the connection was closed."""
        return self._failure is None

    async def close(self) -> None:
        """Fail all waiting calls and close the socket."""
        self._fail(ProtocolError(f"{self._url}: the client was closed", "closed"))
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        await self._ws.close()
        await self._http.close()
        await self._until_closed()

    async def send_request(self, frame_id: int, text: str, now: float, subject: object = None) -> None:
        """Send a request whose picture ``next`` returns. Raises ProtocolError."""
        self.flow.request(frame_id, now, subject)
        try:
            await self.send_text(text)
        except ProtocolError:
            self.flow.unsent(frame_id)
            raise

    async def send_text(self, text: str) -> None:
        """Send ``text``. Raises ProtocolError when the connection has ended."""
        if self._failure is not None:
            raise self._ended()
        try:
            await self._ws.send_str(text)
        except (ConnectionError, aiohttp.ClientError):
            raise ProtocolError(f"{self._url}: the server closed the connection", "closed") from None

    async def acknowledge(self) -> None:
        """Acknowledge the pictures taken."""
        await self.send_text(self.flow.acknowledgement(time.perf_counter()))

    def take_all(self) -> None:
        """Let the next message acknowledge the unread pictures, too: a full window would hold its picture back."""
        for item in self._unread:
            if isinstance(item, ReceivedReply):
                self.flow.take(item.reply.frame_id)

    async def request_and_wait(self, frame_id: int, text: str, now: float, timeout: float) -> ReceivedReply:
        """Send a request and wait for its picture. Raises ProtocolError, also where the request was replaced."""
        future = self._waiting[frame_id] = self.loop.create_future()  # before sending: the answer may be quick
        try:
            await self.send_request(frame_id, text, now)
            async with asyncio.timeout(timeout):
                return await future
        except TimeoutError:
            text = f"{self._url}: no picture for request {frame_id} within {timeout:g} s"
            if self.flow.newest > frame_id:
                text += f"; a newer one ({self.flow.newest}) may have replaced it"
            if self.flow.last_error:
                text += f"; the server said: {self.flow.last_error}"
            raise ProtocolError(text, "timeout", frame_id) from None
        finally:
            del self._waiting[frame_id]
            self.flow.leave(frame_id)
            if future.done() and not future.cancelled():
                future.exception()  # retrieved, or asyncio logs it where nobody awaits it

    async def next(self, timeout: float) -> ReceivedReply:
        """Return the next unread picture; acknowledge it at once when newer requests are under way."""
        try:
            async with asyncio.timeout(timeout):
                while not self._unread:
                    if self._failure is not None:
                        raise self._ended()
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise ProtocolError(f"{self._url}: no picture within {timeout:g} s", "timeout") from None
        item = self._unread.popleft()
        if isinstance(item, ProtocolError):
            raise item
        if self.flow.take(item.reply.frame_id) and self._failure is None:
            await self.acknowledge()
        return item

    async def _until_closed(self) -> None:
        """Wait until the socket is closed: over TLS that takes the server's answer, which aiohttp does not await."""
        if self._socket is None:
            return
        for _ in range(2):
            with suppress(TimeoutError):
                async with asyncio.timeout(_GOODBYE_S):
                    while self._socket.fileno() >= 0:
                        await asyncio.sleep(0.005)
                return
            with suppress(OSError):  # closed just now
                self._socket.shutdown(socket.SHUT_RDWR)  # the transport reads the end and closes

    # ------------------------------------------------------------------------------------------------- the reader

    async def _read(self) -> None:
        failure = ProtocolError(f"{self._url}: the server closed the connection", "closed")
        try:
            while True:
                message = await self._ws.receive()
                if message.type == aiohttp.WSMsgType.TEXT:
                    self._refused(server_error(message.data))
                elif message.type == aiohttp.WSMsgType.BINARY:
                    reply, at = parse_reply(message.data), time.perf_counter()
                    if self.video is not None and "video" in reply.info and reply.pictures:
                        coded = next(iter(reply.pictures.values()))
                        how = coded, reply.info["video"], reply.info.get("size")
                        reply = replace(reply, video=await asyncio.to_thread(self.video.eyes, *how))
                    await self._arrived(reply, at)
                else:
                    why = "" if self._ws.close_code is None else f" ({self._ws.close_code})"
                    failure = ProtocolError(f"{self._url}: the server closed the connection{why}", "closed")
                    return
        except ProtocolError as error:  # a malformed reply, or the connection ended
            failure = error
        finally:
            self._fail(failure)

    async def _arrived(self, reply: Reply, at: float) -> None:
        if isinstance(room := reply.info.get("room"), dict):
            self.resume = str(room.get("resume") or self.resume)
        answer = self.flow.arrived(reply.frame_id, at if self._adapt else None)
        if answer.frame_id is None:
            return
        self._drop(answer.replaced, answer.frame_id)
        arrived, future = ReceivedReply(reply, at, answer.requested), self._waiting.get(answer.frame_id)
        if future is not None:
            if not future.done():
                future.set_result(arrived)
        elif answer.wanted:
            self._unread.append(arrived)
            self._news.set()
            if not self._waiting:  # else an unread picture would fill the window of the one that is awaited
                return
        if self.flow.take(answer.frame_id):
            await self.acknowledge()

    def _refused(self, error: ProtocolError) -> None:
        """Hand an error to the call it concerns: without a frame_id, the oldest that waits."""
        answer = self.flow.failed(error, next(iter(self._waiting), None))
        future = None
        if answer.frame_id is not None:
            self._drop(answer.replaced, answer.frame_id)
            future = self._waiting.get(answer.frame_id)
        if future is not None:
            if not future.done():
                future.set_exception(error)
        elif answer.wanted:
            self._unread.append(error)
            self._news.set()

    def _drop(self, replaced: tuple[int, ...], number: int) -> None:
        """Fail the calls whose requests ``number`` replaced."""
        for old in replaced:
            future = self._waiting.get(old)
            if future is not None and not future.done():
                text = (
                    f"{self._url}: request {old} was dropped for a newer one ({number}); send() or render(), not both"
                )
                future.set_exception(ProtocolError(text, "dropped", old))

    def _fail(self, failure: ProtocolError) -> None:
        if self._failure is not None:
            return
        self._failure = failure
        self.flow.end()
        for future in self._waiting.values():
            if not future.done():
                future.set_exception(self._ended())
        self._news.set()

    def _ended(self) -> ProtocolError:
        """Return a new error for each call: an exception that is raised twice carries two tracebacks."""
        assert self._failure is not None
        return ProtocolError(str(self._failure), self._failure.code)
