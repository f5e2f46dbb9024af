"""TrackingSolver: solves one user's tracking for the server, and animates eyes and face."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from statistics import median
from typing import Any, Protocol

import numpy as np

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.net.backend import Solved
from glsplat.net.messages import Request
from glsplat.net.wire_schema import Arrival
from glsplat.optional import missing, plugin
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.sample import Sample
from glsplat.tracking.solvers import SOLVERS, SolverName
from glsplat.tracking.tracker import Tracker

HORIZON_SHARE, MAX_HORIZON_S = 0.8, 0.036
"""Prediction horizon as a share of the pictures' age, and its limit: a longer one amplifies noise visibly."""

_MEDIAN_AGES = 15  # pictures
_RAMP_S = 5e-4  # largest change of the horizon from sample to sample
_MAX_CLOCK_S = 1e12  # above it a double cannot resolve the time of a frame


class TimestampMerger:
    """Merges samples with and without the client's time into one time line.

    Between two samples of different kinds, the time between their arrivals passes.
    """

    def __init__(self) -> None:
        self._theirs: bool | None = None  # whether the last sample had a time
        self._shift = 0.0  # seconds from the clock in use to the time line
        self._last = self._arrived = 0.0  # seconds

    def time(self, t: float | None, now: float) -> float:
        """Return the time in seconds of a sample with the time ``t``, if any, that arrived at ``now``."""
        theirs = t is not None and abs(t) < _MAX_CLOCK_S
        stamp = t if t is not None and theirs else now
        if self._theirs is not None and theirs != self._theirs:
            self._shift = self._last + (now - self._arrived) - stamp
        self._theirs, self._arrived, self._last = theirs, now, stamp + self._shift
        return self._last


class PredictionHorizon:
    """The time by which a client's poses are extrapolated, towards the moment when its pictures are seen.

    It is a share of the age of pictures that the client reports (docs/protocol.md, section 5.1), 0 without reports.
    With all of the age, noise would grow faster than the error falls.
    """

    def __init__(self) -> None:
        self.seconds: float = 0.0
        self._ages: deque[float] = deque(maxlen=_MEDIAN_AGES)

    def update(self, arrival: Arrival | None) -> float:
        """Return the horizon in seconds for the next sample, which came with the report ``arrival``."""
        if arrival is not None:
            self._ages.append(arrival.age / 1e3)
        if self._ages:
            wanted = min(HORIZON_SHARE * median(self._ages), MAX_HORIZON_S)
            self.seconds += min(max(wanted - self.seconds, -_RAMP_S), _RAMP_S)
        return self.seconds


class FaceFeed(Protocol):
    """Face tracking from outside the headset (extras/speech/face)."""

    def worn(self, wearer: object, sample: Sample, now: float) -> Sample:
        """Return the sample with the present face, if it is the wearer's."""


def _idle_face() -> Any:
    """Return an animation of untracked eyes. Raises GlsplatError where extras/speech is not installed."""
    module = plugin("speech.idle")
    if module is None:
        raise GlsplatError(missing("speech", "moving idle eyes"))
    return module.IdleFace()


class TrackingSolver:
    """Solves tracking to poses for one user.

    ``idle`` animates eyes that are not tracked. ``face`` adds face tracking from outside the headset.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        calibration: Calibration,
        solver: SolverName = SOLVERS[0],
        idle: bool = False,
        face: FaceFeed | None = None,
    ) -> None:
        self._tracker = Tracker(skeleton, calibration, solver=solver)
        self._clock = TimestampMerger()
        self._ahead = PredictionHorizon()
        self._idle = _idle_face() if idle else None
        self._face = face

    def solve(self, request: Request, now: float) -> Solved:
        """Filter and solve the next sample."""
        sample = request.tracking
        assert sample is not None
        t = self._clock.time(None if request.t is None else sample.t, now)
        sample = sample if t == sample.t else replace(sample, t=t)
        if self._face is not None:
            sample = self._face.worn(self, sample, now)
        if self._idle is not None:
            sample = self._idle.fill(sample, (*request.faces, *_watcher(request.cameras)))
        self._tracker.prediction = self._ahead.update(request.arrival)
        pose = self._tracker.update(sample)
        known = self._tracker.calibration
        return Solved(pose, self._tracker.flags, known.scale, known.floor)


def _watcher(cameras: tuple[Camera, ...]) -> list[Sequence[float]]:
    """Return the point between the eyes of the viewer: in a mirror's picture, the user's own image."""
    if not cameras:
        return []
    return [np.mean([camera.position for camera in cameras], axis=0).tolist()]
