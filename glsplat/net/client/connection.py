"""One connection of a client: a task reads what the server sends and hands each answer to the one who waits for it.

What a message answers and makes pointless is flow.py's. Whoever waits for a picture that will never come is told so at
once instead of waiting in vain.
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

__all__ = ["ClientConnection", "VideoReader"]


class VideoReader(Protocol):
    """Decodes the video of one connection (extras/far_links)."""

    def wish(self) -> dict[str, Any]:
        """Return ``video`` of the next request."""
        ...

    def eyes(self, data: bytes, said: Mapping[str, Any], size: Any) -> tuple[NDArray[np.uint8], ...]:
        """Return the pictures [H, W, 3 or 4] of a reply, left first; none where they cannot be decoded."""
        ...


_UNREAD = 8  # pictures kept for receive(), the newest; the largest window of a server
_GOODBYE = 1.0  # seconds for a server to agree to the end of a TLS connection


class ClientConnection:
    """An open WebSocket and what is under way on it. Belongs to the event loop that made it.

    ``adapt`` tells the server when pictures arrive, so that one that adapts fits them to the link. ``video`` decodes
    what is part of one.
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
        self.turn = asyncio.Lock()  # of those who ask for one picture and wait for it
        self.flow: FlowControl = FlowControl()
        self.video = video
        self.resume = ""  # token of a room, by which the next connection comes back as the same person
        self._url, self._adapt = url, adapt
        self._http, self._ws = http, ws
        self._socket = ws.get_extra_info("socket")
        self._waiting: dict[int, asyncio.Future[ReceivedReply]] = {}
        self._unread: deque[ReceivedReply | ProtocolError] = deque(maxlen=_UNREAD)
        self._news = asyncio.Event()
        self._failure: ProtocolError | None = None
        self._task = asyncio.create_task(self._read(), name="glsplat client")

    @property
    def alive(self) -> bool:
        """False once the server has gone away or the connection was closed."""
        return self._failure is None

    async def close(self) -> None:
        """Wake all who wait, with an error, and close the socket."""
        self._fail(ProtocolError(f"{self._url}: the client was closed", "closed"))
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        await self._ws.close()
        await self._http.close()
        await self._until_closed()

    async def ask(self, frame_id: int, text: str, now: float, subject: object = None) -> None:
        """Send a request, whose picture will come by ``next``, if it comes."""
        self.flow.ask(frame_id, now, subject)
        try:
            await self.send_text(text)
        except ProtocolError:
            self.flow.unsent(frame_id)
            raise

    async def send_text(self, text: str) -> None:
        """Raises ProtocolError when the connection has ended."""
        if self._failure is not None:
            raise self._ended()
        try:
            await self._ws.send_str(text)
        except (ConnectionError, aiohttp.ClientError):
            raise ProtocolError(f"{self._url}: the server closed the connection", "closed") from None

    async def acknowledge(self) -> None:
        """Tell the server what was taken."""
        await self.send_text(self.flow.acknowledgement(time.perf_counter()))

    def take_all(self) -> None:
        """Acknowledge, with the next message, also what receive() has not taken: a full window would hold it back."""
        for item in self._unread:
            if isinstance(item, ReceivedReply):
                self.flow.take(item.reply.frame_id)

    async def ask_and_wait(self, frame_id: int, text: str, now: float, timeout: float) -> ReceivedReply:
        """Send a request and wait for its picture. Raises the server's error, or one that says it was replaced."""
        future = self._waiting[frame_id] = self.loop.create_future()  # before sending: the answer may be quick
        try:
            await self.ask(frame_id, text, now)
            async with asyncio.timeout(timeout):
                return await future
        except TimeoutError:
            text = f"{self._url}: no picture for request {frame_id} within {timeout:g} s"
            if self.flow.newest > frame_id:
                text += f"; a newer one ({self.flow.newest}) may have replaced it"
            if self.flow.said:
                text += f"; the server said: {self.flow.said}"
            raise ProtocolError(text, "timeout", frame_id) from None
        finally:
            del self._waiting[frame_id]
            self.flow.leave(frame_id)
            if future.done() and not future.cancelled():
                future.exception()  # looked at, also where nobody awaits it any more

    async def next(self, timeout: float) -> ReceivedReply:
        """The next picture nobody waits for by its number; acknowledged at once when newer requests are under way."""
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
        """Over TLS a transport closes when the server has agreed, which aiohttp does not wait for; or without it."""
        if self._socket is None:
            return
        for _ in range(2):
            with suppress(TimeoutError):
                async with asyncio.timeout(_GOODBYE):
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
        except ProtocolError as error:  # no reply, or nobody to acknowledge it to
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
            if not self._waiting:  # else it must not hold back the picture that is waited for
                return
        if self.flow.take(answer.frame_id):
            await self.acknowledge()

    def _refused(self, error: ProtocolError) -> None:
        """The server's error about one request; without a number, it is about what is waited for."""
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
        """Tell those who wait for requests that will never be answered."""
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
        """A new one for each that waits: an exception that is raised twice carries two tracebacks."""
        assert self._failure is not None
        return ProtocolError(str(self._failure), self._failure.code)
