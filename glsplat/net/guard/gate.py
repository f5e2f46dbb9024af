"""The gate: checks every connection and request before the server handles it (access.py, addresses.py)."""

from __future__ import annotations

import asyncio
import math
import socket
import ssl
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

from aiohttp import web

from glsplat.net.guard.access import SUBPROTOCOL, Access, certificate_names, is_loopback
from glsplat.net.guard.addresses import Addresses
from glsplat.net.guard.connection import GuardedConnection
from glsplat.net.guard.forwarded import FORWARDED, TrustedProxies
from glsplat.net.guard.host_info import machine_names
from glsplat.net.guard.limits import ClientQuota, Limits, address_key
from glsplat.net.guard.listener import Listener
from glsplat.net.guard.meter import FrameMeter
from glsplat.net.guard.notices import Notices
from glsplat.net.rights import USER, Accounts, Rights

_MAX_LOGINS = 32  # requests that wait for their tokens to be hashed, one after the other
_CONTINUE = "100-continue"

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
RequestHandler = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]


class Gate:
    """Accept connections and refuse requests. ``max_clients`` is the server's; one address may have half of them."""

    def __init__(
        self,
        access: Access,
        limits: Limits,
        max_clients: int,
        clock: Callable[[], float],
        rights: Rights,
        is_trusted: Callable[[web.Request], bool] = lambda request: False,  # counted like a file of the page
    ) -> None:
        share = max_clients if access.local else (max_clients + 1) // 2
        self.limits = limits
        self.addresses: Addresses = Addresses(limits, limits.per_address or share)
        self.notices: Notices = Notices(clock)
        self.rights: Rights = rights
        self.refused = 0  # requests
        self._is_trusted = is_trusted
        self._login, self._logins = asyncio.Lock(), 0
        self._access, self._clients, self._clock = access, max_clients, clock
        self._proxies, self._unnamed = TrustedProxies(access.proxies), False
        self._handle: RequestHandler | None = None  # aiohttp's
        self._listener: Listener | None = None

    def open(
        self,
        server: web.Server,
        listening: socket.socket,
        tls: ssl.SSLContext | None,
        cert: Path | None,
        timeout: float,
    ) -> None:
        """Accept for ``server``; a connection gets ``timeout`` seconds for each request."""
        names = self._access.hosts
        if tls is not None and cert is not None:
            names += certificate_names(cert, tls)
        if not is_loopback(self._access.host):
            names += machine_names()
        self._access = replace(self._access, hosts=names)

        self._handle, server.request_handler = server.request_handler, self.receive

        def make(key: str, proxied: bool, gone: Callable[[GuardedConnection], None]) -> GuardedConnection:
            return GuardedConnection(server, key, proxied, self.limits, self.notices, self._clock, gone, timeout)

        self._listener = Listener(
            *(listening, make, self.addresses, self.notices, self._clock),
            clients=self._clients,
            proxies=self._proxies,
            tls=tls,
            handshake=timeout,
        )
        self._listener.start()

    async def close(self) -> None:
        """Accept nothing more; open connections stay."""
        if self._listener is not None:
            await self._listener.stop()

    def status(self) -> dict[str, int]:
        """Return the numbers for /stats."""
        listener = self._listener
        return {
            "refused": self.refused,
            "turned_away": 0 if listener is None else listener.turned_away,
            "waiting": 0 if listener is None else listener.waiting,
            "held_off": self.addresses.count_held_off(self._clock()),
        }

    async def receive(self, request: web.BaseRequest) -> web.StreamResponse:
        """Answer a request, before aiohttp routes it. Every refusal closes its connection."""
        connection = connection_of(request)
        connection.busy = True
        try:
            if connection.proxied:
                connection.key = self._client_key(request, connection)
            response = self._refused_early(request, connection)
            if response is None:
                assert self._handle is not None
                response = await self._handle(request)
        except web.HTTPException as error:
            error.force_close()
            raise
        finally:
            connection.busy = False
            connection.request_done()
        if response.status >= 400:
            response.force_close()
        return response

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse a request that was routed, or let ``handler`` answer it."""
        refusal = await self._refusal(request, connection_of(request))
        return await handler(request) if refusal is None else self._refused(refusal)

    def enter(self, request: web.Request, ws: web.WebSocketResponse) -> ClientQuota | web.Response:
        """Return the quota of a new client, or the refusal."""
        connection = connection_of(request)
        offered = [name.strip() for name in request.headers.get("Sec-WebSocket-Protocol", SUBPROTOCOL).split(",")]
        if SUBPROTOCOL not in offered:  # aiohttp would log the offer, perhaps a token
            return self._refused(
                web.Response(status=400, text=f"the subprotocol here is {SUBPROTOCOL}: offer it, or none\n")
            )
        if not _is_handshake(request, ws):
            text = "this is the address of a WebSocket (RFC 6455, version 13)\n"
            return self._refused(web.Response(status=400, text=text))
        quota = self.addresses.enter(connection.key, self._clock())
        if quota is None:
            most = self.addresses.per_address
            return self._refused(_later(5.0, f"at most {most} clients at once from one address"))
        return quota

    async def accept(self, request: web.Request, ws: web.WebSocketResponse, quota: ClientQuota) -> None:
        """Answer a client's handshake; its connection is metered from now on."""
        connection = connection_of(request)
        connection.meter = FrameMeter(quota, self.limits)
        await ws.prepare(request)
        if self._listener is not None:
            self._listener.release(connection)

    def leave(self, request: web.Request, quota: ClientQuota) -> None:
        """Take back the quota of a client that left, or was refused after ``enter``."""
        connection = connection_of(request)
        self.addresses.leave(connection.key, quota, self._clock())
        if self._listener is not None:
            self._listener.take_back(connection)

    def breach(self, request: web.Request, reason: str) -> None:
        """Hold off the address of a client that broke a limit."""
        self.addresses.breach(connection_of(request).key, self._clock())
        self.notices("breach", f"a client broke a limit ({reason}); its address is held off")

    def _refused(self, response: web.Response) -> web.Response:
        """Count a refusal and return it."""
        self.refused += 1
        return response

    def _client_key(self, request: web.BaseRequest, connection: GuardedConnection) -> str:
        """Return the key of the address that a trusted proxy names, else the proxy's."""
        client = self._proxies.client(request.headers)
        if client is None:
            if any(name in request.headers for name in FORWARDED):
                self.notices("forwarded", "a trusted proxy's header names no client; the proxy's own address counts")
            elif not self._unnamed:  # a proxy without headers, or a monitor on its machine
                self._unnamed = True
                self.notices(
                    "unnamed", f"a request of a trusted proxy has no {' or '.join(FORWARDED)}; its address counts"
                )
            return connection.peer
        return address_key(client)

    def _refused_early(self, request: web.BaseRequest, connection: GuardedConnection) -> web.StreamResponse | None:
        """Refuse requests that aiohttp would fail on, or answer uncounted."""
        wrong = self._access.wrong_host(request.headers.getall("Host", []))
        if wrong is None and not _has_address(request):
            wrong = 400, "the Host header and the request's target make no URL"
        if wrong is not None:
            return self._refused(web.Response(status=wrong[0], text=wrong[1] + "\n"))
        if (request.headers.get("Expect") or _CONTINUE).lower() != _CONTINUE:
            self.addresses.visit(connection.key, self._clock())
            return self._refused(web.Response(status=417, text=f"the only expectation here is {_CONTINUE}\n"))
        return None

    async def _refusal(self, request: web.Request, connection: GuardedConnection) -> web.Response | None:
        now, key, addresses, access = self._clock(), connection.key, self.addresses, self._access
        health = request.path == "/healthz"  # tells nothing of scene and clients; answered while held off, too
        if not health and (seconds := addresses.held_off(key, now)) > 0:
            return _later(seconds, "a client of this address broke a limit (docs/protocol.md, section 5)")
        public = _is_page(request)
        if not addresses.visit(key, now, self.limits.file if public or self._is_trusted(request) else 1.0):
            return _later(1.0, f"at most {self.limits.visits:g} connections and requests a second from one address")
        if health:
            return None
        guesses = not public and access.guarded and access.offers_token(request.headers)
        if guesses and (seconds := addresses.guess_wait(key, now)) > 0:
            return _later(seconds, "too many wrong tokens from this address")
        refusal = access.refusal(request.headers, public)
        if refusal is None:
            return None if public or access.accounts is None else await self._identify(request, key, access.accounts)
        if refusal[0] == 401 and guesses:
            addresses.guess(key, now)
            self.notices("token", "a wrong token was refused")
        return _asked(refusal[1]) if refusal[0] == 401 else web.Response(status=refusal[0], text=refusal[1] + "\n")

    async def _identify(self, request: web.Request, key: str, accounts: Accounts) -> web.Response | None:
        """Record the account of a request, or return a refusal."""
        token = next(iter(self._access.tokens(request.headers)), None)
        if token is None:
            return _asked("an account's token is needed: Authorization: Bearer NAME.SECRET, or as a subprotocol")
        user = accounts.known(token)
        if user is None:
            if self._logins >= _MAX_LOGINS:
                return _later(1.0, "too many tokens are looked at just now")
            self._logins += 1
            try:
                async with self._login:  # one at a time, so that parallel guesses are all counted
                    if (seconds := self.addresses.guess_wait(key, self._clock())) > 0:
                        return _later(seconds, "too many wrong tokens from this address")
                    user = await accounts.verified(token)
                    if user is None:
                        self.addresses.guess(key, self._clock())
            finally:
                self._logins -= 1
        if user is None:
            self.notices("token", "a wrong token was refused")
            return _asked("there is no account with this token")
        request[USER] = user
        return None


def connection_of(request: web.BaseRequest) -> GuardedConnection:
    """Return the connection of a request."""
    connection = request.protocol
    assert isinstance(connection, GuardedConnection)
    return connection


def _has_address(request: web.BaseRequest) -> bool:
    """Return whether aiohttp can read the URL: it raises for invalid ports and IDNA names."""
    try:
        return request.url.host is not None
    except ValueError:
        return False


def _is_page(request: web.Request) -> bool:
    """Return whether a file of the page will answer, by the route, not by the path's spelling."""
    resource = request.match_info.route.resource
    return resource is not None and resource.canonical in ("/vr", "/vr/{path}")


def _is_handshake(request: web.Request, ws: web.WebSocketResponse) -> bool:
    try:
        return bool(ws.can_prepare(request))
    except ValueError:  # bytes in a header that are not ASCII, or not UTF-8: aiohttp quotes them, or decodes the key
        return False


def _asked(text: str) -> web.Response:
    return web.Response(status=401, text=text + "\n", headers={"WWW-Authenticate": "Basic realm=glsplat"})


def _later(seconds: float, text: str) -> web.Response:
    return web.Response(status=429, text=text + "; try again later\n", headers={"Retry-After": f"{math.ceil(seconds)}"})
