"""Every address of the server but the WebSocket's: which answers it, and what it says."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import resources
from urllib.parse import quote

from aiohttp import web

from glsplat.extras.browser.web_shaders import programs_json
from glsplat.extras.operations.history import History
from glsplat.extras.operations.metrics import metrics_text
from glsplat.extras.operations.qr import QrCodes
from glsplat.extras.operations.status import STATUS_POLICY, page_html
from glsplat.extras.speech.table import table_json
from glsplat.motion.loading import embedded_motions
from glsplat.net.feature import Feature, ServerView
from glsplat.net.guard.access import is_loopback
from glsplat.net.guard.machine import machine_names, reachable_at
from glsplat.net.pages.site import File, Site
from glsplat.net.rights import user_of

__all__ = ["Pages"]

_RECORDING = "recording.jsonl"
_TABLES: dict[str, Callable[[], bytes]] = {
    "draw/programs.json": programs_json,
    "voice/visemes.json": table_json,
}  # made, not read, for the page


class Pages(Feature):
    """The page, its files, and the server's numbers as JSON and text; keeps ``history`` while it runs."""

    def __init__(self, history: History) -> None:
        self.history = history
        self._codes = QrCodes()

    async def start(self, server: ServerView) -> None:
        """Begin the curves of the status page."""
        self._server, self._host, self._tls = server, server.config.access.host, server.config.tls is not None
        self.history.start(lambda: server.stats(None))

    async def stop(self) -> None:
        """End them."""
        await self.history.stop()

    def routes(self) -> list[web.RouteDef]:
        """Return all addresses but the WebSocket's."""
        return [
            web.get("/", self._status),
            web.get("/healthz", self._healthz),
            web.get("/stats", self._numbers),
            web.get("/metrics", self._metrics),
            web.get("/session", self._session),
            web.get("/history", self._history),
            web.get("/reach", self._reach),
            web.get("/motions/{name}", self._motion),
            web.get("/recording", self._recording),
            *Site(resources.files("glsplat.net") / "web", {path: made() for path, made in _TABLES.items()}).routes(),
        ]

    async def _healthz(self, request: web.Request) -> web.Response:
        healthy = self._server.is_healthy()
        return web.Response(status=200 if healthy else 503, text="ok\n" if healthy else "not ready\n")

    async def _numbers(self, request: web.Request) -> web.Response:
        return web.json_response(self._server.stats(user_of(request)))

    async def _metrics(self, request: web.Request) -> web.Response:
        return web.Response(
            text=metrics_text(self._server.stats(user_of(request))), content_type="text/plain", charset="utf-8"
        )

    async def _status(self, request: web.Request) -> web.Response:
        secure = "s" if self._tls else ""
        url, viewer = f"ws{secure}://{request.host}/ws", f"http{secure}://{request.host}/vr"
        if is_loopback(request.url.host or "localhost"):  # which is another machine to a phone
            viewer = "" if is_loopback(self._host) else self._outward(request)
        code = await self._codes.svg(viewer) if viewer else ""
        headers = {"Content-Security-Policy": STATUS_POLICY}
        text = page_html(self._server.stats(user_of(request)), url, viewer, code)
        return web.Response(text=text, content_type="text/html", headers=headers)

    async def _history(self, request: web.Request) -> web.Response:
        return web.json_response(self.history.fields())

    async def _reach(self, request: web.Request) -> web.Response:
        """The page's address for another device, as a QR code with the token that came with the request, if one did."""
        local = is_loopback(self._host)
        page = self._outward(request)
        kind, _, token = request.headers.get("Authorization", "").partition(" ")
        # the gate has checked it, where the server has tokens at all
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
        """The page's address by the name it was asked by; for localhost the machine's own, where it has one."""
        name = request.url.host or "localhost"
        if is_loopback(name) and not is_loopback(self._host):
            name = next(iter(reachable_at(self._host) + machine_names()[-1:]), name)
        name = f"[{name}]" if ":" in name else name
        return f"http{'s' if self._tls else ''}://{name}:{request.url.port}/vr"

    async def _session(self, request: web.Request) -> web.Response:
        embedded = {"motions": embedded_motions(), "recording": True}
        return web.json_response({"v": 1, **self._server.session(user_of(request)), **embedded})

    async def _motion(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in embedded_motions():
            return web.Response(status=404, text=f"the motions here are {', '.join(embedded_motions())}\n")
        return _embedded(f"{name}.json").answer(request)

    async def _recording(self, request: web.Request) -> web.Response:
        return _embedded(_RECORDING).answer(request)


@cache
def _embedded(name: str) -> File:
    return File(name, (resources.files("glsplat.data") / name).read_bytes())
