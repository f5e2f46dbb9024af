"""A user's size, found while the session runs: nobody has to press a button first."""

from __future__ import annotations

from math import exp, hypot, inf

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.solve.body import Body, levelled
from glsplat.tracking.solve.quat import Quat, Vec, clamp, length, rotate, sub, swing_twist_y, yaw_quat

__all__ = ["Finder", "with_arms"]

BIN, BINS = 0.01, 240  # metres of eye height a bin holds, and bins: up to 2.4 m
BAND = 0.05  # metres: somebody who stands or walks keeps within that
SHARE, LEAST, MOST = 0.1, 0.7, 4.0  # of the time upright, seconds: a height is not passed by, but stood at
# of the tallest such height, what counts as upright; its quantile, of the zero pose
UPPER, USUAL, POSTURE = 0.93, 0.8, 0.983
UPRIGHT, STEADY = 0.5, 0.4  # vertical part of the head's up, m/s upwards or downwards: of a head that may stand
SEATED = 1.36  # metres: who has eyes lower than that may as well sit on a chair ...
WALKED, ROOM = 1.5, 0.7  # metres: ... unless it went that far, or somewhere that far away, at that height, ...
HANGS, AHEAD = (0.42, 0.52), 0.1  # of the eye height: ... or wrists hung that far below the eyes, and no further ahead
LOWER, DOUBTED = 0.88, 5.0  # of the size known so far, seconds: what is lower may be a crouch for that long, likewise
ARM = 0.53  # of the eye height that a wrist is from between the eyes at most, hanging
FAR, WIDE = 0.95, 0.9  # of the time, wrists are nearer than a farthest reach, than arms stretched sideways
SHOULDERS = (0.65, 1.05)  # of the eye height; hands of arms that are stretched sideways are between
ARM_WEIGHT = 0.25  # of the arm span against the eye height in the scale
SMALLEST, LARGEST = 0.6, 1.35  # of the avatar's size
FOLLOWS = 0.6  # seconds: of either low pass by which the scale follows
FASTEST = 0.12  # of the scale that it changes in a second at most
NOWHERE = (inf, -inf, inf, -inf)
AGAIN = 0.1  # seconds between two estimates


def with_arms(scale: float, ratio: float) -> float | None:
    """The scale by eye height and by arm span, ``ratio`` of the avatar's; None: the arms were not stretched."""
    if not 0.85 * scale <= ratio <= 1.2 * scale:
        return None
    return (1 - ARM_WEIGHT) * scale + ARM_WEIGHT * ratio


