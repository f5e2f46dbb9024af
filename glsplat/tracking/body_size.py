"""Find a user's size while the session runs, without a calibration step."""

from __future__ import annotations

from math import exp, hypot, inf

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.judge import read_pose
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import Body, levelled
from glsplat.tracking.solve.quat import Quat, Vec, clamp, length, mul, rotate, sub, swing_twist_y, yaw_quat

BIN_M, BINS = 0.01, 240  # of the histograms of heights and reaches: up to 2.4 m
BAND_M = 0.05  # a standing or walking user's eyes stay within that height
BAND_SHARE, MIN_S, ENOUGH_S = 0.1, 0.7, 4.0  # of the upright time in a band, that make it a standing height
# parts of the tallest standing height: what counts as upright; its quantile; eyes of the usual posture to the zero pose
UPRIGHT, EYE_QUANTILE, POSTURE = 0.93, 0.8, 0.983
UPRIGHT_HEAD, MAX_VERTICAL_SPEED = 0.5, 0.4  # vertical part of the head's up, m/s: of a head that may stand
SEATED_EYES_M = 1.36  # a user with lower eyes may sit on a chair, unless ...
WALKED_M, ROOM_M = 1.5, 0.7  # ... that far was walked, or the places at that height are that far apart, ...
# ... or wrists hang that far (of the eye height) below the eyes, and no further ahead
HANGING, MAX_HANGING_AHEAD = (0.42, 0.52), 0.1
CROUCH, CROUCH_S = 0.88, 5.0  # of the size known so far: lower eyes may be a crouch for that long
MAX_REACH = 0.53  # of the eye height, from between the eyes to a wrist of a hanging arm
REACH_QUANTILE, SPAN_QUANTILE = 0.95, 0.9  # of the time, that give the farthest reach and the span of stretched arms
STRETCHED_WRISTS = (0.65, 1.05)  # of the eye height: wrists of arms stretched sideways are between
ARM_WEIGHT = 0.25  # of the arm span against the eye height in the scale
MIN_SCALE, MAX_SCALE = 0.6, 1.35  # of the avatar's size
SCALE_SMOOTHING_S = 0.6  # of either low pass by which the scale follows
MAX_SCALE_RATE = 0.12  # of the scale, by which it changes in a second
ESTIMATE_EVERY_S = 0.1
NOWHERE = (inf, -inf, inf, -inf)


def with_arms(scale: float, ratio: float) -> float | None:
    """Return the scale by eye height and by arm span, ``ratio`` of the avatar's; None: the arms were not stretched."""
    if not 0.85 * scale <= ratio <= 1.2 * scale:
        return None
    return (1 - ARM_WEIGHT) * scale + ARM_WEIGHT * ratio


