"""The status page, metrics, curves and QR codes of a server as features (docs/deploying.md)."""

from __future__ import annotations

from urllib.parse import quote

from aiohttp import web

from glsplat.extras.operations.previews import Previews
from glsplat.extras.operations.qr import QrCodes
from glsplat.extras.operations.status import STATUS_POLICY, History, metrics_text, page_html
from glsplat.net.feature import Feature, ServerView
from glsplat.net.guard.access import is_loopback
from glsplat.net.guard.host_info import machine_names, reachable_at
from glsplat.net.options import ServerConfig
from glsplat.net.rights import user_of


def features(config: ServerConfig) -> list[Feature]:
    """Return the features of this extra."""
    history = History()
    return [StatusPages(history), Previews(history)]


class StatusPages(Feature):
    """The status page and its data; records ``history`` while the server runs."""

    def __init__(self, history: History) -> None:
        self.history = history
        self._codes = QrCodes()

    async def start(self, server: ServerView) -> None:
        """Start recording the curves of the status page."""
        self._server, self._host, self._tls = server, server.config.access.host, server.config.tls is not None
        self.history.start(lambda: server.stats(None))

    async def stop(self) -> None:
        """Stop recording."""
        await self.history.stop()

    def routes(self) -> list[web.RouteDef]:
        """Return the routes of the status page, /metrics, /history and /reach."""
        return [
            web.get("/", self._status),
            web.get("/metrics", self._metrics),
            web.get("/history", self._history),
            web.get("/reach", self._reach),
        ]

    async def _metrics(self, request: web.Request) -> web.Response:
        return web.Response(
            text=metrics_text(self._server.stats(user_of(request))), content_type="text/plain", charset="utf-8"
        )

    async def _status(self, request: web.Request) -> web.Response:
        secure = "s" if self._tls else ""
        url, viewer = f"ws{secure}://{request.host}/ws", f"http{secure}://{request.host}/vr"
        if is_loopback(request.url.host or "localhost"):  # another device cannot use this address
            viewer = "" if is_loopback(self._host) else self._outward(request)
        code = await self._codes.svg(viewer) if viewer else ""
        headers = {"Content-Security-Policy": STATUS_POLICY}
        text = page_html(self._server.stats(user_of(request)), url, viewer, code)
        return web.Response(text=text, content_type="text/html", headers=headers)

    async def _history(self, request: web.Request) -> web.Response:
        return web.json_response(self.history.fields())

    async def _reach(self, request: web.Request) -> web.Response:
        """Return the page's URL for another device, with a QR code that includes the token of the request.

        ``?room=NAME`` gives an invitation into a room.
        """
        local = is_loopback(self._host)
        room = request.query.get("room")
        page = self._outward(request) + (f"?room={quote(room, safe='')}" if room else "")
        kind, _, token = request.headers.get("Authorization", "").partition(" ")
        # the gate has checked the token of a server with tokens
        token = token.strip() if kind.lower() == "bearer" and self._server.stats(user_of(request))["token"] else ""
        if local:
            code = ""
        elif token:
            code = await self._codes.secret(f"{page}#token={quote(token)}")
        else:
            code = await self._codes.svg(page)
        headers = {"Cache-Control": "no-store"}
        return web.json_response({"page": page, "local": local, "svg": code}, headers=headers)

    def _outward(self, request: web.Request) -> str:
        """Return the page's URL under the request's host; for loopback, under this machine's name if it has one."""
        name = request.url.host or "localhost"
        if is_loopback(name) and not is_loopback(self._host):
            name = next(iter(reachable_at(self._host) + machine_names()[-1:]), name)
        name = f"[{name}]" if ":" in name else name
        return f"http{'s' if self._tls else ''}://{name}:{request.url.port}/vr"
