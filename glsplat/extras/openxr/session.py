"""Session: the frame loop and session states of the specification (OpenXR 1.1, 9.3 and 11.5).

It calls neither OpenGL nor pyopenxr: a ``Show`` draws. After a loss it closes the runtime and reconnects, with growing
pauses.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from glsplat.errors import ContextError, ContextLostError
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.runtime import Blend, FrameTiming, Projection, State
from glsplat.net.flow import Backoff

_IDLE = 0.02  # seconds between polls of a session that does not run
_PATIENCE = 3.0  # seconds for the runtime to end the session after request_exit
_MEASURED = 512  # frames of the median overhead


@dataclass(frozen=True, slots=True)
class Shown:
    """Result of a frame."""

    projection: Projection | None
    located: float  # when the views were located: seconds of time.perf_counter
    drawing: float  # seconds of drawing since then


class Show(Protocol):
    """Draws frames. All calls come from the session's thread; any may raise ContextLostError of the runtime."""

    def attach(self, runtime: OpenXrRuntime) -> None:
        """Make the swapchains of a connected runtime."""

    def frame(self, runtime: OpenXrRuntime, timing: FrameTiming, focused: bool) -> Shown:
        """Draw for the display time of ``timing``, between begin and end of a frame."""

    def recentred(self) -> None:
        """Place the view again: the origin of the user's space has changed."""

    def detach(self) -> None:
        """Release the swapchains of a runtime that ends or is lost."""


class Session:
    """A session: run ``while session.step(): ...``, until the runtime or ``quit()`` ends it, then ``close()``."""

    def __init__(
        self,
        connect: Callable[[], OpenXrRuntime],
        show: Show,
        blend: Blend = "opaque",
        say: Callable[[str], None] = lambda _: None,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect at once. Raises ContextError of ``connect``, one line."""
        self._connect, self._show, self._say = connect, show, say
        self.blend: Blend = blend
        self._clock, self._sleep = clock, sleep
        self.state: State = State.UNKNOWN
        self.frames = 0  # ended frames, with or without a picture
        self.rendered = 0  # ended frames with a picture
        self.losses = 0  # lost runtimes
        self._running = False  # between xrBeginSession and xrEndSession
        self._quit: float | None = None  # deadline for leaving
        self._over = False
        self._recentre: int | None = None  # display time at which the space changes
        self._overheads: deque[float] = deque(maxlen=_MEASURED)
        self._backoff = Backoff()
        self._again = 0.0
        self.runtime: OpenXrRuntime | None = None  # None after a loss
        self._open()

    @property
    def focused(self) -> bool:
        """Whether this application receives the user's input."""
        return self.state is State.FOCUSED

    @property
    def overhead_ms(self) -> float:
        """Median milliseconds from located views to the end of the frame, without drawing."""
        ordered = sorted(self._overheads)
        return ordered[len(ordered) // 2] * 1e3 if ordered else 0.0

    def quit(self) -> None:
        """Request the end of the session; call ``step`` until it returns False."""
        if self._quit is not None:
            return
        self._quit = self._clock() + _PATIENCE
        if self.runtime is None or not self._running:
            self._over = True
            return
        try:
            self.runtime.request_exit()
        except ContextLostError:
            self._over = True

    def step(self) -> bool:
        """Run one frame, or poll a session that does not run. Returns False when it is over."""
        if self._over or (self._quit is not None and self._clock() > self._quit):
            return False
        if self.runtime is None:
            self._reopen()
            return True
        try:
            self._listen(self.runtime)
            if self._over:
                return False
            if self._running:
                self._frame(self.runtime)
            else:
                self._sleep(_IDLE)
        except ContextLostError as error:
            self._lose(str(error))
        return not self._over

    def close(self) -> None:
        """Release everything."""
        self._drop()
        self._over = True

    # ---------------------------------------------------------------------------------------------------- a frame

    def _frame(self, runtime: OpenXrRuntime) -> None:
        timing = runtime.wait_frame()
        if self._recentre is not None and timing.display_time >= self._recentre:
            self._recentre = None
            self._show.recentred()
        runtime.begin_frame()
        shown = None
        try:
            if timing.should_render:
                shown = self._show.frame(runtime, timing, self.focused)
        except BaseException:
            with suppress(ContextLostError):  # end every frame that was begun
                runtime.end_frame(timing.display_time, None, self._blend(runtime))
            raise
        projection = None if shown is None else shown.projection
        runtime.end_frame(timing.display_time, projection, self._blend(runtime))
        self.frames += 1
        if shown is not None and projection is not None:
            self.rendered += 1
            self._overheads.append(self._clock() - shown.located - shown.drawing)

    def _blend(self, runtime: OpenXrRuntime) -> Blend:
        """Return the chosen blend mode, or the runtime's first if it lacks that."""
        return self.blend if self.blend in runtime.blends or not runtime.blends else runtime.blends[0]

    def _listen(self, runtime: OpenXrRuntime) -> None:
        while (event := runtime.poll()) is not None:
            if event.kind == "lost":
                raise ContextLostError(f"{runtime.name} is going")
            if event.kind == "recentred":
                self._recentre = event.time
                continue
            self.state = event.state
            if event.state is State.READY:
                runtime.begin()
                self._running = True
            elif event.state is State.STOPPING:
                self._running = False
                runtime.end()
            elif event.state is State.LOSS_PENDING:
                raise ContextLostError(f"{runtime.name} ends the session")
            elif event.state is State.EXITING:
                self._over = True

    # -------------------------------------------------------------------------------------- connect, lose, reconnect

    def _open(self) -> None:
        runtime = self._connect()
        self.state, self._running, self._recentre = State.UNKNOWN, False, None
        try:
            self._show.attach(runtime)
        except BaseException:
            self._show.detach()
            runtime.close()
            raise
        self.runtime = runtime

    def _reopen(self) -> None:
        if self._clock() < self._again:
            self._sleep(_IDLE)
            return
        try:
            self._open()
        except ContextError as error:  # not there yet
            self._wait(str(error))
            return
        self._backoff.connected()
        assert self.runtime is not None
        self._say(f"{self.runtime.name} is back")

    def _lose(self, why: str) -> None:
        self.losses += 1
        self._drop()
        if self._quit is not None:
            self._over = True
            return
        self._wait(why)

    def _wait(self, why: str) -> None:
        pause = self._backoff.pause()
        self._again = self._clock() + pause
        self._say(f"{why}; trying again in {pause:g} s")

    def _drop(self) -> None:
        runtime, self.runtime = self.runtime, None
        self._running, self.state = False, State.UNKNOWN
        if runtime is not None:
            try:
                self._show.detach()
            finally:
                runtime.close()
