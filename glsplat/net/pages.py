"""Addresses of every server: the page for headsets (/vr), /healthz, /stats, /session and the embedded motions.

The page's files are read once and served from memory. They need no token: they contain nothing about the scene or the
clients.
"""

from __future__ import annotations

import gzip
import posixpath
import re
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib import resources
from importlib.resources.abc import Traversable

from aiohttp import web

from glsplat.formats.motion_files import embedded_motions
from glsplat.net.feature import Feature, ServerView
from glsplat.net.rights import user_of
from glsplat.optional import plugin

_TYPES = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "json": "application/json",
    "jsonl": "application/jsonl",
    "svg": "image/svg+xml",
    "png": "image/png",
    "jpg": "image/jpeg",
    "ico": "image/x-icon",
    "txt": "text/plain",
}
_SCRIPT = re.compile(rb'<script type="module" src="([^"]+)">')
STATIC_IMPORT = re.compile(
    rb"""^(?:import|export|\}) (?:[^'"\n]*? from )?['"](\.[^'"]+)['"]""", re.MULTILINE
)  # static imports of a module; no import() calls
_TEXT = ("html", "css", "js", "json", "jsonl", "svg", "txt")

_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "worker-src 'self'; img-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Permissions-Policy": "xr-spatial-tracking=(self)",
}


class File:
    """A file in memory. Browsers cache it and revalidate it each time (ETag). Text is sent with gzip if accepted."""

    def __init__(self, name: str, body: bytes) -> None:
        suffix = name.rpartition(".")[2]
        self.body: bytes = body
        self.etag: str = sha256(self.body).hexdigest()[:32]
        self._type = _TYPES[suffix] + ("; charset=utf-8" if suffix in _TEXT else "")
        packed = gzip.compress(body, mtime=0) if suffix in _TEXT else body
        self._packed = packed if len(packed) < len(body) else None

    def answer(self, request: web.Request) -> web.Response:
        """Return 200 with the file, or 304 for a browser that has it."""
        packs = self._packed is not None and "gzip" in request.headers.get("Accept-Encoding", "")
        tag = f"{self.etag}-gz" if packs else self.etag
        headers = {"ETag": f'"{tag}"', "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        if any(known.value in (tag, "*") for known in request.if_none_match or ()):
            return web.Response(status=304, headers=headers)
        if packs:
            headers["Content-Encoding"] = "gzip"
        return web.Response(body=self._packed if packs else self.body, headers={**headers, "Content-Type": self._type})


def page_folders() -> dict[str, Traversable]:
    """Return the page's folders: ``net/web`` of the core by "", and the folder ``web`` of each extra that has one."""
    extras = {entry.name: entry / "web" for entry in resources.files("glsplat.extras").iterdir()}
    return {"": resources.files("glsplat.net") / "web"} | {n: folder for n, folder in extras.items() if folder.is_dir()}


def page_files() -> dict[str, bytes]:
    """Return the page's files by their paths below /vr, from all its folders, and the shaders of extras/browser."""
    files = {path: body for folder in page_folders().values() for path, body in read_folder(folder)}
    shaders = plugin("browser.web_shaders")
    return files if shaders is None else files | {"draw/programs.json": shaders.programs_json()}


class Site:
    """Files by their paths below /vr. No path of a request reaches the disk."""

    def __init__(self, bodies: Mapping[str, bytes]) -> None:
        self.files: dict[str, File] = {
            path: File(path, preloading(path, bodies) if path.endswith(".html") else body)
            for path, body in bodies.items()
        }

    def routes(self) -> list[web.RouteDef]:
        """Return the routes of /vr and of all below it."""
        return [web.get("/vr", self._without_slash), web.get("/vr/{path:.*}", self._file)]

    async def _without_slash(self, request: web.Request) -> web.Response:
        """Redirect to the slash by a relative address: a proxy may serve the page under another path."""
        query = request.rel_url.raw_query_string
        return web.Response(status=308, headers={"Location": "vr/" + (f"?{query}" if query else "")})

    async def _file(self, request: web.Request) -> web.Response:
        file = self.files.get(request.match_info["path"] or "index.html")
        if file is None:
            response = web.Response(status=404, text="there is no such file\n")
        else:
            response = file.answer(request)
        response.headers.update(_HEADERS)
        return response


def preloading(path: str, bodies: Mapping[str, bytes]) -> bytes:
    """Return the page at ``path`` with preload links (HTML, 4.6.7.12) to all modules that its script imports.

    Without them a browser needs a round trip for each level of the import tree.
    """
    page = bodies[path]
    script = _SCRIPT.search(page)
    if script is None:
        return page
    first = posixpath.normpath(posixpath.join(posixpath.dirname(path), script[1].decode()))
    found = [first]
    for module in found:  # breadth first: the list grows meanwhile
        for name in STATIC_IMPORT.findall(bodies.get(module, b"")):
            other = posixpath.normpath(posixpath.join(posixpath.dirname(module), name.decode()))
            if other not in found and other in bodies:
                found.append(other)
    names = (posixpath.relpath(module, posixpath.dirname(path) or ".") for module in found)
    links = "".join(f'<link rel="modulepreload" href="{name}">\n  ' for name in names)
    return page[: script.start()] + links.encode() + page[script.start() :]


def read_folder(folder: Traversable, prefix: str = "") -> list[tuple[str, bytes]]:
    """Return the files of known types by their paths in the folder."""
    found: list[tuple[str, bytes]] = []
    for entry in folder.iterdir():
        if entry.is_dir():
            found += read_folder(entry, f"{prefix}{entry.name}/")
        elif entry.name.rpartition(".")[2] in _TYPES:
            found.append((prefix + entry.name, entry.read_bytes()))
    return found


_EVERY_ANSWER = {"X-Content-Type-Options": "nosniff", "Server": "glsplat"}
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
    response.headers.update(_EVERY_ANSWER)
    for name, value in _DEFAULT_HEADERS.items():
        response.headers.setdefault(name, value)


@cache
def _embedded(name: str) -> File:
    return File(name, (resources.files("glsplat.data") / name).read_bytes())
