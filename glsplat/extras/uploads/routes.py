"""The routes of /avatars: order an avatar, query its state, insist, cancel or delete."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from aiohttp import web

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.extras.uploads.form import RefusedError, check_head, discard, read_order
from glsplat.extras.uploads.job import VIEWS, Job, UploadConfig
from glsplat.extras.uploads.job_queue import JobQueue
from glsplat.extras.uploads.upload_store import NoRoomError, UploadStore
from glsplat.net.backend import AvatarInfo
from glsplat.net.feature import Feature, ServerView
from glsplat.net.guard.gate import connection_of
from glsplat.net.guard.limits import Limits
from glsplat.net.rights import User, user_of

_NO_AVATAR = "there is no such avatar of yours\n"
MAX_EXTRA_BYTES = 2**20  # of a body beside its pictures: fields, boundaries, discarded data


class Uploads(Feature):
    """Uploads as a feature; ``describe(name, avatar)`` raises GlsplatError if the avatar cannot be shown."""

    def __init__(self, config: UploadConfig, describe: Callable[[str, Avatar], AvatarInfo]) -> None:
        self.config = config
        self.store: UploadStore = UploadStore(config.folder, config.max_avatars, config.folder_bytes)
        self._describe = describe

    def limits(self, limits: Limits) -> Limits:
        """Allow bodies as large as pictures before a request is checked."""
        return replace(limits, head=max(limits.head, limits.body))

    async def start(self, server: ServerView) -> None:
        """Start the job queue, whose avatars join the server's catalogue."""
        self._gate, self._clock = server.gate, server.clock
        self._withdraw, offer = server.withdraw, server.catalogue.add
        self._queue = JobQueue(self.config, self.store, lambda name, avatar: offer(self._describe(name, avatar)))
        self._queue.start()

    def routes(self) -> list[web.RouteDef]:
        """Return the routes of /avatars."""
        return [
            web.post("/avatars", self._post),
            web.get("/avatars/{name}", self._get),
            web.delete("/avatars/{name}", self._delete),
            web.post("/avatars/{name}/anyway", self._anyway),
        ]

    async def stop(self) -> None:
        """Cancel the job in work."""
        await self._queue.stop()

    def needs_cpu(self) -> bool:
        """Return whether an avatar is being made."""
        return self._queue.works

    def stats(self, user: User | None) -> Mapping[str, Any]:
        """Return the counts of jobs."""
        return {"uploads": self._queue.counts()}

    def session(self, user: User | None) -> Mapping[str, Any]:
        """Return which photographs avatars are made of, and how large they may be."""
        config = self.config
        return {"upload": {"views": VIEWS, "picture_bytes": config.picture_bytes, "body_bytes": config.body_bytes}}

    async def _post(self, request: web.Request) -> web.Response:
        connection, addresses = connection_of(request), self._gate.addresses
        try:
            wait = addresses.upload(connection.key, self._clock())
            if wait > 0:
                raise RefusedError(429, f"too many pictures from one address; try again in {wait:.0f} s", round(wait))
            connection.expect(self.config.body_bytes + MAX_EXTRA_BYTES)
            check_head(request, self.config)
            user = user_of(request)
            job = await self._book(connection.key, "" if user is None else user.name)
            begun = time.monotonic()
            try:
                self._queue.begin(job, await read_order(request, self.config))
            except BaseException as error:  # also cancellation, when the client disconnects
                self._queue.cancel(job)
                if not isinstance(error, RefusedError) or error.status == 408:
                    addresses.unfinished_upload(connection.key, self._clock(), time.monotonic() - begun)
                raise
        except RefusedError as refusal:
            return await self._refused(request, refusal)
        except ConnectionError:
            return web.Response(status=400)  # the client is gone
        return web.json_response(self._status(job), status=202, headers={"Location": f"avatars/{job.name}"})

    async def _book(self, address: str, account: str) -> Job:
        try:
            await asyncio.to_thread(self.store.check)
        except NoRoomError as full:
            raise RefusedError(507, str(full)) from None
        return self._queue.book(address, account)

    async def _get(self, request: web.Request) -> web.Response:
        job = self._job(request)
        return _not_found() if job is None else web.json_response(self._status(job))

    async def _anyway(self, request: web.Request) -> web.Response:
        """Resume a refused job. Its name, which no list contains, proves who ordered it."""
        job = self._job(request)
        if job is None:
            return _not_found()
        try:
            self._queue.go_on(job)
        except RefusedError as refusal:
            return _refusal_response(refusal)
        return web.json_response(self._status(job), status=202)

    async def _delete(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if not self.store.made_here(name):
            return web.Response(status=403, text="only avatars that were made here can be deleted\n")
        job = self._job(request)
        # the owner is that of the job, or without one that of the avatar's consent record
        may = self._queue.find(name) is None and self._gate.rights.may_delete(user_of(request), name)
        if job is None and not may:
            return web.Response(status=404, text=_NO_AVATAR)
        if job is not None:
            self._queue.cancel(job)
        offered = await self._withdraw(name)  # first, whether or not the file can be deleted
        try:
            removed = await asyncio.to_thread(self.store.remove, name)
        except GlsplatError as error:
            return web.Response(status=500, text=f"{error}\n")
        if job is None and not offered and not removed:
            return web.Response(status=404, text=_NO_AVATAR)
        return web.Response(status=204)

    def _job(self, request: web.Request) -> Job | None:
        """Return the job that a URL names; None if there is none or the user may not see it."""
        job = self._queue.find(request.match_info["name"])
        seen = job is not None and self._gate.rights.sees(user_of(request), "job", job.account)
        return job if seen else None

    async def _refused(self, request: web.Request, refusal: RefusedError) -> web.Response:
        if refusal.status not in (408, 429):  # those clients send too slowly or too often
            await discard(request, self.config)
        response = _refusal_response(refusal)
        response.force_close()
        return response

    def _status(self, job: Job) -> dict[str, Any]:
        return job.status(self._queue.ahead(job))


def _not_found() -> web.Response:
    return web.Response(status=404, text="there is no such avatar in the making\n")


def _refusal_response(refusal: RefusedError) -> web.Response:
    return web.Response(status=refusal.status, text=f"{refusal.text}\n", headers=refusal.headers)
