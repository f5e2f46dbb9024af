"""Queue of upload jobs: one is in work, few wait. Runs on the event loop."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.extras.uploads.form import RefusedError
from glsplat.extras.uploads.job import Job, LowConfidenceError, Order, UploadConfig, notes_of
from glsplat.extras.uploads.upload_store import UploadStore
from glsplat.extras.uploads.work import Maker, MakerFaultError, UploadCancelledError

_KEEP_ENDED_S = 600.0  # for which an ended job can be queried
_MAX_ENDED = 64  # jobs that can be queried
_RETRY_S = 20

log: logging.Logger = logging.getLogger("glsplat.net")


class JobQueue:
    """Queue of jobs; ``made(name, avatar)`` is called once an avatar is stored."""

    def __init__(self, config: UploadConfig, store: UploadStore, made: Callable[[str, Avatar], None]) -> None:
        self._config, self._store, self._made = config, store, made
        self._jobs: dict[str, Job] = {}  # by name, oldest first; ended jobs included
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="make")
        self._wake = asyncio.Event()
        self._maker: Maker | None = None
        self._held: tuple[Job, Maker] | None = None  # a refused job that can be resumed ...
        self._held_timer: asyncio.TimerHandle | None = None  # ... until this timer ends
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start working on queued jobs."""
        self._task = asyncio.create_task(self._run(), name="make avatars")

    async def stop(self) -> None:
        """Cancel all jobs."""
        for job in list(self._jobs.values()):
            self.cancel(job)
        self._close_held()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._thread.shutdown(wait=True)  # quick, as its process was killed

    def book(self, address: str, account: str = "") -> Job:
        """Reserve a job for pictures that are still to come; ``cancel`` frees it. Raises RefusedError."""
        self._forget()
        self._check_space()
        most, mine = self._config.per_address, [job for job in self._open() if job.address == address]
        if len(mine) >= most:
            raise _busy(f"at most {most} avatars at once from one address; wait for one of yours")
        if sum(job.state == "receiving" for job in mine) >= self._config.senders:
            raise _busy("other pictures from this address are on their way; send yours after them")
        name = self._store.new_name()
        job = self._jobs[name] = Job(name, address, account)
        return job

    def begin(self, job: Job, order: Order) -> None:
        """Queue a job whose pictures have arrived."""
        if not job.cancelled:
            job.order, job.state = order, "waiting"
            self._wake.set()

    def go_on(self, job: Job) -> None:
        """Resume a refused job. Raises RefusedError if its process is gone or the queue is full."""
        if self._held is None or self._held[0] is not job:
            raise RefusedError(409, "it cannot be continued; send the pictures again")
        self._check_space()
        if self._held_timer is not None:
            self._held_timer.cancel()
        job.resume()
        self._wake.set()

    def find(self, name: str) -> Job | None:
        """Return the job of that name, also for some minutes after its end."""
        self._forget()
        return self._jobs.get(name)

    def ahead(self, job: Job) -> int:
        """Return the number of jobs before ``job``."""
        open_ = self._open()
        return open_.index(job) if job in open_ and job.state != "making" else 0

    def cancel(self, job: Job) -> None:
        """End and forget a job."""
        if job.ended is None:
            job.cancelled, job.order = True, None
            if job.state == "making" and self._maker is not None:
                self._maker.stop()
        if self._held is not None and self._held[0] is job:
            self._close_held()
        self._jobs.pop(job.name, None)

    @property
    def works(self) -> bool:
        """Whether a job is in work."""
        return self._maker is not None

    def counts(self) -> dict[str, int]:
        """Return the number of jobs by state, for /stats."""
        states = Counter(job.state for job in self._jobs.values())
        return {state: states[state] for state in ("receiving", "waiting", "making", "done", "failed")}

    def _check_space(self) -> None:
        count = len(self._open())
        if count > self._config.waiting:
            raise _busy(f"{count} avatars are being made or wait, as many as this server takes; try again in a minute")

    def _open(self) -> list[Job]:
        return [job for job in self._jobs.values() if job.ended is None]

    def _forget(self) -> None:
        now = time.monotonic()
        ended = [job for job in self._jobs.values() if job.ended is not None]
        for index, job in enumerate(ended):
            if now - (job.ended or now) > _KEEP_ENDED_S or index < len(ended) - _MAX_ENDED:
                del self._jobs[job.name]

    async def _run(self) -> None:
        while True:
            self._wake.clear()
            held = [] if self._held is None else [self._held[0]]  # resumed first: it holds memory
            job = next((job for job in (*held, *self._jobs.values()) if job.state == "waiting"), None)
            if job is None:
                await self._wake.wait()
            else:
                await self._make(job)

    def _close_held(self) -> None:
        """Forget the refused job that could be resumed, and end its process."""
        if self._held_timer is not None:
            self._held_timer.cancel()
        if self._held is not None:
            (job, maker), self._held = self._held, None
            job.goes_on = False
            self._thread.submit(maker.close)  # freeing gigabytes takes too long for the event loop

    async def _make(self, job: Job) -> None:
        order, job.order, job.state = job.order, None, "making"
        work = asyncio.get_running_loop().run_in_executor
        held = None
        if self._held is not None and self._held[0] is job:
            held, self._held = self._held[1], None
        self._close_held()  # memory suffices for one job at a time
        self._maker = maker = held or Maker(self._config)
        try:
            if held is not None:
                data = await work(self._thread, maker.go_on, job.progress)
            else:
                assert order is not None
                data = await work(self._thread, maker.make, order, job.progress)
            del order
            avatar = await work(self._thread, self._keep, job, data)
            if job.cancelled:  # while it was written
                await work(self._thread, self._store.remove, job.name)
                return
            self._made(job.name, avatar)
            job.done(notes_of(avatar.meta))
        except UploadCancelledError:
            pass
        except LowConfidenceError as error:
            job.fail(str(error), error.findings, maker.waits and not job.cancelled)
            if job.goes_on:
                self._held = job, maker
                loop = asyncio.get_running_loop()
                self._held_timer = loop.call_later(self._config.resume_timeout, self._close_held)
            else:
                maker.close()
        except GlsplatError as error:
            job.fail(str(error))
        except MakerFaultError as error:
            log.warning("an avatar could not be made: %s", error)
            job.fail("an error on the server; another picture may work")
        except asyncio.CancelledError:
            maker.stop()
            raise
        except Exception:
            log.exception("an avatar could not be saved")
            job.fail("the server could not save it")
        finally:
            self._maker = None

    def _keep(self, job: Job, data: bytes) -> Avatar:
        if job.cancelled:
            raise UploadCancelledError
        if self._config.signed is not None:
            data = self._config.signed(job.name, data, job.account)
        return self._store.put(job.name, data)


def _busy(text: str) -> RefusedError:
    return RefusedError(503, text, _RETRY_S)
