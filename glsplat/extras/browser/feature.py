"""Files from which browsers draw avatars, served by their hashes to permitted users (docs/consent.md)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from aiohttp import web

from glsplat.errors import GlsplatError
from glsplat.extras.browser.responder import PoseResponder
from glsplat.net.catalogue import Catalogue
from glsplat.net.feature import Feature, ServerView
from glsplat.net.options import ServerConfig
from glsplat.net.rights import User, user_of

log: logging.Logger = logging.getLogger("glsplat.net")

_MOST_JOINTS = 2000  # of a body on the wire, which has at most 65,535 bytes
_NOWHERE = "there are no such splats here\n"


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    data: bytes
    sha256: bytes
    first: int  # bytes until the coarsest level can be drawn


class SplatFiles(Feature):
    """Files of avatars whose consent permits handing out their splats. Each is made once and kept."""

    def __init__(self) -> None:
        self._files: dict[str, _File | None] = {}  # by name; None: cannot be made
        self._making = asyncio.Lock()

    async def start(self, server: ServerView) -> None:
        """Make the files."""
        self._offers, self._rights, self._worn = server.catalogue, server.gate.rights, server.worn_avatars
        await self.avatars_added()

    async def avatars_added(self) -> None:
        """Make the missing files in a thread. A file that cannot be made is logged and not handed out."""
        async with self._making:
            for name in self._offers.names:
                if name in self._files or self._offers[name].file is None or self._rights.withheld(name):
                    continue
                self._files[name] = await asyncio.to_thread(_made, self._offers, name)

    def avatar_withdrawn(self, name: str) -> None:
        """Drop the avatar's file."""
        self._files.pop(name, None)

    def pose_responder(self, server: ServerView) -> PoseResponder:
        """Return a responder for avatars whose files are handed out."""
        return PoseResponder(self.file_digest, server.gate.rights.withheld, server.clock)

    def file_digest(self, name: str) -> bytes | None:
        """Return the SHA-256 of an avatar's file; None if it is not handed out now."""
        file = self._files.get(name)
        return None if file is None or self._rights.withheld(name) else file.sha256

    def avatar_fields(self, name: str) -> Mapping[str, Any]:
        """Return ``hand_out`` of an avatar in /session: null if its file is not handed out."""
        file = self._files.get(name)
        if file is None or self._rights.withheld(name):
            return {"hand_out": None}
        digest = file.sha256.hex()
        url = f"splats/{digest}"
        return {"hand_out": {"sha256": digest, "bytes": len(file.data), "first": file.first, "url": url}}

    def routes(self) -> list[web.RouteDef]:
        """Return the route /splats/SHA256."""
        return [web.get("/splats/{sha256}", self._file)]

    async def _file(self, request: web.Request) -> web.Response:
        """Serve a file to users who may have it under any of its avatars' names."""
        asked, user = request.match_info["sha256"], user_of(request)
        worn, sees = self._worn(user), self._rights.sees
        here = [name for name, file in self._files.items() if file is not None and file.sha256.hex() == asked]
        names = [name for name in here if name in worn or sees(user, "avatar", name)]
        if not names:
            return web.Response(status=404, text=_NOWHERE)
        reasons = [self._rights.withheld(name) or self._unshown(user, name, worn) for name in names]
        if all(reasons):
            return web.Response(status=403, text=f"{reasons[0]}\n")
        found = self._files[names[0]]
        assert found is not None
        headers = {"ETag": f'"{asked}"', "Cache-Control": "private, max-age=31536000, immutable"}
        if any(tag.value in (asked, "*") for tag in request.if_none_match or ()):
            return web.Response(status=304, headers=headers)
        return web.Response(body=found.data, content_type="application/octet-stream", headers=headers)

    def _unshown(self, user: User | None, name: str, worn: set[str]) -> str:
        return "" if name in worn else self._rights.refusal(user, name)


def _made(offers: Catalogue, name: str) -> _File | None:
    one = offers[name]
    assert one.file is not None
    if one.skeleton is not None and len(one.skeleton) > _MOST_JOINTS:
        log.warning('"%s" is drawn by the server only: a body on the wire has at most %d joints', name, _MOST_JOINTS)
        return None
    try:
        made = one.file()
    except GlsplatError as error:
        log.warning('"%s" is drawn by the server only: %s', name, error)
        return None
    return _File(made.data, sha256(made.data).digest(), made.first)


def features(config: ServerConfig) -> list[Feature]:
    """Return the features of this extra, for every server."""
    return [SplatFiles()]
