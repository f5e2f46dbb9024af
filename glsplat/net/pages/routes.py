"""Addresses of every server: the page, /healthz, /stats, /session and the embedded motions; headers of all answers."""

from __future__ import annotations

from functools import cache
from importlib import resources

from aiohttp import web

from glsplat.formats.motion_files import embedded_motions
from glsplat.net.feature import Feature, ServerView
from glsplat.net.pages.site import File, Site, page_files
from glsplat.net.rights import user_of

_HEADERS = {"X-Content-Type-Options": "nosniff", "Server": "glsplat"}
_DEFAULT_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",  # pages of other sites cannot embed or measure the answers
}

_RECORDING = "recording.jsonl"
_VOICE = "voice/panel.js"  # of extras/speech


class Pages(Feature):
    """The page at /vr and its files, and the server's state as JSON."""

    async def start(self, server: ServerView) -> None:
        """Keep the server, whose state the pages show."""
        self._server = server
        self._site = Site(page_files())

    def routes(self) -> list[web.RouteDef]:
        """Return the addresses of every server, without the WebSocket's."""
        return [
            web.get("/healthz", self._healthz),
            web.get("/stats", self._stats),
            web.get("/session", self._session),
            web.get("/motions/{name}", self._motion),
            web.get("/recording", self._recording),
            *self._site.routes(),
        ]

    async def _healthz(self, request: web.Request) -> web.Response:
        healthy = self._server.is_healthy()
        return web.Response(status=200 if healthy else 503, text="ok\n" if healthy else "not ready\n")

    async def _stats(self, request: web.Request) -> web.Response:
        return web.json_response(self._server.stats(user_of(request)))

    async def _session(self, request: web.Request) -> web.Response:
        own = {"motions": embedded_motions(), "recording": True, "voice": _VOICE in self._site.files}
        return web.json_response({"v": 1, **self._server.session(user_of(request)), **own})

    async def _motion(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in embedded_motions():
            return web.Response(status=404, text=f"the motions here are {', '.join(embedded_motions())}\n")
        return _embedded(f"{name}.json").answer(request)

    async def _recording(self, request: web.Request) -> web.Response:
        return _embedded(_RECORDING).answer(request)


async def set_headers(request: web.Request, response: web.StreamResponse) -> None:
    """Set the headers of every answer; an ``on_response_prepare`` signal of aiohttp."""
    response.headers.update(_HEADERS)
    for name, value in _DEFAULT_HEADERS.items():
        response.headers.setdefault(name, value)


@cache
def _embedded(name: str) -> File:
    return File(name, (resources.files("glsplat.data") / name).read_bytes())
