"""Server: aiohttp on one port for the WebSocket (/ws) and the pages.

session.py handles messages, guard/ connections, render_loop.py the order of pictures.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from typing import Any, TypeVar

from aiohttp import web

from glsplat.errors import ProtocolError
from glsplat.net.catalogue import Catalogue
from glsplat.net.client_stream import ClientStream
from glsplat.net.conversation import Conversation, cut_off, make_socket
from glsplat.net.drawer import Drawer
from glsplat.net.feature import Feature
from glsplat.net.guard.access import server_tls
from glsplat.net.guard.gate import Gate, connection_of
from glsplat.net.guard.limits import ClientQuota, CpuBudget
from glsplat.net.guard.listener import bind
from glsplat.net.internal_client import Fitted, InternalClient
from glsplat.net.messages import MAX_MESSAGE_BYTES, Decoder, WireOptions
from glsplat.net.options import NOT_ALLOWED, RoomError, ServerConfig, client_options
from glsplat.net.pages import set_headers
from glsplat.net.pose_queue import PoseQueue
from glsplat.net.rights import Rights, User, user_of
from glsplat.net.room_view import driven_by
from glsplat.net.session import GOING_AWAY, Counts, Session

log: logging.Logger = logging.getLogger("glsplat.net")
F = TypeVar("F", bound=Feature)

DRAIN_GIVE_UP_S = 2.0  # a stopping server does not wait for a picture that takes longer


class Server:
    """Streams the avatars of ``catalogue`` as ``drawer`` draws them.

    ``features`` add addresses and options, and observe clients. On SIGHUP a pool of workers restarts them one by one.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        drawer: Drawer,
        config: ServerConfig | None = None,
        features: Sequence[Feature] = (),
    ) -> None:
        self.config: ServerConfig = config or ServerConfig()
        self.catalogue: Catalogue = catalogue
        self.drawer: Drawer = drawer
        self.features: tuple[Feature, ...] = tuple(features)
        self.clients: dict[int, ClientStream] = {}
        self.clock: Callable[[], float] = drawer.clock
        self.port: int = self.config.port
        limits = self.config.limits
        for feature in self.features:
            limits = feature.limits(limits)
        refusal = next(filter(None, (feature.refusal for feature in self.features)), "")
        rights = Rights(self.config.access.accounts, self.config.consent, self.config.private, refusal)
        self.gate: Gate = Gate(
            self.config.access, limits, self.config.max_clients, self.clock, rights, self._is_trusted
        )
        self.internal_client: InternalClient = InternalClient(drawer, self.config.wire, self.config.session, self.clock)
        self.fitted: Fitted | None = None  # size of pictures, found soon after the start if configured
        self.fitting: asyncio.Task[None] | None = None  # finds ``fitted``
        self.all_offered: asyncio.Event = asyncio.Event()
        self._work = CpuBudget(limits.work, self.clock(), limits.work_alone, drawer.stages.lately)
        self._solve_thread = ThreadPoolExecutor(1, thread_name_prefix="solve")
        self._responder = next(filter(None, (feature.pose_responder(self) for feature in self.features)), None)
        self._running: list[Feature] = []  # features that have started
        self._adder: asyncio.Task[None] | None = None
        self._conversations: dict[int, Conversation] = {}
        self._closing: set[asyncio.Task[None]] = set()
        self._totals, self._numbers, self._draining, self._started = Counts(), 0, False, self.clock()
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
            await self._start_all()
        except BaseException:
            listening.close()
            raise
        guards = [self.gate.guard, *(feature.guard for feature in self.features)]
        app = web.Application(middlewares=guards, client_max_size=MAX_MESSAGE_BYTES)
        app.add_routes([web.get("/ws", self._websocket)])
        for feature in self.features:
            app.add_routes(feature.routes())
        if self.config.access.local:  # the features' work is this machine's own user's
            self.drawer.should_yield = lambda: any(feature.needs_cpu() for feature in self.features)
        app.on_response_prepare.append(set_headers)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=self.config.drain_timeout)
        await self._runner.setup()
        assert self._runner.server is not None
        cert = None if self.config.tls is None else self.config.tls[0]
        self.gate.open(self._runner.server, listening, tls, cert, self.config.session.handshake)
        self._started = self.clock()
        if self.config.fit:  # clients that connect meanwhile are offered the configured size
            self.fitting = asyncio.create_task(self._fit())
        self._adder = asyncio.create_task(self._add_later())

    async def _start_all(self) -> None:
        """Start the render loop and the features concurrently; stop all of them where one fails."""

        async def start(feature: Feature) -> None:
            await feature.start(self)
            self._running.append(feature)

        starting = [asyncio.create_task(start(feature)) for feature in self.features]
        drawing = False
        try:
            await self.drawer.start()
            drawing = True
            await asyncio.gather(*starting)
        except BaseException:
            for task in starting:
                task.cancel()
            await asyncio.gather(*starting, return_exceptions=True)
            await self._stop_features()
            if drawing:
                await self.drawer.stop()
            raise

    async def _stop_features(self) -> None:
        while self._running:
            await self._running.pop().stop()

    async def stop(self) -> None:
        """Drop further requests, send the pictures under way, close the clients (1001), end the threads."""
        self._draining = True
        for task in filter(None, (self.fitting, self._adder)):
            task.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self.config.drain_timeout):
                while self.drawer.drawing_for < DRAIN_GIVE_UP_S and any(
                    client.session.status()["under_way"] for client in self.clients.values()
                ):
                    await asyncio.sleep(0.01)
        closing = [conversation.close(GOING_AWAY, "the server stops") for conversation in self._conversations.values()]
        await asyncio.gather(*closing, *self._closing, return_exceptions=True)
        await self.gate.close()
        await self._stop_features()
        if self._runner is not None:
            await self._runner.cleanup()
        await self.drawer.stop()
        self._solve_thread.shutdown(wait=False, cancel_futures=True)

    async def run(self, started: Callable[[], None] | None = None) -> None:
        """Serve until SIGINT or SIGTERM, then stop in order; a second signal ends the process at once.

        ``started`` is called once clients can connect. Raises ContextError, after stopping, when the OpenGL context
        is lost and cannot be recreated.
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
        if self.drawer.restart is not None and hasattr(signal, "SIGHUP"):
            loop.add_signal_handler(signal.SIGHUP, self.drawer.restart)
        await self.start()
        try:
            if started is not None:
                started()
            ends = [asyncio.create_task(done.wait()), asyncio.create_task(self.drawer.ended())]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await self.stop()
        if not done.is_set():
            ends[1].result()

    def stats(self, user: User | None = None) -> dict[str, Any]:
        """Return /stats for an account, with the clients that it may see."""
        rights, clients, totals = self.gate.rights, [], asdict(self._totals)
        for client in self.clients.values():
            status, owner = client.session.status(), client.account
            for name in totals:
                totals[name] += status[name]
            if rights.sees(user, "client", owner):
                fields = client.stats(status, rights.sees(user, "identity", owner))
                clients.append(fields | merged(feature.client_stats(user, client) for feature in self.features))
        stats = {
            "scene": self.config.scene if rights.sees(user, "avatar", self.catalogue.names[0]) else None,
            "driver": self.drawer.driver,
            "healthy": self.drawer.healthy,
            "uptime": round(self.clock() - self._started, 1),
            "fps": round(self.drawer.stages.fps(), 2),
            "max_clients": self.config.max_clients,
            "token": self.config.access.guarded,
            **self.gate.status(),
            "rebuilds": self.drawer.rebuilds,
            "workers": self.drawer.workers(),
            "uploads": None,
            "datagrams": None,
            "totals": totals,
            "stages": self.drawer.stages.summary(),
            "rooms": [],
            "connected": len(self.clients),
            "clients": clients,
        }
        return stats | merged(feature.stats(user) for feature in self.features)

    def session(self, user: User | None = None) -> dict[str, Any]:
        """Return /session for an account: the options of a connection."""
        most, wire = self.config.max_clients, self._wire
        avatars = self.catalogue.fields(self.gate.rights.drivable(user, self.catalogue.names))
        session = {
            "avatars": [
                one | merged(feature.avatar_fields(one["name"]) for feature in self.features) for one in avatars
            ],
            "rooms": [],
            "upload": None,
            "max_side": wire.max_side,
            "size": wire.size,
            "rate": None if self.fitted is None else round(self.fitted.rate, 1),
            "loading": not self.all_offered.is_set(),
            "quality": wire.quality,
            "light": None if wire.light is None else wire.light.to_json(),
            "window": self.config.session.window,
            "video": self.drawer.encoder.codecs,
            "clients": len(self.clients),
            "max_clients": most,
            "full": len(self.clients) >= most,
            "driver": self.drawer.driver,
        }
        return session | merged(feature.session(user) for feature in self.features)

    @property
    def _wire(self) -> WireOptions:
        """The default options of requests, with the fitted size."""
        wire = self.config.wire
        return wire if self.fitted is None else replace(wire, size=(self.fitted.side, self.fitted.side))

    def _is_trusted(self, request: web.Request) -> bool:
        return any(feature.is_trusted(request) for feature in self.features)

    def is_healthy(self) -> bool:
        """Return whether pictures are drawn, and new clients may come."""
        return self.drawer.healthy and not self._draining

    async def _fit(self) -> None:
        self.fitted = await self.internal_client.fit(self.catalogue[self.catalogue.names[0]], self.config.wire.max_side)

    async def _add_later(self) -> None:
        if self.fitting is not None:
            await asyncio.wait([self.fitting])
        try:
            more = self.catalogue.later()
            while (one := await asyncio.to_thread(next, more, None)) is not None:
                self.catalogue.add(one)
            for feature in self.features:
                await feature.avatars_added()
        except Exception:  # the avatars offered so far remain
            log.exception("some avatars could not be loaded")
        finally:
            self.all_offered.set()

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if self._draining or len(self.clients) >= self.config.max_clients:
            self.gate.refused += 1
            text = f"the server is full ({self.config.max_clients} clients); try again later\n"
            return web.Response(status=503, text=text, headers={"Retry-After": "5"})
        ws = make_socket(self.config.heartbeat, self.config.write_timeout)
        entered = self.gate.enter(request, ws)
        if isinstance(entered, web.Response):
            return entered
        try:
            client = self._open_client(request, entered)
        except BaseException as error:
            self.gate.leave(request, entered)
            if not isinstance(error, ProtocolError):
                raise
            status = 403 if error.code == NOT_ALLOWED else getattr(error, "status", 400)
            return web.Response(status=status, text=f"{error}\n")
        conversation = Conversation(
            *(client, ws, request, self.drawer, self.gate, self._responder),
            is_draining=lambda: self._draining,
            write_timeout=self.config.write_timeout,
        )
        try:
            await self.gate.accept(request, ws, entered)
            self._conversations[client.number] = conversation
            await conversation.run()
            return ws
        except (ConnectionError, TimeoutError):  # the client does not react
            cut_off(request)
            # without a handshake there is no WebSocket that aiohttp could close
            return ws if ws.prepared else web.Response(status=400)
        finally:
            self._close_client(client, conversation.goodbye)
            self.gate.leave(request, entered)

    def _open_client(self, request: web.Request, quota: ClientQuota) -> ClientStream:
        """Return a new client with the options of its address. Raises ProtocolError."""
        user, rights = user_of(request), self.gate.rights
        query: Mapping[str, str] = request.query
        for feature in self.features:
            query = feature.query(query, user)
        requested = client_options(query, self._wire, self.config.session, self.catalogue.names, rights, user)
        one = self.catalogue[requested.avatar]
        solver = None if one.solver is None else one.solver(requested.height, requested.span)
        for feature in self.features:
            solver = feature.solver(solver)
        self._numbers += 1
        number, address = self._numbers, connection_of(request).key
        session = Session(
            Decoder(requested.wire, one.skeleton, one.parts),
            requested.session,
            self.clock(),
            refusal=partial(rights.refusal, user, requested.avatar),
            sends_poses=self._responder is not None,
        )
        share = self._work.open(self.clock(), address)
        client = ClientStream(
            number,
            session,
            None
            if solver is None
            else PoseQueue(solver, self._solve_thread, self.clock, share=share, samples=quota.samples),
            address=address,
            shown=one,
            account="" if user is None else user.name,
            driver=requested.name,
            label=driven_by([requested.name]) if requested.label else "",
            notice=partial(rights.label, user, requested.avatar),
            share=share,
            video=self.drawer.encoder.video(self.clock),
        )
        self.clients[number] = client
        try:
            for feature in self.features:
                feature.client_opened(client, requested)
            if requested.room is not None and client.member is None:
                raise RoomError("no such room on this server", 404)
        except BaseException:  # a refusal, or a fault of a feature
            self._close_client(client, goodbye=False)
            raise
        return client

    async def withdraw(self, name: str) -> bool:
        """Withdraw an avatar and end the connections that show it; return False where it was not offered."""
        there = self.catalogue.remove(name)
        for feature in self.features:
            feature.avatar_withdrawn(name)
        shown = [
            conversation for conversation in self._conversations.values() if conversation.client.shown.name == name
        ]
        closing = (conversation.close(GOING_AWAY, "this avatar is deleted") for conversation in shown)
        await asyncio.gather(*closing, return_exceptions=True)
        return there

    def worn_avatars(self, user: User | None) -> set[str]:
        """Return the avatars of people that an account may meet, by all features."""
        return {name for feature in self.features for name in feature.worn_avatars(user)}

    def feature(self, kind: type[F]) -> F:
        """Return the feature of that class. Raises LookupError."""
        for feature in self.features:
            if isinstance(feature, kind):
                return feature
        raise LookupError(f"this server has no {kind.__name__}")

    def close_client(self, number: int, reason: str) -> None:
        """Close the connection of a client that did nothing wrong."""
        conversation = self._conversations.get(number)
        if conversation is not None:
            task = asyncio.create_task(conversation.close(GOING_AWAY, reason))
            self._closing.add(task)
            task.add_done_callback(self._closing.discard)

    def _close_client(self, client: ClientStream, goodbye: bool) -> None:
        self.drawer.remove(client)
        if client.share is not None:
            self._work.close(client.share)
        self._conversations.pop(client.number, None)
        del self.clients[client.number]
        for name, value in asdict(client.session.counts).items():
            setattr(self._totals, name, getattr(self._totals, name) + value)
        for feature in self.features:
            try:
                feature.client_closed(client, goodbye)
            except Exception:  # the other features are called all the same
                log.exception("%s failed as client %d left", type(feature).__name__, client.number)


def merged(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one object with the fields of all ``parts``."""
    return {name: value for part in parts for name, value in part.items()}