class BodySizeFinder:
    """Scale of the avatar from the heights and reaches of a session so far.

    A standing person's eyes are at the tallest frequent height. Lower eyes may be those of a sitting or crouching user:
    they count where the user walks, or where the arms hang as long as they are for that height, and never where the
    wrists reach too far for it.
    """

    def __init__(self, body: Body, scale: float) -> None:
        self.body = body
        self.scale = self._stage = scale  # in use, smoothed once
        self.goal = scale  # by the session so far
        self._known = scale * body.eye_height  # metres of the zero pose's eyes, by heights and reaches alone
        self.eye_height: float | None = None  # metres of the user, as found so far
        self.arm_span: float | None = None  # metres from wrist to wrist, likewise
        self.heights = np.zeros(BINS)  # seconds at each height of the eyes
        self.hung = np.zeros(BINS)  # seconds of these, with a wrist that hangs
        self.walked = np.zeros(BINS)  # metres
        self.places: list[tuple[float, float, float, float]] = [NOWHERE] * BINS  # least and most x and z of the eyes
        self.reaches = np.zeros(BINS)  # seconds at each distance of a wrist from the eyes
        self.spans = np.zeros(BINS)  # seconds at each distance between both wrists
        self._before: Vec | None = None
        self._since_estimate = 0.0

    def observe(self, sample: Sample, floor: float, head_frame: Quat, dt: float) -> float:
        """Return the scale after a sample; ``head_frame``: the headset's axes in the head joint's rest axes."""
        head, *hands = [read_pose(pose, 1.0, floor, []) for pose in (sample.head, sample.left, sample.right)]
        if head is None:
            return self.scale
        return self.update(head[0], mul(head[1], head_frame), [hand[0] for hand in hands if hand is not None], dt)

    def update(self, eye: Vec, head: Quat, hands: list[Vec], dt: float) -> float:
        """Return the scale of this moment.

        ``eye``, ``hands`` (the tracked ones): metres of the user, the floor at y = 0. ``head``: rotation of its joint.
        """
        up, facing = rotate(head, (0.0, 1.0, 0.0))[1], yaw_quat(-(swing_twist_y(head) or 0.0))
        hands = [rotate(facing, sub(hand, eye)) for hand in hands]
        eye = levelled(eye, head)
        if self._before is None and up > UPRIGHT_HEAD:
            # a user with higher eyes would make the avatar stand on tiptoe until a size is found
            least = min(eye[1] / POSTURE / self.body.eye_height, MAX_SCALE)
            self.scale = self._stage = self.goal = max(self.scale, least)
        before, self._before = self._before or eye, eye
        moved = sub(eye, before)
        rate = 1 / max(dt, 1e-4)
        if up > UPRIGHT_HEAD and abs(moved[1]) * rate < MAX_VERTICAL_SPEED and 0.4 < eye[1] < BIN_M * (BINS - 1):
            at = int(eye[1] / BIN_M)
            self.heights[at] += dt
            self.walked[at] += hypot(moved[0], moved[2]) if hypot(moved[0], moved[2]) * rate > 0.4 else 0.0
            left, right, back, front = self.places[at]
            x, _, z = eye
            self.places[at] = (min(left, x), max(right, x), min(back, z), max(front, z))
            if any(HANGING[0] < -y / eye[1] < HANGING[1] and z / eye[1] < MAX_HANGING_AHEAD for _, y, z in hands):
                self.hung[at] += dt
        for hand in hands:
            _count(self.reaches, length(hand), dt)
        low, high = STRETCHED_WRISTS
        if len(hands) == 2 and all(low < 1 + y / max(eye[1], 0.4) < high for _, y, _ in hands):
            _count(self.spans, length(sub(*hands)), dt)
        self._since_estimate += dt
        if self._since_estimate >= ESTIMATE_EVERY_S:
            self._since_estimate = 0.0
            self.goal = self._estimate()
        k = 1 - exp(-dt / SCALE_SMOOTHING_S)
        self._stage += (self.goal - self._stage) * k
        step = (self._stage - self.scale) * k
        self.scale += clamp(step, -MAX_SCALE_RATE * self.scale * dt, MAX_SCALE_RATE * self.scale * dt)
        return self.scale

    def _estimate(self) -> float:
        """Return the scale by this session so far; the last one while too little is known."""
        width = round(BAND_M / BIN_M)
        stood = np.convolve(self.heights, np.ones(width))[width - 1 :]  # of the band that begins at each bin
        enough = np.flatnonzero(stood >= clamp(BAND_SHARE * float(self.heights.sum()), MIN_S, ENOUGH_S))
        if not len(enough):
            return self.goal
        first = int(enough[-1])  # the tallest band, shifted to its local maximum
        while first > 0 and stood[first - 1] > stood[first]:
            first -= 1
        upright = slice(int(UPRIGHT * (first + width)), first + width)
        held = self.heights[upright]
        seconds = float(held.sum())
        place = (upright.start + int(np.searchsorted(np.cumsum(held), EYE_QUANTILE * seconds)) + 0.5) * BIN_M
        height, known = place / POSTURE, self._known
        reach = _quantile(self.reaches, REACH_QUANTILE) / MAX_REACH
        # a trunk that leans far has lower eyes, so far places at one height were walked to
        left, right, back, front = zip(*self.places[upright], strict=True)
        room = max(max(right) - min(left), max(front) - min(back))
        walked = self.walked[upright].sum() >= WALKED_M or room > ROOM_M
        stands = place > SEATED_EYES_M or self.hung[upright].sum() >= max(MIN_S, BAND_SHARE * seconds)
        if walked or (stands and (height > CROUCH * known or seconds > CROUCH_S)):
            self.eye_height = max(place, reach * POSTURE)
        else:
            height = known
        unit = self.body.eye_height
        self._known = clamp(max(reach, height), MIN_SCALE * unit, MAX_SCALE * unit)
        scale = self._known / unit
        span = _quantile(self.spans, SPAN_QUANTILE)
        fitted = with_arms(scale, span / self.body.arm_span())
        if self.eye_height is None or fitted is None:
            return scale
        self.arm_span = span
        return fitted


def _count(histogram: NDArray[np.float64], metres: float, dt: float) -> None:
    if metres < BIN_M * (BINS - 1):
        histogram[int(metres / BIN_M)] += dt


def _quantile(histogram: NDArray[np.float64], share: float) -> float:
    """Return the metres below which this share of the time is; 0 where there is too little of it."""
    total = histogram.sum()
    return float(np.searchsorted(np.cumsum(histogram), share * total) * BIN_M) if total >= MIN_S else 0.0
