"""One client's conversation over its WebSocket: messages in, pictures out, until one of the two sides ends it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable
from typing import Any

from aiohttp import WSMsgType, web

from glsplat.errors import ProtocolError
from glsplat.net.client_stream import ClientStream, DatagramTransport, Frame
from glsplat.net.drawer import Drawer
from glsplat.net.feature import PoseResponder
from glsplat.net.guard.access import SUBPROTOCOL
from glsplat.net.guard.gate import Gate, connection_of
from glsplat.net.guard.limits import MessageThrottle
from glsplat.net.guard.meter import POLICY_VIOLATION, Breach
from glsplat.net.messages import MAX_BYTES, Request
from glsplat.net.session import Close, Warn

__all__ = ["Conversation", "cut_off", "make_socket"]

log: logging.Logger = logging.getLogger("glsplat.net")
clock: Callable[[], float] = time.perf_counter  # the render loop's clock too

_TURN = 8  # messages of one client in a row before others are heard
_FAREWELL = 0.5  # seconds a client that broke the rules gets to answer the close, while what it sends is thrown away
_LOST = 1006  # RFC 6455, section 7.4.1: nobody said goodbye


class Conversation:
    """``deaf`` says that the server takes no more requests. ``write_timeout`` seconds a reply may stay unread."""

    def __init__(
        self,
        channel: ClientStream,
        ws: web.WebSocketResponse,
        request: web.Request,
        drawer: Drawer,
        gate: Gate,
        responder: PoseResponder | None,  # None: no client gets poses
        deaf: Callable[[], bool],
        write_timeout: float,
    ) -> None:
        self.channel = channel
        self._ws, self._request, self._drawer, self._gate = ws, request, drawer, gate
        self._responder, self._deaf, self._write_timeout = responder, deaf, write_timeout
        assert channel.share is not None
        self._reading = MessageThrottle(channel.share)

    @property
    def goodbye(self) -> bool:
        """Whether it ended by a close, not by a connection that broke."""
        return self._ws.close_code not in (None, _LOST)

    async def run(self) -> None:
        """Until the client leaves or is put out. Raises ConnectionError, TimeoutError: it neither reads nor listens."""
        self._drawer.add(self.channel)
        writer = asyncio.create_task(self._write())
        try:
            await self._converse(connection_of(self._request).breached)
        finally:
            writer.cancel()
            await asyncio.gather(writer, return_exceptions=True)
            if self.channel.way is not None:
                self.channel.way.close()

    async def close(self, code: int, reason: str) -> None:
        """End it from the server's side."""
        await self._ws.close(code=code, message=reason.encode())

    async def _converse(self, breached: asyncio.Future[Breach]) -> None:
        """Messages of one client until it leaves or is put out."""
        way = self.channel.way
        reading = [asyncio.create_task(self._read())]
        if way is not None:
            reading.append(asyncio.create_task(self._read_datagrams(way)))
        ends: list[asyncio.Future[Any]] = [*reading, breached]
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in reading:
                task.cancel()
            # looked at, or asyncio logs it: the peer may be gone
            await asyncio.gather(*reading, return_exceptions=True)
        if breached.done() and not self._ws.closed:
            await self._farewell(self.channel.session.broke(breached.result()))
        else:
            for task in reading:
                if not task.cancelled():
                    task.result()

    async def _read(self) -> None:
        """Messages of one client until it leaves, is too long silent, or breaks the rules too often."""
        session, reading, count = self.channel.session, self._reading, 0
        while True:
            text: str | None = None
            outcome: Warn | Close | None = None
            now = clock()
            try:
                # not receive(timeout=...): that begins anew with each ping or pong, and leaves out writing the pongs
                async with asyncio.timeout(max(0.01, min(session.expires() - now, reading.wait(now)))):
                    message = await self._ws.receive()
                    if message.type == WSMsgType.PING and not self._ws.closed:
                        await self._ws.pong(message.data)
                        continue
            except TimeoutError:
                text = reading.take()
                if text is None:
                    outcome = session.expired(clock())
            else:
                if message.type == WSMsgType.TEXT:
                    if self._deaf():
                        continue
                    text = reading.offer(message.data, clock())
                elif message.type == WSMsgType.BINARY:
                    error = ProtocolError("a request is a text message (JSON), not a binary one", "binary")
                    outcome = session.malformed(error, clock())
                elif message.type == WSMsgType.PONG:
                    if session.link is not None:
                        session.link.ponged(bytes(message.data), clock())
                        self._drawer.wake(self.channel)
                else:  # closed, or a broken frame that aiohttp has answered (1002, 1007, 1009)
                    return
            if await self._take(text, outcome):
                return
            count += 1
            if count % _TURN == 0:  # receive() does not give way while more has arrived
                await asyncio.sleep(0)

    async def _take(self, text: str | None, outcome: Warn | Close | None = None) -> bool:
        """Read a message that has its turn, or tell what an ``outcome`` without one says; True: that is the end."""
        session = self.channel.session
        heard: Request | Warn | Close | None = outcome
        if text is not None:
            now, worked = clock(), time.thread_time()
            heard = session.receive(text, now)
            # waiting for other threads is not the client's fault, but the loop stands still meanwhile
            self._reading.share.spend(time.thread_time() - worked, clock() - now)
        session.counts.unread = self._reading.left_out
        if isinstance(heard, Warn):
            await self._send(heard.text)
        elif isinstance(heard, Close):
            await self._farewell(heard)
            return True
        elif text is not None:
            if heard is not None:
                for observer in self.channel.observers:
                    observer.request_received(heard)
            self._drawer.received(self.channel, heard)
            self._poses_due()
        return False

    def _poses_due(self) -> None:
        if self._responder is not None:
            self._responder.due(self.channel)

    async def _read_datagrams(self, way: DatagramTransport) -> None:
        """The same of what comes by the second way."""
        while True:
            wait = self._reading.wait(clock())
            try:
                async with asyncio.timeout(None if math.isinf(wait) else max(0.01, wait)):
                    message = await way.message()
            except TimeoutError:
                text = self._reading.take()
            else:
                text = None if self._deaf() else self._reading.offer(message, clock())
            if await self._take(text):
                return
            await asyncio.sleep(0)  # others are heard in between

    async def _farewell(self, close: Close) -> None:
        """Close the connection of a client that broke the rules. Raises TimeoutError if it does not answer."""
        self._drawer.remove(self.channel)
        if close.breach:
            self._gate.breach(self._request, close.reason)
        if close.text:
            await self._send(close.text)
        async with asyncio.timeout(_FAREWELL):  # else it is cut off
            await self._ws.close(code=close.code, message=close.reason.encode())

    async def _write(self) -> None:
        """Pictures of one client, in order. A client that does not read them in time is cut off."""
        session = self.channel.session
        while True:
            frame = await self.channel.frames.get()
            try:
                packed: list[bytes] | str
                posed = frame.poses is not None and self._responder is not None
                if frame.poses is not None and self._responder is not None:
                    packed = self._responder.pack(frame)
                else:
                    packed = await self._drawer.pack(self.channel, frame)
                if not isinstance(packed, str):
                    await self._ping()
                if posed or isinstance(packed, str) or not self._sent_by_datagrams(frame, packed):
                    for data in [packed] if isinstance(packed, str) else packed:
                        await self._send(data)
                    if not (posed or isinstance(packed, str)):
                        await self._ping(frame.request.frame_id)
            except TimeoutError:
                self._gate.notices("unread", "a client does not read its pictures; cut off")
                cut_off(self._request)
                return
            except ConnectionError:
                return
            except Exception:  # a fault of ours: end the connection rather than leave it silent
                log.exception("client %d cannot be answered", self.channel.number)
                cut_off(self._request)
                return
            if not isinstance(packed, str):
                if not session.counts.sent:  # who only knocks fills no log
                    session.announce(self.channel.number, self.channel.address)
                session.sent(frame.request, sum(map(len, packed)))
                for observer in self.channel.observers:
                    observer.reply_sent(packed)
            self._poses_due()
            self._drawer.wake(self.channel)
            if frame.ends:
                with contextlib.suppress(TimeoutError):
                    await self._farewell(Close("", POLICY_VIOLATION, frame.ends, breach=True))
                return cut_off(self._request)

    def _sent_by_datagrams(self, frame: Frame, packed: list[bytes]) -> bool:
        if self.channel.way is None or len(packed) != 1:
            return False
        assert frame.request.frame_id is not None
        return self.channel.way.send(frame.request.frame_id, packed[0])

    async def _ping(self, behind: int | None = None) -> None:
        """Measure the way there and back, where the client's link is looked at: before a picture or ``behind`` it."""
        link = self.channel.session.link
        if link is None or self._ws.closed:
            return
        ping = link.ping(clock()) if behind is None else link.follow(behind)
        if ping is not None and not (behind is None and self.channel.way is not None and self.channel.way.ping(ping)):
            meter = connection_of(self._request).meter
            if meter is not None:
                meter.expect_answer(clock())
            async with asyncio.timeout(self._write_timeout):
                await self._ws.ping(ping)

    async def _send(self, data: str | bytes) -> None:
        if self._ws.closed:
            return
        async with asyncio.timeout(self._write_timeout):
            await (self._ws.send_str(data) if isinstance(data, str) else self._ws.send_bytes(data))


def make_socket(heartbeat: float, timeout: float) -> web.WebSocketResponse:
    """The server's side of a WebSocket: seconds between pings, and for whatever a client has to answer."""
    return web.WebSocketResponse(
        compress=False,  # JPEG does not shrink, and deflating it costs 4 to 6 ms a reply
        max_msg_size=MAX_BYTES + 1,  # aiohttp refuses messages of the size it is given
        heartbeat=heartbeat,
        autoping=False,  # answers to pings measure links
        timeout=timeout,
        protocols=(SUBPROTOCOL,),
    )


def cut_off(request: web.Request) -> None:
    """End a connection at once."""
    connection_of(request).abort()
