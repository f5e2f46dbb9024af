"""One TCP connection under aiohttp: its bytes are counted before HTTP and WebSocket parsers see them.

aiohttp answers pings and discards unusable data before the server's own loop sees them, and logs text that strangers
sent. This overrides methods of its request handler to prevent both.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from aiohttp import web

from glsplat.net.guard.limits import Limits
from glsplat.net.guard.meter import Breach, FrameMeter
from glsplat.net.guard.notices import Notices


class _MeteredReader:
    """aiohttp's WebSocket parser behind a meter. After a breach nothing more is read."""

    def __init__(
        self, reader: Any, meter: FrameMeter, clock: Callable[[], float], broke: Callable[[Breach], None]
    ) -> None:
        self._reader, self._meter, self._clock, self._broke = reader, meter, clock, broke
        self._ended = False

    def feed_data(self, data: bytes) -> tuple[bool, bytes]:
        if self._ended:
            return False, b""
        allowed, breach = self._meter.feed(data, self._clock())
        result: tuple[bool, bytes] = self._reader.feed_data(data if breach is None else data[:allowed])
        if breach is not None:
            self._ended = True
            self._broke(breach)
        return result

    def feed_eof(self) -> None:
        self._reader.feed_eof()


class GuardedConnection(web.RequestHandler):
    """A connection with limits on its bytes.

    The gate sets ``meter`` before it answers a client's handshake. ``key`` is the address of the newest request: the
    peer's, or the one that a trusted proxy names (``proxied``).
    """

    __slots__ = (
        *("_body", "_clock", "_gone", "_head", "_head_most", "_notices", "_socket"),
        *("breached", "busy", "key", "meter", "peer", "proxied"),
    )

    def __init__(
        self,
        server: web.Server,
        peer: str,
        proxied: bool,
        limits: Limits,
        notices: Notices,
        clock: Callable[[], float],
        gone: Callable[[GuardedConnection], None],
        timeout: float,  # seconds for a whole request, from the connection or the one before
    ) -> None:
        super().__init__(
            server,
            loop=asyncio.get_running_loop(),
            access_log=None,  # type: ignore[arg-type]  # which switches it off
            keepalive_timeout=timeout,
            lingering_time=0,  # else it reads on behind an answer, for ten seconds and at any rate
            auto_decompress=False,  # bodies are never unpacked
        )
        self.peer: str = peer  # key of the address at the other end
        self.proxied: bool = proxied  # the peer is a trusted proxy
        self.key: str = peer
        self.meter: FrameMeter | None = None
        self.breached: asyncio.Future[Breach] = asyncio.get_running_loop().create_future()
        self.busy: bool = False  # while a request is answered
        self._head, self._head_most = 0, limits.head
        self._body = 0  # bytes expected beyond that
        self._notices, self._clock, self._gone = notices, clock, gone
        self._socket: asyncio.Transport | None = None  # until it is closed; aiohttp's ``transport`` ends earlier

    @property
    def open(self) -> bool:
        """True from the handshake of TLS until the socket is closed."""
        return self._socket is not None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Record the socket, which is connected (after TLS)."""
        assert isinstance(transport, asyncio.Transport)
        self._socket = transport
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """Count bytes from the socket (after TLS), and pass them on."""
        if self.meter is None:
            self._head += len(data)
            if self._head > self._head_most + self._body:
                self._notices("head", f"a connection sent {self._head_most} bytes without a request; cut off")
                self.abort()
                return
        super().data_received(data)

    async def start(self) -> None:
        """Answer requests until the end; cut off one whose target aiohttp cannot read, where it would hang."""
        try:
            await super().start()
        except Exception:
            if self.open:
                self._notices("http", "a request's target is no URL; cut off")
                self.abort()

    def connection_lost(self, exc: BaseException | None) -> None:
        """Report that the socket is closed."""
        self._socket = None
        self._gone(self)
        super().connection_lost(exc)

    def set_parser(self, parser: Any, data_received_cb: Callable[[], None] | None = None) -> None:
        """Put the meter before the WebSocket parser, which aiohttp passes right after the handshake."""
        if self.meter is not None:
            parser = _MeteredReader(parser, self.meter, self._clock, self._broke)
        super().set_parser(parser, data_received_cb)

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,
    ) -> web.StreamResponse:
        """Answer malformed HTTP, or a fault of the server's, without repeating anything of the request."""
        if status == 500:
            self.log_exception("a request failed", exc_info=exc)
        else:
            self._notices("http", f"malformed HTTP was refused ({status})")
        if request.writer.output_size > 0:
            raise ConnectionError("an answer is already being sent")
        response = web.Response(status=status, text="the request failed\n" if status == 500 else "malformed request\n")
        response.force_close()
        return response

    def log_exception(self, *args: Any, **kw: Any) -> None:
        """Log one line with the error's type and place: tracebacks and messages may hold a peer's text."""
        error = kw.get("exc_info")
        if not isinstance(error, BaseException):
            self._notices("fault", "a request failed in the server")
            return
        trace, place = error.__traceback__, ""
        while trace is not None:
            place = f" at {trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}"
            trace = trace.tb_next
        self._notices("fault", f"a request failed in the server: {type(error).__name__}{place}")

    def request_done(self) -> None:
        """Count the next request's bytes anew."""
        self._head = self._body = 0

    def expect(self, nbytes: int) -> None:
        """Allow the current request a body of ``nbytes``."""
        self._body = nbytes

    def abort(self) -> None:
        """Close at once; unsent data is dropped."""
        if self._socket is not None:
            self._socket.abort()

    def _broke(self, breach: Breach) -> None:
        if not self.breached.done():
            self.breached.set_result(breach)
        if self.transport is not None:
            self.transport.pause_reading()  # further data stays with the sender
