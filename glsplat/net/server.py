"""The server: aiohttp on one port for the WebSocket (/ws) and the pages (pages/).

Glue only: what a message means is session.py's, who may connect is access.py's, who is drawn next is pump.py's.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from aiohttp import WSMsgType, web

from glsplat.errors import ProtocolError
from glsplat.net.backend import Backend, Offered
from glsplat.net.guard.access import SUBPROTOCOL, Access, server_tls
from glsplat.net.guard.door import Door, connection_of
from glsplat.net.guard.limits import Budget, Limits, Purse
from glsplat.net.guard.listener import bind
from glsplat.net.guard.meter import POLICY_VIOLATION, Breach
from glsplat.net.guard.reading import Reading
from glsplat.net.messages import MAX_BYTES, Decoder, WireOptions
from glsplat.net.options import client_options
from glsplat.net.pages.offers import Offers
from glsplat.net.pages.routes import Pages
from glsplat.net.pump import Channel, FramePump
from glsplat.net.session import GOING_AWAY, Close, Counts, Session, SessionConfig, Warn
from glsplat.net.uploads.routes import Uploads

__all__ = ["Server", "ServerConfig"]

log: logging.Logger = logging.getLogger("glsplat.net")
clock: Callable[[], float] = time.perf_counter  # the pump's clock too

_HOPELESS = 2.0  # seconds after which a picture is not waited for when the server stops
_TURN = 8  # messages of one client in a row before others are heard
_FAREWELL = 0.5  # seconds a client that broke the rules gets to answer the close, while what it sends is thrown away
_ALWAYS = {"X-Content-Type-Options": "nosniff", "Server": "glsplat"}
_UNLESS_SAID = {"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'", "Cache-Control": "no-store"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerConfig:
    """Everything a server is told before it starts."""

    access: Access = field(default_factory=Access)
    port: int = 8000  # 0: any free one
    tls: tuple[Path, Path] | None = None  # certificate and key, PEM
    wire: WireOptions = field(default_factory=WireOptions)
    session: SessionConfig = field(default_factory=SessionConfig)
    limits: Limits = field(default_factory=Limits)
    max_clients: int = 8
    heartbeat: float = 15.0  # seconds between pings; half of it without a pong ends the connection
    write_timeout: float = 2.0  # seconds a client may leave a reply unread
    drain_timeout: float = 3.0  # seconds that pictures under way get at the end
    scene: str = "avatar"  # for the status page
    fps: float | None = None  # pictures a second that each client gets, with less detail if need be; None: as it comes


class Server:
    """Streams what ``backend`` draws: the first of ``offered``, or the one that a client names in its address.

    ``uploads`` lets clients add to those; ``backend`` then has to draw what lies in its folder, too.
    """

    def __init__(
        self,
        backend: Backend,
        config: ServerConfig | None = None,
        offered: Sequence[Offered] = (Offered(name="default"),),
        uploads: Uploads | None = None,
    ) -> None:
        self.config: ServerConfig = config or ServerConfig()
        self.pump: FramePump = FramePump(backend, rate=self.config.fps)
        self.port: int = self.config.port
        limits = self.config.limits
        if uploads is not None:
            limits = replace(limits, head=max(limits.head, limits.body))
        self.door: Door = Door(self.config.access, limits, self.config.max_clients, clock)
        self._work = Budget(limits.work, clock())
        self._offers = Offers(offered)
        self._uploads = uploads
        self._channels: dict[int, Channel] = {}
        self._sockets: dict[int, tuple[web.WebSocketResponse, web.Request]] = {}
        self._totals = Counts()
        self._numbers = 0
        self._draining = False
        self._started = clock()
        self._runner: web.AppRunner | None = None

    @property
    def url(self) -> str:
        """The WebSocket's address."""
        host = self.config.access.host
        return f"{'wss' if self.config.tls else 'ws'}://{f'[{host}]' if ':' in host else host}:{self.port}/ws"

    async def start(self) -> None:
        """Bind, open the backend, then accept clients. Raises GlsplatError (port in use, files, no OpenGL)."""
        tls = server_tls(*self.config.tls) if self.config.tls else None
        listening = bind(self.config.access.host, self.config.port)
        self.port = listening.getsockname()[1]
        try:
            await self.pump.start()
        except BaseException:
            listening.close()
            raise
        app = web.Application(middlewares=[self.door.guard], client_max_size=MAX_BYTES)
        pages = Pages(self.stats, self.offer, lambda: self.pump.healthy and not self._draining, tls is not None)
        app.add_routes([web.get("/ws", self._websocket), *pages.routes()])
        if self._uploads is not None:
            app.add_routes(self._uploads.open(self.door, self._offers.add, self._withdraw))
        app.on_response_prepare.append(_set_headers)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=self.config.drain_timeout)
        await self._runner.setup()
        assert self._runner.server is not None
        cert = None if self.config.tls is None else self.config.tls[0]
        self.door.open(self._runner.server, listening, tls, cert, self.config.session.handshake)
        self._started = clock()

    async def stop(self) -> None:
        """Take no more requests, send the pictures under way, close the clients (1001), end the threads."""
        self._draining = True
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self.config.drain_timeout):
                channels = self._channels.values()
                while self.pump.drawing_for < _HOPELESS and any(c.session.status()["under_way"] for c in channels):
                    await asyncio.sleep(0.01)
        sockets = [ws.close(code=GOING_AWAY, message=b"the server stops") for ws, _ in self._sockets.values()]
        await asyncio.gather(*sockets, return_exceptions=True)
        await self.door.close()
        if self._uploads is not None:
            await self._uploads.stop()
        if self._runner is not None:
            await self._runner.cleanup()
        await self.pump.stop()

    async def run(self, started: Callable[[], None] | None = None) -> None:
        """Serve until SIGINT or SIGTERM, then stop in order; a second signal ends the process at once.

        ``started`` is called once clients can connect. Raises ContextError, after stopping, when the OpenGL context
        is lost and cannot be made again.
        """
        done = asyncio.Event()
        loop = asyncio.get_running_loop()

        def on_signal() -> None:
            if done.is_set():
                os._exit(1)  # the driver may hang in the render thread, which cannot be stopped
            done.set()

        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(NotImplementedError, ValueError):  # not on Windows, not off the main thread
                loop.add_signal_handler(number, on_signal)
        await self.start()
        try:
            if started is not None:
                started()
            ends = [asyncio.create_task(done.wait()), asyncio.create_task(self.pump.ended())]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await self.stop()
        if not done.is_set():
            ends[1].result()

    def stats(self) -> dict[str, Any]:
        """The numbers of /stats."""
        clients, totals = [], asdict(self._totals)
        for number, channel in self._channels.items():
            status = channel.session.status()
            form, size = channel.session.last_form, channel.session.last_size
            clients.append({"id": number, "form": form, "size": f"{size[0]}x{size[1]}", **status})
            for name in totals:
                totals[name] += status[name]
        return {
            "scene": self.config.scene,
            "driver": self.pump.driver,
            "healthy": self.pump.healthy,
            "uptime": round(clock() - self._started, 1),
            "fps": round(self.pump.stages.fps(), 2),
            "max_clients": self.config.max_clients,
            "token": self.config.access.token is not None,
            **self.door.status(),
            "rebuilds": self.pump.rebuilds,
            "uploads": None if self._uploads is None else self._uploads.counts(),
            "totals": totals,
            "stages": self.pump.stages.summary(),
            "clients": clients,
        }

    def offer(self) -> dict[str, Any]:
        """What /session says of the scene and of the server: all that a client chooses from before it connects."""
        most, wire = self.config.max_clients, self.config.wire
        return {
            "avatars": self._offers.fields(),
            "upload": None if self._uploads is None else self._uploads.offer(),
            "max_side": wire.max_side,
            "size": wire.size,
            "quality": wire.quality,
            "window": self.config.session.window,
            "clients": len(self._channels),
            "max_clients": most,
            "full": len(self._channels) >= most,
            "driver": self.pump.driver,
        }

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if self._draining or len(self._channels) >= self.config.max_clients:
            self.door.refused += 1
            text = f"the server is full ({self.config.max_clients} clients); try again later\n"
            return web.Response(status=503, text=text, headers={"Retry-After": "5"})
        ws = self._make_socket()
        entered = self.door.enter(request, ws)
        if isinstance(entered, web.Response):
            return entered
        try:
            channel = self._open_channel(request, entered)
        except ProtocolError as error:
            self.door.leave(request, entered)
            return web.Response(status=400, text=f"{error}\n")
        writer: asyncio.Task[None] | None = None
        try:
            await ws.prepare(request)
            self._sockets[channel.number] = ws, request
            self.pump.add(channel)
            writer = asyncio.create_task(self._write(channel, ws, request))
            await self._converse(channel, ws, connection_of(request).breached)
            return ws
        except (ConnectionError, TimeoutError):  # it neither reads nor listens
            _cut_off(request)
            if not ws.prepared:  # gone before its handshake was answered: aiohttp would close what never opened
                return web.Response(status=400)
            return ws
        finally:
            self._close_channel(channel)
            self.door.leave(request, entered)
            if writer is not None:
                writer.cancel()
                await asyncio.gather(writer, return_exceptions=True)

    def _make_socket(self) -> web.WebSocketResponse:
        return web.WebSocketResponse(
            compress=False,  # JPEG does not shrink, and deflating it costs 4 to 6 ms a reply
            max_msg_size=MAX_BYTES + 1,  # aiohttp refuses messages of the size it is given
            heartbeat=self.config.heartbeat,
            timeout=self.config.write_timeout,
            protocols=(SUBPROTOCOL,),
        )

    def _open_channel(self, request: web.Request, purse: Purse) -> Channel:
        """A new client with the options of its address: /ws?avatar=ann&mirror=1&window=3&height=1.75."""
        asked = client_options(request.query, self.config.wire, self.config.session, self._offers.names)
        one = self._offers[asked.avatar]
        solver = None if one.solver is None else one.solver(asked.height, asked.span)
        self._numbers += 1
        session = Session(Decoder(asked.wire, one.skeleton, one.name, one.parts), asked.session, clock())
        channel = self.pump.open(self._numbers, session, solver, connection_of(request).key, one)
        channel.share = self._work.open(clock(), channel.address)
        if channel.solving is not None:
            channel.solving.share, channel.solving.samples = channel.share, purse.samples
        self._channels[channel.number] = channel
        session.announce(channel.number, channel.address)
        return channel

    async def _withdraw(self, name: str) -> bool:
        """Offer an avatar no more and end the connections that show it; False where it was not offered."""
        there = self._offers.remove(name)
        shown = [ws for ws, request in self._sockets.values() if request.query.get("avatar") == name]
        closing = (ws.close(code=GOING_AWAY, message=b"this avatar is deleted") for ws in shown)
        await asyncio.gather(*closing, return_exceptions=True)
        return there

    def _close_channel(self, channel: Channel) -> None:
        self.pump.remove(channel)
        if channel.share is not None:
            self._work.close(channel.share)
        self._sockets.pop(channel.number, None)
        del self._channels[channel.number]
        for name, value in asdict(channel.session.counts).items():
            setattr(self._totals, name, getattr(self._totals, name) + value)

    async def _converse(self, channel: Channel, ws: web.WebSocketResponse, breached: asyncio.Future[Breach]) -> None:
        """Messages of one client until it leaves or is put out."""
        reading = asyncio.create_task(self._read(channel, ws))
        ends: list[asyncio.Future[Any]] = [reading, breached]
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)  # looked at, or asyncio logs it: the peer may be gone
        if breached.done() and not ws.closed:
            await self._farewell(channel, ws, channel.session.broke(breached.result()))
        elif not reading.cancelled():
            reading.result()

    async def _read(self, channel: Channel, ws: web.WebSocketResponse) -> None:
        """Messages of one client until it leaves, is too long silent, or breaks the rules too often."""
        assert channel.share is not None
        reading = Reading(channel.share)
        session, count = channel.session, 0
        while True:
            text: str | None = None
            outcome: Warn | Close | None = None
            now = clock()
            try:
                # not receive(timeout=...): that begins anew with each ping or pong, and leaves out writing the pongs
                async with asyncio.timeout(max(0.01, min(session.expires() - now, reading.wait(now)))):
                    message = await ws.receive()
            except TimeoutError:
                text = reading.take()
                if text is None:
                    outcome = session.expired(clock())
            else:
                if message.type == WSMsgType.TEXT:
                    if self._draining:
                        continue
                    text = reading.offer(message.data, clock())
                elif message.type == WSMsgType.BINARY:
                    error = ProtocolError("a request is a text message (JSON), not a binary one", "binary")
                    outcome = session.malformed(error, clock())
                else:  # closed, or a broken frame that aiohttp has answered (1002, 1007, 1009)
                    return
            if text is not None:
                now, worked = clock(), time.thread_time()
                outcome = session.receive(text, now)
                # waiting for other threads is not the client's fault, but the loop stands still meanwhile
                reading.share.spend(time.thread_time() - worked, clock() - now)
            session.counts.unread = reading.left_out
            if isinstance(outcome, Warn):
                await self._send(ws, outcome.text)
            elif isinstance(outcome, Close):
                await self._farewell(channel, ws, outcome)
                return
            elif text is not None:
                self.pump.received(channel)
            count += 1
            if count % _TURN == 0:  # receive() does not give way while more has arrived
                await asyncio.sleep(0)

    async def _farewell(self, channel: Channel, ws: web.WebSocketResponse, close: Close) -> None:
        """Close the connection of a client that broke the rules. Raises TimeoutError if it does not answer."""
        self.pump.remove(channel)
        if close.breach:
            self.door.breach(self._sockets[channel.number][1], close.reason)
        if close.text:
            await self._send(ws, close.text)
        async with asyncio.timeout(_FAREWELL):  # else it is cut off
            await ws.close(code=close.code, message=close.reason.encode())

    async def _write(self, channel: Channel, ws: web.WebSocketResponse, request: web.Request) -> None:
        """Pictures of one client, in order. A client that does not read them in time is cut off."""
        session = channel.session
        while True:
            frame = await channel.frames.get()
            try:
                packed = await self.pump.pack(channel, frame)
                for data in [packed] if isinstance(packed, str) else packed:
                    await self._send(ws, data)
            except TimeoutError:
                log.warning("client %d does not read its pictures; cut off", channel.number)
                _cut_off(request)
                return
            except ConnectionError:
                return
            except Exception:  # a fault of ours: end the connection rather than leave it silent
                log.exception("client %d cannot be answered", channel.number)
                _cut_off(request)
                return
            if not isinstance(packed, str):
                session.sent(frame.request, sum(map(len, packed)))
            self.pump.wake()
            if frame.ends:
                log.warning("client %d is dropped: %s", channel.number, frame.ends)
                with contextlib.suppress(TimeoutError):
                    await self._farewell(channel, ws, Close("", POLICY_VIOLATION, frame.ends, breach=True))
                return _cut_off(request)

    async def _send(self, ws: web.WebSocketResponse, data: str | bytes) -> None:
        if ws.closed:
            return
        async with asyncio.timeout(self.config.write_timeout):
            await (ws.send_str(data) if isinstance(data, str) else ws.send_bytes(data))


async def _set_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_ALWAYS)
    for name, value in _UNLESS_SAID.items():
        response.headers.setdefault(name, value)


def _cut_off(request: web.Request) -> None:
    if request.transport is not None:
        request.transport.abort()
