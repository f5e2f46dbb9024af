"""The running session: the state machine, its log on disk and its quota, a clock, and the pages' state.

An event is written and synced first, then the state changes, then pages are notified. Time is monotonic; the wall clock
only measures how long a server was down.
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
from glsplat.extras.study.plan import Plan, label, steps_of
from glsplat.extras.study.questionnaires import Item
from glsplat.extras.study.session import Event, Session
from glsplat.extras.study.store import Store
from glsplat.net.guard.limits import Bucket

log: logging.Logger = logging.getLogger("glsplat.extras.study")

MAX_LOG_BYTES = 64 << 20
"""Size of a session's log; an hour of a study with 100 questions writes about 30 kB.

A participant's link may append up to it, at a limited rate; beyond it only necessary events are written: first answers,
finished questionnaires, tasks that begin.
"""
RATE_BYTES_S = 4096.0
BURST_BYTES = 1 << 20  # twenty answers of 4000 characters, each escaped to 12 bytes

PAGE_TIMEOUT_S = 5.0  # silence after which the participant's page counts as gone

MAX_NOTES = 50  # newest notes shown to the experimenter
_TICK_S = 0.1
_RETRY_S = 1.0  # after a failed write
MAX_DOWNTIME_S = 400 * 86400.0  # of a server; a larger value means a wrong clock


class QuotaError(ProtocolError):
    """A limit is exceeded; ``wait`` is the number of seconds until the next try."""

    def __init__(self, message: str, code: str, wait: int | None = None) -> None:
        super().__init__(message, code)
        self.wait = wait


class Live:
    """One participant's session. Call ``open`` once, then ``act``. Used on one event loop."""

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
        self.notes: deque[Event] = deque(maxlen=MAX_NOTES)
        self._last_t = 0.0  # of the events at the start
        self._opened: Event | None = None  # the last event of kind "open" at the start
        self.store = Store(data, participant, self._replay)
        self.revision = 1
        self.page = ""  # name of the participant's active page
        self.trouble = ""  # error of a failed write
        self.figures: dict[str, Any] = {}  # last speed report of the page
        self.changed: Callable[[], None] = lambda: None  # called on every change
        self._clock, self._wall = clock, wall
        self._quota = Bucket.full(RATE_BYTES_S, BURST_BYTES, clock())  # of the participant's link
        self._started = self._offset = 0.0  # set by ``open``
        self._seen: float | None = None  # last message of the page, by ``clock``
        self._lock = asyncio.Lock()
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    @property
    def t(self) -> float:
        """Seconds since the session began."""
        return self._offset + self._clock() - self._started

    @property
    def present(self) -> bool:
        """Whether the participant's page is connected."""
        return self._seen is not None and self._clock() - self._seen < PAGE_TIMEOUT_S

    @property
    def condition(self) -> Condition | None:
        """The current condition; None outside conditions."""
        step = self.session.step
        return None if step is None or not step.condition else self.study.condition(step.condition)

    def touch(self) -> None:
        """Record a message of the page."""
        self._seen = self._clock()

    async def open(self) -> None:
        """Log that a server opened the session, and start the clock. Raises FormatError."""
        self._started, self._offset = self._clock(), resumed_at(self._last_t, self._opened, self._wall())
        if self.session.step is not None:
            values: dict[str, Any] = {"wall": self._utc(), "study": self.study.digest}
            if self.store.torn:
                values["torn_bytes"] = self.store.torn
            await self.act(lambda t: self.session.open(t, values))
        self._task = asyncio.create_task(self._run(), name="study")

    async def close(self) -> None:
        """Stop the clock and close the log."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        async with self._lock:
            self.store.close()

    async def act(self, make: Callable[[float], Sequence[Event]], *, link: bool = False) -> None:
        """Write and apply the events of ``make``; ``link``: by the participant's link, within its quota.

        Raises ProtocolError for a refused action, FormatError for a failed write.
        """
        # not cancelled with the request: events on disk have to be applied
        await asyncio.shield(asyncio.ensure_future(self._act(make, link)))

    async def enter(self, page: str) -> None:
        """Make another page the active one; a running task restarts."""
        if page != self.page:
            await self.act(self.session.page_lost, link=True)
            self.page = page
            self._notify()
        self.touch()

    async def wait(self, revision: int, seconds: float) -> None:
        """Wait until the state differs from ``revision``, for at most ``seconds``."""
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
                self._check_quota(size, any(map(self.session.makes_progress, events)))
            try:
                await asyncio.to_thread(self.store.append, events)
            except GlsplatError as error:
                self.trouble = str(error)
                self._notify()
                raise
            self.trouble = ""
            if link:
                self._quota.charge(self._clock(), self.store.size - size)
            for event in events:
                self.session.apply(event)
                if event.kind == "note":
                    self.notes.append(event)
            self._notify()

    def _check_quota(self, size: int, makes_progress: bool) -> None:
        """Raise QuotaError: "full" for a log of ``size`` bytes unless the event is needed, "rate" for a high rate.

        One message may overdraw the rate; the next one waits.
        """
        if size >= MAX_LOG_BYTES and not makes_progress:
            raise QuotaError(
                f"the log of this session is full ({MAX_LOG_BYTES >> 20} MiB): saved answers stay, "
                "and a running task is not restarted",
                "full",
            )
        if (left := self._quota.left(self._clock())) <= 0:
            wait = math.ceil(-left / self._quota.rate) or 1
            raise QuotaError(f"answers arrive faster than they can be saved; try again in {wait} s", "rate", wait)

    def _replay(self, event: Event) -> None:
        """Apply an event that was in the log at the start."""
        self.session.replay(event)
        self._last_t = max(self._last_t, event.t)
        if event.kind == "open":
            self._opened = event
        elif event.kind == "note":
            self.notes.append(event)

    def _notify(self) -> None:
        self.revision += 1
        self._news.set()
        self._news.clear()
        self.changed()

    async def _run(self) -> None:
        """End phases in time while the participant's page is connected."""
        while True:
            pause = _TICK_S
            left = self.session.left(self.t)
            due = left is not None and left <= 0
            if due or not self.present:
                try:
                    await self.act(self.session.tick if self.present else self.session.page_lost)
                except GlsplatError as error:
                    log.error("%s", error)
                    pause = _RETRY_S
                except Exception:
                    log.exception("the session cannot continue")
                    pause = _RETRY_S
            await asyncio.sleep(pause)

    def _utc(self) -> str:
        return datetime.fromtimestamp(self._wall(), UTC).isoformat(timespec="seconds")