class Finder:
    """Scale of the avatar from the heights and reaches of a session so far.

    A standing person's eyes are at the tallest height that is frequent. What is lower may be a seat or a crouch: it is
    believed where it walks or lets its arms hang as long as it is tall, never where the wrists reach too far for it.
    """

    def __init__(self, body: Body, scale: float) -> None:
        self.body = body
        self.scale = self._stage = scale  # shown
        self.goal = scale  # that the session so far suggests
        self._known = scale * body.eye_height  # metres of the zero pose's eyes, by heights and reaches alone
        self.eye_height: float | None = None  # metres of the user, as found so far
        self.arm_span: float | None = None  # metres from wrist to wrist, likewise
        self.heights = np.zeros(BINS)  # seconds
        self.hung = np.zeros(BINS)  # of these, with a wrist that hangs
        self.walked = np.zeros(BINS)  # metres
        self.places: list[tuple[float, float, float, float]] = [NOWHERE] * BINS  # least and most x and z of the eyes
        self.reaches = np.zeros(BINS)  # seconds
        self.spans = np.zeros(BINS)
        self._before: Vec | None = None
        self._since = 0.0

    def update(self, eye: Vec, head: Quat, hands: list[Vec], dt: float) -> float:
        """The scale of now.

        ``eye``, ``hands`` (those that are tracked): metres of the user, the floor at y = 0. ``head``: its joint's turn.
        """
        up, facing = rotate(head, (0.0, 1.0, 0.0))[1], yaw_quat(-(swing_twist_y(head) or 0.0))
        hands = [rotate(facing, sub(hand, eye)) for hand in hands]
        eye = levelled(eye, head)
        if self._before is None and up > UPRIGHT:
            self._begins(eye[1] / POSTURE)
        before, self._before = self._before or eye, eye
        moved = sub(eye, before)
        rate = 1 / max(dt, 1e-4)
        if up > UPRIGHT and abs(moved[1]) * rate < STEADY and 0.4 < eye[1] < BIN * (BINS - 1):
            at = int(eye[1] / BIN)
            self.heights[at] += dt
            self.walked[at] += hypot(moved[0], moved[2]) if hypot(moved[0], moved[2]) * rate > 0.4 else 0.0
            left, right, back, front = self.places[at]
            x, _, z = eye
            self.places[at] = (min(left, x), max(right, x), min(back, z), max(front, z))
            if any(HANGS[0] < -y / eye[1] < HANGS[1] and z / eye[1] < AHEAD for _, y, z in hands):
                self.hung[at] += dt
        for hand in hands:
            _seen(self.reaches, length(hand), dt)
        if len(hands) == 2 and all(SHOULDERS[0] < 1 + y / max(eye[1], 0.4) < SHOULDERS[1] for _, y, _ in hands):
            _seen(self.spans, length(sub(*hands)), dt)
        self._since += dt
        if self._since >= AGAIN:
            self._since = 0.0
            self.goal = self._estimate()
        k = 1 - exp(-dt / FOLLOWS)
        self._stage += (self.goal - self._stage) * k
        step = (self._stage - self.scale) * k
        self.scale += clamp(step, -FASTEST * self.scale * dt, FASTEST * self.scale * dt)
        return self.scale

    def _begins(self, height: float) -> None:
        """Nobody is taller than they are: who begins with higher eyes would stand on tiptoe until a size is found."""
        least = min(height / self.body.eye_height, LARGEST)
        self.scale = self._stage = self.goal = max(self.scale, least)

    def _estimate(self) -> float:
        """The scale that this session so far suggests; the last one where it says too little."""
        width = round(BAND / BIN)
        stood = np.convolve(self.heights, np.ones(width))[width - 1 :]  # of the band that begins at each bin
        enough = np.flatnonzero(stood >= clamp(SHARE * float(self.heights.sum()), LEAST, MOST))
        if not len(enough):
            return self.goal
        first = int(enough[-1])  # the tallest band, centred on what it holds
        while first > 0 and stood[first - 1] > stood[first]:
            first -= 1
        upright = slice(int(UPPER * (first + width)), first + width)
        held = self.heights[upright]
        seconds = float(held.sum())
        place = (upright.start + int(np.searchsorted(np.cumsum(held), USUAL * seconds)) + 0.5) * BIN
        height, known = place / POSTURE, self._known
        reach = _most(self.reaches, FAR) / ARM
        walked = self.walked[upright].sum() >= WALKED or self._room(upright) > ROOM
        stands = place > SEATED or self.hung[upright].sum() >= max(LEAST, SHARE * seconds)
        if walked or (stands and (height > LOWER * known or seconds > DOUBTED)):
            self.eye_height = max(place, reach * POSTURE)
        else:
            height = known
        unit = self.body.eye_height
        self._known = clamp(max(reach, height), SMALLEST * unit, LARGEST * unit)
        return self._with_span(self._known / unit)

    def _room(self, bins: slice) -> float:
        """Metres between the farthest places at these heights; a trunk that leans as far has lower eyes."""
        left, right, back, front = zip(*self.places[bins], strict=True)
        return max(max(right) - min(left), max(front) - min(back))

    def _with_span(self, scale: float) -> float:
        """A quarter of it by the arms, once they were stretched sideways."""
        span = _most(self.spans, WIDE)
        fitted = with_arms(scale, span / self.body.arm_span())
        if self.eye_height is None or fitted is None:
            return scale
        self.arm_span = span
        return fitted


def _seen(histogram: NDArray[np.float64], metres: float, dt: float) -> None:
    if metres < BIN * (BINS - 1):
        histogram[int(metres / BIN)] += dt


def _most(histogram: NDArray[np.float64], share: float) -> float:
    """Metres below which this share of the time is; 0 where there is too little of it."""
    total = histogram.sum()
    return float(np.searchsorted(np.cumsum(histogram), share * total) * BIN) if total >= LEAST else 0.0
