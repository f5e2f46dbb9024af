"""Conversation: reads a client's messages from its WebSocket and sends the replies, until either side ends it."""

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
from glsplat.net.client_stream import ClientStream, DatagramTransport, Outgoing, PoseAnswer
from glsplat.net.drawer import Drawer
from glsplat.net.feature import PoseResponder
from glsplat.net.guard.access import SUBPROTOCOL
from glsplat.net.guard.gate import Gate, connection_of
from glsplat.net.guard.limits import MessageThrottle
from glsplat.net.guard.meter import POLICY_VIOLATION, Breach
from glsplat.net.messages import MAX_MESSAGE_BYTES, Request
from glsplat.net.session import Close, Warn

log: logging.Logger = logging.getLogger("glsplat.net")

_MAX_IN_A_ROW = 8  # messages of one client before others are read
_FAREWELL_S = 0.5  # for a client that broke a limit to answer the close; its messages are dropped
_LOST = 1006  # RFC 6455, section 7.4.1: no close frame was received


class Conversation:
    """One client's connection.

    ``is_draining`` returns whether the server drops requests. A reply may stay unread for ``write_timeout`` seconds.
    """

    def __init__(
        self,
        client: ClientStream,
        ws: web.WebSocketResponse,
        request: web.Request,
        drawer: Drawer,
        gate: Gate,
        responder: PoseResponder | None,  # None: no client gets poses
        is_draining: Callable[[], bool],
        write_timeout: float,
    ) -> None:
        self.client = client
        self._ws, self._request, self._drawer, self._gate = ws, request, drawer, gate
        self._clock = drawer.clock
        self._responder, self._is_draining, self._write_timeout = responder, is_draining, write_timeout
        assert client.share is not None
        self._reading = MessageThrottle(client.share)

    @property
    def goodbye(self) -> bool:
        """True after the connection was closed in order; False if it broke."""
        return self._ws.close_code not in (None, _LOST)

    async def run(self) -> None:
        """Run until either side ends the connection. Raises ConnectionError or TimeoutError if the client is gone."""
        self._drawer.add(self.client)
        writer = asyncio.create_task(self._write())
        try:
            await self._converse(connection_of(self._request).breached)
        finally:
            writer.cancel()
            await asyncio.gather(writer, return_exceptions=True)
            if self.client.datagrams is not None:
                self.client.datagrams.close()

    async def close(self, code: int, reason: str) -> None:
        """Close the connection from the server's side."""
        await self._ws.close(code=code, message=reason.encode())

    async def _converse(self, breached: asyncio.Future[Breach]) -> None:
        """Read messages until the client leaves or breaks a limit."""
        reading = [asyncio.create_task(self._read())]
        if self.client.datagrams is not None:
            reading.append(asyncio.create_task(self._read_datagrams(self.client.datagrams)))
        ends: list[asyncio.Future[Any]] = [*reading, breached]
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in reading:
                task.cancel()
            # errors are retrieved, or asyncio logs them: the peer may be gone
            await asyncio.gather(*reading, return_exceptions=True)
        if breached.done() and not self._ws.closed:
            await self._farewell(self.client.session.broke(breached.result()))
        else:
            for task in reading:
                if not task.cancelled():
                    task.result()

    async def _read(self) -> None:
        """Read the WebSocket's messages until the client leaves, is silent for too long, or breaks a limit."""
        session, reading, count = self.client.session, self._reading, 0
        while True:
            text: str | None = None
            outcome: Warn | Close | None = None
            now = self._clock()
            try:
                # receive(timeout=...) would restart with each ping or pong, and not cover the writing of pongs
                async with asyncio.timeout(max(0.01, min(session.expires() - now, reading.wait(now)))):
                    message = await self._ws.receive()
                    if message.type == WSMsgType.PING and not self._ws.closed:
                        await self._ws.pong(message.data)
                        continue
            except TimeoutError:
                text = reading.take()
                if text is None:
                    outcome = session.expired(self._clock())
            else:
                if message.type == WSMsgType.TEXT:
                    if self._is_draining():
                        continue
                    try:
                        if not self._relayed(message.data):
                            text = reading.offer(message.data, self._clock())
                    except ProtocolError as refused:
                        outcome = session.malformed(refused, self._clock())
                elif message.type == WSMsgType.BINARY:
                    error = ProtocolError("a request is a text message (JSON), not a binary one", "binary")
                    outcome = session.malformed(error, self._clock())
                elif message.type == WSMsgType.PONG:
                    if session.link is not None:
                        session.link.ponged(bytes(message.data), self._clock())
                        self.client.wake()
                else:  # closed, or a malformed frame that aiohttp has answered (1002, 1007, 1009)
                    return
            if await self._take(text, outcome):
                return
            count += 1
            if count % _MAX_IN_A_ROW == 0:  # receive() does not yield while more has arrived
                await asyncio.sleep(0)

    def _relayed(self, text: str) -> bool:
        """Return whether a message was one to other clients, which is not throttled. Raises ProtocolError."""
        worked = time.thread_time()
        try:
            return self.client.relay is not None and self.client.relay(text)
        finally:
            self._reading.share.spend(time.thread_time() - worked)

    async def _take(self, text: str | None, outcome: Warn | Close | None = None) -> bool:
        """Decode a message, or handle an ``outcome`` without one; return True where the conversation ends."""
        session = self.client.session
        received: Request | Warn | Close | None = outcome
        if text is not None:
            now, worked = self._clock(), time.thread_time()
            received = session.receive(text, now)
            # charge CPU time; waiting for other threads is not the client's fault, but it blocks the event loop
            self._reading.share.spend(time.thread_time() - worked, self._clock() - now)
        session.counts.unread = self._reading.left_out
        if isinstance(received, Warn):
            await self._send(received.text)
        elif isinstance(received, Close):
            await self._farewell(received)
            return True
        elif text is not None:
            if received is not None:
                for observer in self.client.observers:
                    observer.request_received(received)
            self.client.received(received, self._clock())
            self._poses_due()
        return False

    def _poses_due(self) -> None:
        if self._responder is not None:
            self._responder.due(self.client)

    async def _read_datagrams(self, datagrams: DatagramTransport) -> None:
        """Read the messages that arrive by datagrams."""
        while True:
            wait = self._reading.wait(self._clock())
            try:
                async with asyncio.timeout(None if math.isinf(wait) else max(0.01, wait)):
                    message = await datagrams.message()
            except TimeoutError:
                text = self._reading.take()
            else:
                text = None if self._is_draining() else self._reading.offer(message, self._clock())
            if await self._take(text):
                return
            await asyncio.sleep(0)  # let other clients be read

    async def _farewell(self, close: Close) -> None:
        """Close the connection of a client that broke a limit. Raises TimeoutError where it does not answer."""
        self._drawer.remove(self.client)
        if close.breach:
            self._gate.breach(self._request, close.reason)
        if close.text:
            await self._send(close.text)
        async with asyncio.timeout(_FAREWELL_S):
            await self._ws.close(code=close.code, message=close.reason.encode())

    async def _write(self) -> None:
        """Send answers in order. A client that does not read them in time is cut off."""
        session = self.client.session
        while True:
            answer = await self.client.answers.get()
            try:
                if isinstance(answer, str):
                    await self._send(answer)
                    continue
                if isinstance(answer, PoseAnswer):
                    assert self._responder is not None
                    outgoing = self._responder.pack(answer)
                else:
                    outgoing = await self._drawer.pack(self.client, answer)
                await self._send_reply(outgoing, isinstance(answer, PoseAnswer))
            except TimeoutError:
                self._gate.notices("unread", "a client does not read its pictures; cut off")
                cut_off(self._request)
                return
            except ConnectionError:
                return
            except Exception:  # a fault of the server: a silent connection would be worse than none
                log.exception("client %d cannot be answered", self.client.number)
                cut_off(self._request)
                return
            if outgoing.messages:
                if not session.counts.sent:  # with the first picture: clients without one must not fill the log
                    session.announce(self.client.number, self.client.address)
                session.sent(outgoing.request, sum(map(len, outgoing.messages)))
                for observer in self.client.observers:
                    observer.reply_sent(outgoing.messages)
            self._poses_due()
            self.client.wake()
            if outgoing.ends:
                with contextlib.suppress(TimeoutError):
                    await self._farewell(Close("", POLICY_VIOLATION, outgoing.ends, breach=True))
                return cut_off(self._request)

    async def _send_reply(self, outgoing: Outgoing, poses: bool) -> None:
        """Send a reply, a picture between two pings that measure the link."""
        if outgoing.error:
            return await self._send(outgoing.error)
        await self._ping()
        if not poses and self._sent_by_datagrams(outgoing):
            return
        for data in outgoing.messages:
            await self._send(data)
        if not poses:
            await self._ping(outgoing.request.frame_id)

    def _sent_by_datagrams(self, outgoing: Outgoing) -> bool:
        if self.client.datagrams is None or len(outgoing.messages) != 1:
            return False
        assert outgoing.request.frame_id is not None
        return self.client.datagrams.send(outgoing.request.frame_id, outgoing.messages[0])

    async def _ping(self, behind: int | None = None) -> None:
        """Send a ping before a picture or ``behind`` it, if the client's link is measured."""
        link = self.client.session.link
        if link is None or self._ws.closed:
            return
        ping = link.ping(self._clock()) if behind is None else link.follow(behind)
        datagrams = None if behind is not None else self.client.datagrams
        if ping is not None and not (datagrams is not None and datagrams.ping(ping)):
            meter = connection_of(self._request).meter
            if meter is not None:
                meter.expect_answer(self._clock())
            async with asyncio.timeout(self._write_timeout):
                await self._ws.ping(ping)

    async def _send(self, data: str | bytes) -> None:
        if self._ws.closed:
            return
        async with asyncio.timeout(self._write_timeout):
            await (self._ws.send_str(data) if isinstance(data, str) else self._ws.send_bytes(data))


def make_socket(heartbeat: float, timeout: float) -> web.WebSocketResponse:
    """Return the server's side of a WebSocket: seconds between pings, and until a client has to answer."""
    return web.WebSocketResponse(
        compress=False,  # JPEG does not shrink, and deflating it takes 4 to 6 ms a reply
        max_msg_size=MAX_MESSAGE_BYTES + 1,  # aiohttp refuses messages of the size it is given
        heartbeat=heartbeat,
        autoping=False,  # this module handles pongs: they measure links
        timeout=timeout,
        protocols=(SUBPROTOCOL,),
    )


def cut_off(request: web.Request) -> None:
    """End a connection at once."""
    connection_of(request).abort()