def resumed_at(last: float, opened: Event | None, now: float) -> float:
    """Return the seconds since the session began, by the wall clock of the last ``opened``; at least ``last``."""
    if opened is None:
        return last
    try:
        away = now - datetime.fromisoformat(opened.values["wall"]).timestamp()
    except (KeyError, TypeError, ValueError):
        return last
    return max(last, opened.t + away) if math.isfinite(away) and 0 <= away < MAX_DOWNTIME_S else last


def wrong_page() -> ProtocolError:
    """Return the error for a page that is not the active one."""
    return ProtocolError("the study is open on another page; reload this one to continue here", "elsewhere")


def for_participant(live: Live) -> dict[str, Any]:
    """Return the current step with its text or questions."""
    session = live.session
    step, state, left = session.step, session.state, session.left(live.t)
    shown: dict[str, Any] = {
        "revision": live.revision,
        "title": live.study.title,
        "ended": state.ended,
        "paused": state.paused,
        "number": state.at + 1,
        "of": len(session.steps),
        "trouble": bool(live.trouble),
        "condition": None
        if live.condition is None
        else {"view": live.condition.view, "latency": live.condition.latency},
    }
    if step is None:
        return shown
    shown |= {"step": step.alias, "kind": step.kind, "phase": state.phase, "attempt": state.attempt}
    shown["left"] = None if left is None else round(left, 2)
    if step.kind == "consent":
        shown["text"] = live.study.consent
    task = session.task
    if task is not None:
        shown |= {"text": task.text, "speak": task.speak, "ready": task.ready, "seconds": task.seconds}
    if step.questionnaire:
        asked = live.study.questionnaires[step.questionnaire]
        shown |= {"intro": asked.intro, "items": list(map(_item, asked.items)), "answers": dict(state.answers)}
    return shown


def for_experimenter(live: Live) -> dict[str, Any]:
    """Return the current step without its questions, and the state of the session."""
    session = live.session
    step = session.step
    shown = live.condition
    return {
        "revision": live.revision,
        "study": live.study.title,
        "participant": live.participant,
        "t": round(live.t, 1),
        "step": "" if step is None else step.name,
        "kind": "" if step is None else step.kind,
        "phase": session.state.phase,
        "attempt": session.state.attempt,
        "left": session.left(live.t),
        "paused": session.state.paused,
        "ended": session.state.ended,
        "number": session.state.at + 1,
        "condition": None if shown is None else shown.name,
        "shown": None if shown is None else {"view": shown.view, "latency": shown.latency, "hands": shown.hands},
        "answered": len(session.state.answers),
        "items": 0
        if step is None or not step.questionnaire
        else len(live.study.questionnaires[step.questionnaire].items),
        "present": live.present,
        "figures": live.figures,
        "trouble": live.trouble,
        "notes": [{"t": round(note.t, 1), "text": note.values["text"]} for note in live.notes],
        "steps": [one.name for one in session.steps],
    }


def _item(item: Item) -> dict[str, Any]:
    scale = item.scale
    fields: dict[str, Any] = {"name": item.name, "text": item.text, "kind": scale.kind, "labels": list(scale.labels)}
    if scale.kind in ("points", "slider"):
        fields |= {"from": scale.low, "to": scale.high, "step": scale.step}
    return fields | {"required": item.required}
