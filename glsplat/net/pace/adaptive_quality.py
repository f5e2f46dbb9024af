"""AdaptiveQuality: holds a rate of pictures by drawing them with less detail, and says which.

Two knobs, in this order: the level of detail, then the size. What is taken away comes back when there is time again,
after a while that grows each time it proves too early: nothing swings. Times come in as arguments; no clock is read.
What a link takes is decided elsewhere (link_control.py) and only handed on here, in ``Detail``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glsplat.camera import Camera
from glsplat.net.pace.ladder import SCALES, Rung

__all__ = ["FULL", "AdaptiveQuality", "Detail"]

BIAS = 0.5
"""Halvings of the density a step, of the level of detail; at most _MAX_STEPS steps."""

_MAX_STEPS = 16
_MEDIAN_OF, _MEDIAN_OF_SLOW = 8, 3  # pictures whose median decides, and as many of those that are far too slow
_IGNORED_FIRST = 2  # pictures of a detail that do not count: something is made for them
_MAX_STEPS_AT_ONCE = 2  # of the level at once, at most: of pictures that were slow once not all is to be taken away
_FAR_TOO_SLOW = 1.5  # times what there is time for
_HEADROOM = 0.85  # of the time: what the next better step may be expected to take
_HOLD_S, _MAX_HOLD_S = 2.0, 60.0  # seconds before something comes back, at first and at most
_TOO_EARLY_S = 5.0  # seconds within which too slow again means that it came back too early
_LOAD_WINDOW_S = 1.0  # seconds over which the time that a viewer takes is counted
_MAX_COST_RATIO = 2.0  # times, that a finer level costs at most


@dataclass(frozen=True, slots=True)
class Detail:
    """What a picture is drawn with."""

    bias: float = 0.0  # RenderConfig.lod_bias and this
    scale: float = 1.0  # of its sides
    rung: Rung | None = None  # what the link takes, where that is less

    def within(self, rung: Rung) -> Detail:
        """The same for a link that takes no more than ``rung``: of both sizes the smaller."""
        return self if rung.full else Detail(self.bias, min(self.scale, rung.scale), rung)

    def fields(self, levels: Sequence[int]) -> dict[str, Any]:
        """What a reply says of it."""
        said: dict[str, Any] = {"levels": levels, "bias": self.bias, "scale": self.scale}
        return said if self.rung is None else said | {"quality": self.rung.quality, "why": "link"}

    def resized(self, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        """The same views with fewer pixels, at least one a side."""
        if self.scale == 1:
            return tuple(cameras)
        return tuple(
            camera.resized(max(1, round(camera.width * self.scale)), max(1, round(camera.height * self.scale)))
            for camera in cameras
        )


FULL = Detail()
"""All there is."""


@dataclass(slots=True)
class _State:
    """One viewer."""

    steps: int = 0  # of the level
    scale: int = 0  # index of SCALES
    times: deque[float] = field(default_factory=lambda: deque(maxlen=_MEDIAN_OF))
    took: dict[tuple[int, int], float] = field(default_factory=dict)  # seconds, by (steps, scale), when it last was so
    hold: float = _HOLD_S
    since: float = 0.0  # when the detail changed last
    better: float | None = None  # when it last came back
    seen: float = 0.0
    coarsest: bool = False
    drawn: int = 0  # pictures since the detail changed
    spent: deque[tuple[float, float]] = field(default_factory=deque)  # when, and seconds, of the last _LOAD_WINDOW_S

    def load(self, now: float) -> float:
        """The part of the renderer's time that its pictures took lately."""
        while self.spent and now - self.spent[0][0] > _LOAD_WINDOW_S:
            self.spent.popleft()
        return sum(seconds for _, seconds in self.spent) / _LOAD_WINDOW_S


class AdaptiveQuality:
    """Chooses the detail of each viewer's pictures, so that all of them get ``rate`` pictures a second.

    None: every picture has all there is.
    """

    def __init__(self, rate: float | None) -> None:
        self.rate = rate
        self._states: dict[int, _State] = {}

    def detail(self, viewer: int, now: float) -> Detail:
        """Of the next picture of a viewer; ``now`` in seconds."""
        if self.rate is None:
            return FULL
        state = self._states.setdefault(viewer, _State(since=now))
        state.seen = now
        for gone in [one for one, other in self._states.items() if now - other.seen > 60 * _LOAD_WINDOW_S]:
            del self._states[gone]
        return Detail(-BIAS * state.steps, SCALES[state.scale])

    def drawn(self, viewer: int, seconds: float, coarsest: bool, now: float, smaller: bool = False) -> None:
        """A picture took that long; ``coarsest``: there is no coarser level for anything in it.

        ``smaller``: it was drawn smaller than ``detail`` said, so that it tells what is too slow, and nothing else.
        """
        state = self._states.get(viewer)
        if state is None or self.rate is None:
            return
        state.spent.append((now, seconds))
        state.coarsest = coarsest
        state.drawn += 1
        if state.drawn <= _IGNORED_FIRST:
            return
        state.times.append(seconds)
        took = float(np.median(state.times))
        own = took * self.rate
        loads = {one: other.load(now) for one, other in self._states.items()}
        # of the time there is: another viewer counts as much as this one, unless its pictures take little, small or few
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
        """A picture was beyond its budget: the next one has less, whatever the rate."""
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
        """How many times as long the next better step may take: as when it last was so, or as it would at most."""
        better = (state.steps, state.scale - 1) if state.scale else (state.steps - 1, 0)
        most = (SCALES[state.scale - 1] / SCALES[state.scale]) ** 2 if state.scale else _MAX_COST_RATIO
        return min(most, state.took.get(better, np.inf) / took)

    @staticmethod
    def _changed(state: _State, now: float) -> None:
        state.since, state.drawn = now, 0
        state.times.clear()
