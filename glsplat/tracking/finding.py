"""A user's size, found while the session runs: nobody has to press a button first."""

from __future__ import annotations

from math import exp, hypot

import numpy as np

from glsplat.tracking.solve.quat import Vec, clamp, length, sub

__all__ = ["Finder"]

BIN, BINS = 0.01, 240  # metres of eye height a bin holds, and bins: up to 2.4 m
BAND = 0.05  # metres: somebody who stands or walks keeps within that
SHARE, LEAST, MOST = 0.1, 0.7, 4.0  # of the time upright, seconds: a height is not passed by, but stood at
POSTURE = 0.975  # of the zero pose's eye height: the upper part of what people have who stand or walk
UPRIGHT, STEADY = 0.8, 0.4  # vertical part of the head's up, m/s upwards or downwards: of a head that may stand
SEATED = 1.27  # metres: who has eyes lower than that may as well sit on a chair ...
WALKED = 1.5  # metres: ... unless it went that far, at that height
LOWER, DOUBTED = 0.94, 4.0  # of the size known so far, seconds: what is lower may be a crouch for that long, likewise
ARM = 0.53  # of the eye height that a wrist is from between the eyes at most, hanging
FAR = 0.95  # of the time, wrists are nearer than what counts as a farthest reach
SMALLEST, LARGEST = 0.6, 1.35  # of the avatar's size
FOLLOWS = 0.6  # seconds: of either low pass by which the scale follows
FASTEST = 0.12  # of the scale that it changes in a second at most
AGAIN = 0.1  # seconds between two estimates


class Finder:
    """Scale of the avatar from the heights and reaches of a session so far.

    A standing person's eyes are at the tallest height that is frequent; what is lower may be a seat or a crouch, and is
    believed only where the wrists do not reach too far for it, and where it walks if it is as low as a chair.
    """

    def __init__(self, eye_height: float, scale: float) -> None:
        self.eye_height = eye_height  # of the avatar, metres
        self.scale = self._stage = self._goal = scale
        self.heights = np.zeros(BINS)  # seconds
        self.reaches = np.zeros(BINS)
        self.walked = np.zeros(BINS)  # metres
        self._before: Vec | None = None
        self._since = 0.0

    def update(self, eye: Vec, up: float, hands: list[Vec], dt: float) -> float:
        """The scale of now. ``eye``, ``hands`` (those that are tracked): metres of the user, the floor at y = 0."""
        before, self._before = self._before or eye, eye
        moved = sub(eye, before)
        rate = 1 / max(dt, 1e-4)
        if up > UPRIGHT and abs(moved[1]) * rate < STEADY and 0.4 < eye[1] < BIN * (BINS - 1):
            at = int(eye[1] / BIN)
            self.heights[at] += dt
            self.walked[at] += hypot(moved[0], moved[2]) if hypot(moved[0], moved[2]) * rate > 0.4 else 0.0
        for hand in hands:
            far = length(sub(hand, eye))
            if far < BIN * (BINS - 1):
                self.reaches[int(far / BIN)] += dt
        self._since += dt
        if self._since >= AGAIN:
            self._since = 0.0
            self._goal = self._estimate()
        k = 1 - exp(-dt / FOLLOWS)
        self._stage += (self._goal - self._stage) * k
        step = (self._stage - self.scale) * k
        self.scale += clamp(step, -FASTEST * self.scale * dt, FASTEST * self.scale * dt)
        return self.scale

    def _estimate(self) -> float:
        """The scale that this session so far suggests; the last one where it says too little."""
        total = float(self.heights.sum())
        width = round(BAND / BIN)
        stood = np.convolve(self.heights, np.ones(width))[width - 1 :]  # of the band that begins at each bin
        enough = np.flatnonzero(stood >= clamp(SHARE * total, LEAST, MOST))
        if not len(enough):
            return self._goal
        # the tallest band, centred on what it holds
        first = int(enough[-1])
        while first > 0 and stood[first - 1] > stood[first]:
            first -= 1
        band = slice(first, first + width)
        held = self.heights[band]
        place = first + int(np.searchsorted(np.cumsum(held), 0.7 * held.sum()))
        height = (place + 0.5) * BIN / POSTURE
        reach = self._reach()
        now, walked = self._goal * self.eye_height, float(self.walked[band].sum())
        if walked < WALKED and (place * BIN < SEATED or (height < LOWER * now and held.sum() < DOUBTED)):
            height = now
        height = max(reach, height)
        return clamp(height / self.eye_height, SMALLEST, LARGEST)

    def _reach(self) -> float:
        """Metres of eye height that arms as long as these have at least."""
        total = self.reaches.sum()
        if total < LEAST:
            return 0.0
        return float(np.searchsorted(np.cumsum(self.reaches), FAR * total) * BIN / ARM)
