"""AdaptiveQuality: holds a rate of pictures by reducing their detail: first the level of detail, then the size.

Detail is restored when there is time again. The wait grows each time that was too early, so that it does not
oscillate. Times come in as arguments. The link's limits are decided elsewhere (link_control.py); ``Detail`` carries
them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glsplat.camera import Camera
from glsplat.net.pace.ladder import SCALES, Rung

BIAS = 0.5
"""Halvings of the splats' density for each step of the level of detail."""

_MAX_STEPS = 16  # of the level of detail
_MEDIAN_OF, _MEDIAN_OF_SLOW = 8, 3  # pictures before a decision, and of those that are far too slow
_IGNORED_FIRST = 2  # pictures after a change: they include its one-time costs
_MAX_STEPS_AT_ONCE = 2  # of the level of detail: pictures may be slow for a moment only
_FAR_TOO_SLOW = 1.5  # of the available time
_HEADROOM = 0.85  # of the available time, for the expected time of the next finer step
_HOLD_S, _MAX_HOLD_S = 2.0, 60.0  # before detail is restored, at first and at most
_TOO_EARLY_S = 5.0  # pictures that are too slow within that time were restored too early
_LOAD_WINDOW_S = 1.0  # over which a viewer's load is measured
_MAX_COST_RATIO = 2.0  # of a finer level to the present one


@dataclass(frozen=True, slots=True)
class Detail:
    """The detail of a picture."""

    bias: float = 0.0  # added to RenderConfig.lod_bias
    scale: float = 1.0  # of its sides
    rung: Rung | None = None  # that the link requires; None: the link takes the full picture

    def within(self, rung: Rung) -> Detail:
        """Return this detail limited to ``rung``, by the smaller of both scales."""
        return self if rung.full else Detail(self.bias, min(self.scale, rung.scale), rung)

    def fields(self, levels: Sequence[int]) -> dict[str, Any]:
        """Return ``detail`` of a reply."""
        fields: dict[str, Any] = {"levels": levels, "bias": self.bias, "scale": self.scale}
        return fields if self.rung is None else fields | {"quality": self.rung.quality, "why": "link"}

    def resized(self, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        """Return the cameras at this scale, of at least one pixel a side."""
        if self.scale == 1:
            return tuple(cameras)
        return tuple(
            camera.resized(max(1, round(camera.width * self.scale)), max(1, round(camera.height * self.scale)))
            for camera in cameras
        )


FULL = Detail()


@dataclass(slots=True)
class _State:
    """The state of one viewer."""

    rate: float  # pictures a second to hold
    steps: int = 0  # of the level of detail
    scale: int = 0  # index of SCALES
    times: deque[float] = field(default_factory=lambda: deque(maxlen=_MEDIAN_OF))  # seconds of the last pictures
    took: dict[tuple[int, int], float] = field(default_factory=dict)  # median seconds by (steps, scale), the latest
    hold: float = _HOLD_S
    since: float = 0.0  # when the detail changed last
    better: float | None = None  # when detail was restored last; None: it was reduced since
    seen: float = 0.0
    coarsest: bool = False
    drawn: int = 0  # pictures since the detail changed
    spent: deque[tuple[float, float]] = field(default_factory=deque)  # (when, seconds) of the last _LOAD_WINDOW_S

    def load(self, now: float) -> float:
        """Return the share of the renderer's time that the viewer's pictures took lately."""
        while self.spent and now - self.spent[0][0] > _LOAD_WINDOW_S:
            self.spent.popleft()
        return sum(seconds for _, seconds in self.spent) / _LOAD_WINDOW_S


class AdaptiveQuality:
    """Chooses the detail of each viewer's pictures, so that each gets ``rate`` pictures a second; None: no target."""

    def __init__(self, rate: float | None) -> None:
        self.rate = rate
        self._states: dict[int, _State] = {}

    def detail(self, viewer: int, now: float, least: float | None = None) -> Detail:
        """Return the detail of a viewer's next picture; ``now`` in seconds.

        ``least`` is the viewer's rate where there is no target; without either the detail is full.
        """
        rate = self.rate or least
        if rate is None:
            return FULL
        state = self._states.setdefault(viewer, _State(rate, since=now))
        state.seen = now
        for gone in [one for one, other in self._states.items() if now - other.seen > 60 * _LOAD_WINDOW_S]:
            del self._states[gone]
        return Detail(-BIAS * state.steps, SCALES[state.scale])

    def drawn(self, viewer: int, seconds: float, coarsest: bool, now: float, smaller: bool = False) -> None:
        """Note a picture that took ``seconds``; ``coarsest``: no item in it has a coarser level.

        ``smaller``: it was smaller than its ``detail``, so it can prove that detail too slow, but not fast enough.
        """
        state = self._states.get(viewer)
        if state is None:
            return
        state.spent.append((now, seconds))
        state.coarsest = coarsest
        state.drawn += 1
        if state.drawn <= _IGNORED_FIRST:
            return
        state.times.append(seconds)
        took = float(np.median(state.times))
        own = took * state.rate
        loads = {one: other.load(now) for one, other in self._states.items()}
        # share of the available time: each other viewer counts as this one, or less where its load is small
        excess = own + sum(min(own, _MAX_COST_RATIO * load) for one, load in loads.items() if one != viewer)
        if len(state.times) < (_MEDIAN_OF_SLOW if excess > _FAR_TOO_SLOW else _MEDIAN_OF):
            return
        if not smaller:
            state.took[state.steps, state.scale] = took
        if excess > 1:
            self._reduce(state, excess, now)
        elif not smaller and now - state.since >= state.hold and excess * self._cost_ratio(state, took) < _HEADROOM:
            self._restore(state, now)

    def refused(self, viewer: int, now: float) -> None:
        """Note a picture over its budget: reduce the detail whatever the rate."""
        state = self._states.get(viewer)
        if state is not None:
            self._reduce(state, np.inf, now)

    def _reduce(self, state: _State, excess: float, now: float) -> None:
        if not state.coarsest and state.steps < _MAX_STEPS:
            wanted = max(1, int(min(np.log2(excess) / BIAS, _MAX_STEPS_AT_ONCE)))
            state.steps = min(state.steps + wanted, _MAX_STEPS)
        elif state.scale < len(SCALES) - 1:
            state.scale += 1
        else:
            return
        if state.better is not None and now - state.better < _TOO_EARLY_S:
            state.hold = min(2 * state.hold, _MAX_HOLD_S)
        state.better = None
        self._changed(state, now)

    def _restore(self, state: _State, now: float) -> None:
        if state.scale:
            state.scale -= 1
        elif state.steps:
            state.steps -= 1
        else:
            return
        state.better = now
        self._changed(state, now)

    @staticmethod
    def _cost_ratio(state: _State, took: float) -> float:
        """Return the expected ratio of the next finer step's time to ``took``: as measured last, within a limit."""
        better = (state.steps, state.scale - 1) if state.scale else (state.steps - 1, 0)
        most = (SCALES[state.scale - 1] / SCALES[state.scale]) ** 2 if state.scale else _MAX_COST_RATIO
        return min(most, state.took.get(better, np.inf) / took)

    @staticmethod
    def _changed(state: _State, now: float) -> None:
        state.since, state.drawn = now, 0
        state.times.clear()
