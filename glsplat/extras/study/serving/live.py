"""The session that runs: the pure state, its log on disk, a clock, and who is looking.

Nothing happens that is not on disk: an event is written and synced first, then the state changes, then pages hear of
it. Time is that of a clock which nobody sets; the wall clock only says how long a server was away.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.study.design import Condition, Study
from glsplat.extras.study.plan import Plan, label
from glsplat.extras.study.serving.quota import LinkQuota
from glsplat.extras.study.session import Event, Session
from glsplat.extras.study.steps import steps_of
from glsplat.extras.study.store import Store

__all__ = ["GONE", "Live", "resumed_at", "wrong_page"]

log: logging.Logger = logging.getLogger("glsplat.extras.study")

GONE = 5.0
"""Seconds without a word of the participant's page until it counts as gone."""

_NOTES = 50  # of the experimenter, the newest, shown on their page
_TICK = 0.1  # seconds between two looks at the time
_AGAIN = 1.0  # seconds until what could not be written is tried again
_AWAY = 400 * 86400.0  # seconds that a server may have been away; a clock that says more is wrong


class Live:
    """One participant's session. ``open`` once; from then on ``act``. Methods belong to one event loop."""

    def __init__(
        self,
        study: Study,
        plan: Plan,
        participant: int,
        data: Path,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self.study, self.participant = study, label(participant)
        self.session = Session(study, steps_of(study, plan, participant))
        self.notes: deque[Event] = deque(maxlen=_NOTES)
        self._last_t = 0.0  # of the events at the start
        self._opened: Event | None = None  # the last of them that took the session up
        self.store = Store(data, participant, self._replay)
        self.revision = 1
        self.page = ""  # the one page of the participant that counts
        self.trouble = ""  # why something is not on disk
        self.figures: dict[str, Any] = {}  # what the page said last of its speed
        self.changed: Callable[[], None] = lambda: None  # hears of every change
        self._clock, self._wall = clock, wall
        self._quota = LinkQuota(clock())
        self._started = self._offset = 0.0  # set by ``open``
        self._seen: float | None = None  # when the page said something, by ``clock``
        self._lock = asyncio.Lock()
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    @property
    def t(self) -> float:
        """Seconds since the session began."""
        return self._offset + self._clock() - self._started

    @property
    def present(self) -> bool:
        """Whether the participant's page is there."""
        return self._seen is not None and self._clock() - self._seen < GONE

    @property
    def condition(self) -> Condition | None:
        """What is shown now; None before the first condition, between and after them."""
        step = self.session.step
        return None if step is None or not step.condition else self.study.condition(step.condition)

    def seen(self) -> None:
        """The page said something."""
        self._seen = self._clock()

    async def open(self) -> None:
        """Write down that a server took the session up, and let time pass from now on. Raises FormatError."""
        self._started, self._offset = self._clock(), resumed_at(self._last_t, self._opened, self._wall())
        if self.session.step is not None:
            values: dict[str, Any] = {"wall": self._utc(), "study": self.study.digest}
            if self.store.torn:
                values["torn_bytes"] = self.store.torn
            await self.act(lambda t: self.session.open(t, values))
        self._task = asyncio.create_task(self._run(), name="study")

    async def close(self) -> None:
        """Let no more time pass."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        async with self._lock:
            self.store.close()

    async def act(self, make: Callable[[float], Sequence[Event]], *, link: bool = False) -> None:
        """Do what ``make`` says of the moment; ``link``: by the participant's link, within its quota.

        Raises ProtocolError where it may not be, FormatError of the disk.
        """
        # whoever asked may be gone before the disk answers: what is on disk has to become the state all the same
        await asyncio.shield(asyncio.ensure_future(self._act(make, link)))

    async def enter(self, page: str) -> None:
        """Another page of the participant takes over; a task that was under way begins anew."""
        if page != self.page:
            await self.act(self.session.lost, link=True)
            self.page = page
            self._tell()
        self.seen()

    async def wait(self, revision: int, seconds: float) -> None:
        """Until the state is another than ``revision``, or so many seconds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while self.revision == revision:
                    await self._news.wait()

    async def _act(self, make: Callable[[float], Sequence[Event]], link: bool) -> None:
        async with self._lock:
            events, size = make(self.t), self.store.size
            if not events:
                return
            if link:
                self._quota.check(self._clock(), size, any(map(self.session.leads_on, events)))
            try:
                await asyncio.to_thread(self.store.append, events)
            except GlsplatError as error:
                self.trouble = str(error)
                self._tell()
                raise
            self.trouble = ""
            if link:
                self._quota.charge(self._clock(), self.store.size - size)
            for event in events:
                self.session.apply(event)
                if event.kind == "note":
                    self.notes.append(event)
            self._tell()

    def _replay(self, event: Event) -> None:
        """An event that was in the log at the start."""
        self.session.replay(event)
        self._last_t = max(self._last_t, event.t)
        if event.kind == "open":
            self._opened = event
        elif event.kind == "note":
            self.notes.append(event)

    def _tell(self) -> None:
        self.revision += 1
        self._news.set()
        self._news.clear()
        self.changed()

    async def _run(self) -> None:
        """Time passes while the participant's page is there."""
        while True:
            pause = _TICK
            left = self.session.left(self.t)
            due = left is not None and left <= 0
            if due or not self.present:
                try:
                    await self.act(self.session.tick if self.present else self.session.lost)
                except GlsplatError as error:
                    log.error("%s", error)
                    pause = _AGAIN
                except Exception:
                    log.exception("the session cannot go on")
                    pause = _AGAIN
            await asyncio.sleep(pause)

    def _utc(self) -> str:
        return datetime.fromtimestamp(self._wall(), UTC).isoformat(timespec="seconds")


def resumed_at(last: float, opened: Event | None, now: float) -> float:
    """Seconds since the session began, by the wall clock of the last ``opened``; never before ``last``, the log's."""
    if opened is None:
        return last
    try:
        away = now - datetime.fromisoformat(opened.values["wall"]).timestamp()
    except (KeyError, TypeError, ValueError):
        return last
    return max(last, opened.t + away) if math.isfinite(away) and 0 <= away < _AWAY else last


def wrong_page() -> ProtocolError:
    """Another page of the same participant has taken over."""
    return ProtocolError("the study goes on on another page; reload this one to go on here", "elsewhere")
