"""The server: aiohttp on one port for the WebSocket (/ws) and the pages (pages/).

Glue only: what a message means is session.py's, who may connect is access.py's, who is drawn next is render_loop.py's.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from aiohttp import web

from glsplat.errors import ProtocolError
from glsplat.net.backend import AvatarInfo, Backend
from glsplat.net.client_stream import ClientStream
from glsplat.net.conversation import Conversation, cut_off, make_socket
from glsplat.net.datagrams.start import datagram_listener
from glsplat.net.datagrams.way import SecondWay
from glsplat.net.guard.access import server_tls
from glsplat.net.guard.gate import Gate, connection_of
from glsplat.net.guard.limits import ClientQuota, CpuBudget
from glsplat.net.guard.listener import bind
from glsplat.net.labels import driven_by
from glsplat.net.local_loop import LocalLoop
from glsplat.net.messages import MAX_BYTES, Decoder, WireOptions
from glsplat.net.options import NOT_ALLOWED, ServerConfig, client_options
from glsplat.net.pace.fitting import Fitted
from glsplat.net.pages.catalogue import Catalogue
from glsplat.net.pages.clients import client_fields
from glsplat.net.pages.headers import set_headers
from glsplat.net.pages.history import History
from glsplat.net.pages.lead import Lead
from glsplat.net.pages.previews import Drawer, Previews
from glsplat.net.pages.routes import Pages
from glsplat.net.poses.answers import Answers
from glsplat.net.poses.splat_files import SplatFiles
from glsplat.net.rights import Rights, user_of
from glsplat.net.session import GOING_AWAY, Counts, Session

if TYPE_CHECKING:
    from glsplat.net.accounts.users import User
    from glsplat.net.rooms.rooms import Rooms
    from glsplat.net.uploads.routes import Uploads
    from glsplat.net.workers.pool import WorkerPool

__all__ = ["Server"]

log: logging.Logger = logging.getLogger("glsplat.net")
clock: Callable[[], float] = time.perf_counter  # the render loop's clock too

_HOPELESS = 2.0  # seconds after which a picture is not waited for when the server stops


class Server:
    """Streams what ``backend`` draws: the first of ``offered``, or the one that a client names in its address.

    A pool has workers draw, and SIGHUP starts them anew one after the other; anything else draws on one thread.
    ``uploads`` lets clients add to those; ``backend`` then has to draw what lies in its folder, too. ``lead`` has a
    word in what each client is shown. ``later`` gives what is offered once clients can connect, in a thread.
    """

    def __init__(
        self,
        backend: Backend | WorkerPool,
        config: ServerConfig | None = None,
        offered: Sequence[AvatarInfo] = (AvatarInfo(name="default"),),
        uploads: Uploads | None = None,
        lead: Lead | None = None,
        later: Callable[[], Iterable[AvatarInfo]] = tuple,
    ) -> None:
        self.config: ServerConfig = config or ServerConfig()
        how = clock, self.config.fps, self.config.video
        self.render_loop = LocalLoop(backend, *how) if isinstance(backend, Backend) else backend
        self.port: int = self.config.port
        limits = self.config.limits
        if uploads is not None:
            limits = replace(limits, head=max(limits.head, limits.body))
        unseen = "" if lead is None else lead.unseen
        rights = Rights(self.config.access.accounts, self.config.consent, self.config.private, unseen)
        self.gate: Gate = Gate(self.config.access, limits, self.config.max_clients, clock, rights)
        self._work = CpuBudget(limits.work, clock(), limits.work_alone, lambda: self.render_loop.stages.lately())
        self._offers = Catalogue(offered)
        self._uploads, self._lead, self._history = uploads, lead, History(self.stats)
        self._splat_files = SplatFiles(self._offers, rights, self._worn)
        self._answers = Answers(self._splat_files.sha256, self._splat_files.why, clock)
        self._channels: dict[int, ClientStream] = {}
        self._drawer = Drawer(self.render_loop, self.config.wire, self.config.session, clock)
        shown = self._drawer, self._offers, rights, self._channels
        self._previews = Previews(*shown, self.stats, self.offer, self._history.fields)
        self.fitted: Fitted | None = None  # soon after it has started, where that was asked for
        self.fitting: asyncio.Task[None] | None = None  # finds it
        self._later, self.all_offered = later, asyncio.Event()
        self._adder: asyncio.Task[None] | None = None
        self._talks: dict[int, Conversation] = {}
        self._closing: set[asyncio.Task[None]] = set()
        self._totals, self._numbers, self._draining, self._started = Counts(), 0, False, clock()
        self._runner: web.AppRunner | None = None
        self._datagrams = datagram_listener(clock) if self.config.webtransport else None

    @cached_property
    def _rooms(self) -> Rooms:
        from glsplat.net.rooms.rooms import Rooms  # here: most servers have none

        return Rooms(self.config.rooms, self.config.furnished)

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
        packing = asyncio.create_task(self._splat_files.prepare())  # meanwhile
        try:
            if self._datagrams is not None:
                await self._datagrams.open(self.config.access.host, self.port)
            await self.render_loop.start()
            await packing
        except BaseException:
            packing.cancel()
            if self._datagrams is not None:
                await self._datagrams.close()
            listening.close()
            raise
        guards = [self.gate.guard] + ([] if self._lead is None else [self._lead.guard])
        app = web.Application(middlewares=guards, client_max_size=MAX_BYTES)
        pages = Pages(self.stats, self.offer, self._healthy, tls is not None, self._history, self.config.access.host)
        own = (*self._splat_files.routes(), *pages.routes(), *self._previews.routes())
        app.add_routes([web.get("/ws", self._websocket), *own])
        if (uploads := self._uploads) is not None:
            app.add_routes(uploads.open(self.gate, self._offers.add, self._withdraw))
            if isinstance(self.render_loop, LocalLoop) and self.config.access.local:  # one's own
                self.render_loop.stands_back = lambda: uploads.works
        if self._lead is not None:
            app.add_routes(self._lead.open(self._end, [self._offers[name] for name in self._offers.names]))
            self.gate.knows = self._lead.knows
        app.on_response_prepare.append(set_headers)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=self.config.drain_timeout)
        await self._runner.setup()
        assert self._runner.server is not None
        cert = None if self.config.tls is None else self.config.tls[0]
        self.gate.open(self._runner.server, listening, tls, cert, self.config.session.handshake)
        self._started = clock()
        if self.config.fit:  # whoever connects meanwhile is offered the configured size
            self.fitting = asyncio.create_task(self._fit())
        self._adder = asyncio.create_task(self._add_later())

    async def stop(self) -> None:
        """Take no more requests, send the pictures under way, close the clients (1001), end the threads."""
        self._draining = True
        for task in filter(None, (self.fitting, self._adder)):
            task.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self.config.drain_timeout):
                channels = self._channels.values()
                while self.render_loop.drawing_for < _HOPELESS and any(
                    c.session.status()["under_way"] for c in channels
                ):
                    await asyncio.sleep(0.01)
        closing = [talk.close(GOING_AWAY, "the server stops") for talk in self._talks.values()]
        await asyncio.gather(*closing, *self._closing, return_exceptions=True)
        await self.gate.close()
        if self._datagrams is not None:
            await self._datagrams.close()
        for part in (self._history, self._uploads, self._lead):
            if part is not None:
                await part.stop()
        if self._runner is not None:
            await self._runner.cleanup()
        await self.render_loop.stop()

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
        if not isinstance(self.render_loop, LocalLoop) and hasattr(signal, "SIGHUP"):
            loop.add_signal_handler(signal.SIGHUP, self.render_loop.restart)
        await self.start()
        try:
            if started is not None:
                started()
            ends = [asyncio.create_task(done.wait()), asyncio.create_task(self.render_loop.ended())]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await self.stop()
        if not done.is_set():
            ends[1].result()

    def stats(self, user: User | None = None) -> dict[str, Any]:
        """The numbers of /stats, and of others what the account may see."""
        rights, clients, totals = self.gate.rights, [], asdict(self._totals)
        for number, channel in self._channels.items():
            status, owner = channel.session.status(), channel.account
            for name in totals:
                totals[name] += status[name]
            if rights.sees(user, "client", owner):
                picture = self._previews.shows(user, number)
                clients.append(client_fields(number, channel, status, rights.sees(user, "identity", owner), picture))
        return {
            "scene": self.config.scene if rights.sees(user, "avatar", self._offers.names[0]) else None,
            "driver": self.render_loop.driver,
            "healthy": self.render_loop.healthy,
            "uptime": round(clock() - self._started, 1),
            "fps": round(self.render_loop.stages.fps(), 2),
            "max_clients": self.config.max_clients,
            "token": self.config.access.guarded,
            **self.gate.status(),
            "rebuilds": self.render_loop.rebuilds,
            "workers": None if isinstance(self.render_loop, LocalLoop) else self.render_loop.workers(),
            "uploads": None if self._uploads is None else self._uploads.counts(),
            "datagrams": None if self._datagrams is None else self._datagrams.status(),
            "totals": totals,
            "stages": self.render_loop.stages.summary(),
            "rooms": self._rooms.status(clock(), partial(rights.sees, user)) if self.config.rooms else [],
            "connected": len(self._channels),
            "clients": clients,
        }

    def offer(self, user: User | None = None) -> dict[str, Any]:
        """What /session says to an account of the scene and of the server: all to choose from before connecting."""
        most, wire = self.config.max_clients, self._wire
        return {
            "avatars": self._offers.fields(
                self.gate.rights.drivable(user, self._offers.names), self._splat_files.fields
            ),
            "rooms": self._rooms.offer(clock(), self._enterable(user)) if self.config.rooms else [],
            "upload": None if self._uploads is None else self._uploads.offer(),
            "max_side": wire.max_side,
            "size": wire.size,
            "rate": None if self.fitted is None else round(self.fitted.rate, 1),
            "loading": not self.all_offered.is_set(),
            "quality": wire.quality,
            "light": None if wire.light is None else wire.light.to_json(),
            "window": self.config.session.window,
            "video": self.render_loop.codecs,
            "clients": len(self._channels),
            "max_clients": most,
            "full": len(self._channels) >= most,
            "driver": self.render_loop.driver,
        }

    @property
    def _wire(self) -> WireOptions:
        """What counts where requests are silent, in the size that was found to be drawn often enough."""
        wire = self.config.wire
        return wire if self.fitted is None else replace(wire, size=(self.fitted.side, self.fitted.side))

    def _healthy(self) -> bool:
        return self.render_loop.healthy and not self._draining

    async def _fit(self) -> None:
        self.fitted = await self._drawer.fitted(self._offers[self._offers.names[0]], self.config.wire.max_side)

    async def _add_later(self) -> None:
        if self.fitting is not None:
            await asyncio.wait([self.fitting])
        more = (one for one in self._later() if one.name not in self._offers.names)
        try:
            while (one := await asyncio.to_thread(next, more, None)) is not None:
                self._offers.add(one)
            await self._splat_files.prepare()
        except Exception:  # what is offered by now is shown all the same
            log.exception("not everybody can be offered")
        finally:
            self.all_offered.set()

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if self._draining or len(self._channels) >= self.config.max_clients:
            self.gate.refused += 1
            text = f"the server is full ({self.config.max_clients} clients); try again later\n"
            return web.Response(status=503, text=text, headers={"Retry-After": "5"})
        ws = make_socket(self.config.heartbeat, self.config.write_timeout)
        entered = self.gate.enter(request, ws)
        if isinstance(entered, web.Response):
            return entered
        try:
            channel = self._open_channel(request, entered)
        except ProtocolError as error:
            self.gate.leave(request, entered)
            return web.Response(
                status=403 if error.code == NOT_ALLOWED else getattr(error, "status", 400), text=f"{error}\n"
            )
        talk = Conversation(
            *(channel, ws, request, self.render_loop, self.gate, self._answers),
            deaf=lambda: self._draining,
            write_timeout=self.config.write_timeout,
        )
        try:
            await self.gate.accept(request, ws, entered)
            self._talks[channel.number] = talk
            await talk.run()
            return ws
        except (ConnectionError, TimeoutError):  # it neither reads nor listens
            cut_off(request)
            # gone before its handshake was answered: aiohttp would close what never opened
            return ws if ws.prepared else web.Response(status=400)
        finally:
            self._close_channel(channel, talk.goodbye)
            self.gate.leave(request, entered)

    def _open_channel(self, request: web.Request, quota: ClientQuota) -> ClientStream:
        """A new client with the options of its address: /ws?avatar=ann&mirror=1&window=3&height=1.75&room=lab."""
        user, rights = user_of(request), self.gate.rights
        query = request.query if self._lead is None else self._lead.query(request.query)
        asked = client_options(query, self._wire, self.config.session, self._offers.names, rights, user)
        one = self._offers[asked.avatar]
        solver = None if one.solver is None else one.solver(asked.height, asked.span)
        solver = solver if self._lead is None else self._lead.solver(solver)
        self._numbers += 1
        number, address = self._numbers, connection_of(request).key
        notice = partial(rights.label, user, asked.avatar)
        member = None
        if asked.room is not None:
            again = partial(self._end, number, "connected anew elsewhere")
            member = self._rooms.join(asked, one, number, clock(), again, notice())
        session = Session(Decoder(asked.wire, one.skeleton, one.parts), asked.session, clock())
        session.refusal = partial(rights.refusal, user, asked.avatar)
        channel = self.render_loop.open(number, session, solver, address, one, member)
        channel.account = "" if user is None else user.name
        channel.driver = asked.name if member is None else member.person.name
        channel.label, channel.notice = driven_by(asked.name) if asked.label else "", notice
        channel.tap = None if self._lead is None else self._lead.tap(number)
        channel.share = self._work.open(clock(), channel.address)
        if self._datagrams is not None:
            channel.way = SecondWay(self._datagrams, session, address, clock, partial(self.render_loop.wake, channel))
        if channel.solving is not None:
            channel.solving.share, channel.solving.samples = channel.share, quota.samples
        self._channels[channel.number] = channel
        return channel

    async def _withdraw(self, name: str) -> bool:
        """Offer an avatar no more and end the connections that show it; False where it was not offered."""
        there = self._offers.remove(name)
        self._splat_files.forget(name)
        self._previews.forget(name)
        shown = [talk for talk in self._talks.values() if talk.channel.shown.name == name]
        closing = (talk.close(GOING_AWAY, "this avatar is deleted") for talk in shown)
        await asyncio.gather(*closing, return_exceptions=True)
        return there

    def _worn(self, user: User | None) -> set[str]:
        """By those whom an account may meet."""
        return self._rooms.worn(self._enterable(user)) if self.config.rooms else set()

    def _enterable(self, user: User | None) -> tuple[str, ...]:
        return self.gate.rights.enterable(user, self._rooms.names)

    def _end(self, number: int, reason: str) -> None:
        """Close the connection of a client that did nothing wrong."""
        talk = self._talks.get(number)
        if talk is not None:
            task = asyncio.create_task(talk.close(GOING_AWAY, reason))
            self._closing.add(task)
            task.add_done_callback(self._closing.discard)

    def _close_channel(self, channel: ClientStream, goodbye: bool) -> None:
        self.render_loop.remove(channel)
        if channel.member is not None:
            channel.member.end(goodbye)
        if channel.share is not None:
            self._work.close(channel.share)
        if self._lead is not None:
            self._lead.left(channel.number)
        self._talks.pop(channel.number, None)
        self._previews.left(channel.number)
        del self._channels[channel.number]
        for name, value in asdict(channel.session.counts).items():
            setattr(self._totals, name, getattr(self._totals, name) + value)
