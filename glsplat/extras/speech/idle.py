"""Idle face: gaze and blinks for a head whose eyes are not tracked.

Eyes fixate points of the world and make saccades between them; while the head turns, fixation holds (the
vestibulo-ocular reflex), so a nod does not shake the gaze. Saccades have the sizes and durations measured on people in
conversation (Lee, Badler & Badler, "Eyes Alive", SIGGRAPH 2002).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import acos, asin, atan2, cos, degrees, exp, log, pi, radians, sin
from random import Random

from glsplat.skinning.expression import arkit_name
from glsplat.tracking.judge import read_pose, read_position
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    add,
    between,
    clamp,
    conj,
    dot,
    normalized,
    rotate,
    scale,
    sub,
    unit,
)

GAZE_DISTANCE_M = 1.5  # without a face to look at
EYE_DISTANCE_M = 0.063
FIXATION_S, FIXATION_SPREAD = 0.34, 0.5  # median, and standard deviation of its logarithm; 2.3 saccades per second
MIN_FIXATION_S, MAX_FIXATION_S = 0.15, 2.0
MAX_ECCENTRICITY = radians(22)  # of the eyes from straight ahead; beyond it the head has to turn
FACE_ANGLE = radians(30)  # largest angle from straight ahead to a fixated face
AT_FACE = 0.75  # share of saccades to the face, from eye to eye to mouth; the others go beside it
HEAD_LEAD = 0.3  # gaze beyond straight ahead, relative to the angle that the head has turned from the last point
MIN_FACE_M, MAX_FACE_M = 0.25, 10.0  # a nearer one is the own head; eyes do not meet farther away
FEATURES: tuple[Vec, ...] = ((-0.03, 0.0, 0.0), (0.03, 0.0, 0.0), (0.0, -0.07, 0.0))  # metres from between the eyes
VERTICAL = 0.5  # factor on vertical saccades, as most things of interest are at eye level
BLINKS_HZ = 15 / 60
BLINK_GAP_S = 1.0  # least time between blinks
BLINK_SHIFT = radians(30)  # larger saccades come with a blink
CLOSING_S, CLOSED_S, OPENING_S = 0.08, 0.04, 0.16  # Trutoiu et al. 2011: lids fall faster than they rise
LID_RANGE = radians(40)  # gaze at which ARKit's eyeLook shapes are full
RESET_S = 1.0  # time without a sample after which the state is reset


class IdleFace:
    """Idle face of one person. Deterministic for the same samples and seed.

    >>> idle = IdleFace(seed=1)
    >>> sample = idle.fill(Sample(0.0, head=(0, 1.6, 0, 0, 0, 0, 1)))
    >>> sample.left_eye is not None
    True
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._random = Random(self._seed)
        self._time: float | None = None
        self._target: Vec = (0.0, 0.0, 0.0)  # fixated point in the world
        self._previous: Vec = self._target  # ... and the one before the last saccade
        self._feature = 0  # last fixated feature of the face
        self._at_face = False  # whether a feature is fixated
        self._saccade_at = self._saccade_s = 0.0  # start and duration of the last saccade
        self._next_at = 0.0  # start of the next saccade
        self._blinked_at, self._blink_at = -1e9, 0.0  # starts of the last and the next blink
        self._fixated: Vec = (0.0, 0.0, -1.0)  # gaze direction in the world at the last saccade

    def fill(self, sample: Sample, faces: Sequence[Sequence[float]] = ()) -> Sample:
        """Return the sample with gaze and eyelids where it has none.

        ``faces``: points [3] between the eyes of others and mirror images, in the sample's space. The eyes look at the
        one nearest to straight ahead, up to 30 degrees aside and 0.25 to 10 m away. A sample without a head, or with
        its own eyes and eyelids, is returned unchanged.
        """
        head = read_pose(sample.head, 1.0, 0.0, [])
        own = {known for name in sample.expression or () if (known := arkit_name(name)) is not None}
        blinks = not any(name.startswith("eyeBlink") for name in own)
        gazes = sample.left_eye is None and sample.right_eye is None
        if head is None or not (blinks or gazes) or not abs(sample.t) < 1e12:
            return sample
        self._advance(sample.t, *head, faces)
        eyes = [self._eye(*head, side, sample.t) for side in (-1, 1)]
        weights: dict[str, float] = {}
        if gazes and not any(name.startswith("eyeLook") for name in own):
            weights |= _lid_weights(*eyes)
        if blinks:
            closed = self._closed(sample.t)
            weights |= {"eyeBlinkLeft": closed, "eyeBlinkRight": closed} if closed > 0 else {}
        expression: Mapping[str, float] | None = {**weights, **(sample.expression or {})} or sample.expression
        if not gazes:
            return replace(sample, expression=expression)
        return replace(sample, expression=expression, left_eye=eyes[0], right_eye=eyes[1])

    def _advance(self, t: float, place: Vec, turn: Quat, faces: Sequence[Sequence[float]]) -> None:
        ahead = rotate(turn, (0.0, 0.0, -1.0))
        fresh = self._time is None or not 0 <= t - self._time < RESET_S
        if fresh:
            self.reset()
            self._blink_at = t + self._pause()
        self._time = t
        if t < self._saccade_at + self._saccade_s:
            return
        gaze = unit(sub(self._target, place), ahead)
        left_behind = not fresh and dot(gaze, ahead) < cos(FACE_ANGLE if self._at_face else MAX_ECCENTRICITY)
        if fresh or left_behind or t >= self._next_at:
            # eyes lead a turning head; otherwise saccades would follow it all the time
            lead = unit(add(ahead, scale(sub(ahead, gaze), HEAD_LEAD)), ahead) if left_behind else ahead
            self._previous, self._target = self._target, self._next_target(place, turn, ahead, lead, faces)
            looks = unit(sub(self._target, place), ahead)
            angle = 0.0 if fresh else acos(clamp(dot(looks, self._fixated), -1.0, 1.0))
            if fresh:
                self._previous = self._target
            self._fixated, self._saccade_at = looks, t
            self._saccade_s = 0.025 + 0.0024 * degrees(angle)  # Eyes Alive: 25 ms and 2.4 ms a degree
            rest = FIXATION_S * exp(FIXATION_SPREAD * self._random.gauss(0.0, 1.0))
            self._next_at = t + self._saccade_s + clamp(rest, MIN_FIXATION_S, MAX_FIXATION_S)
            if angle > BLINK_SHIFT and t - self._blinked_at > BLINK_GAP_S:
                self._blinked_at, self._blink_at = t, t + self._pause()
        if t >= self._blink_at:
            self._blinked_at, self._blink_at = t, t + self._pause()

    def _pause(self) -> float:
        return BLINK_GAP_S + self._random.expovariate(1 / (1 / BLINKS_HZ - BLINK_GAP_S))

    def _next_target(self, place: Vec, turn: Quat, ahead: Vec, lead: Vec, faces: Sequence[Sequence[float]]) -> Vec:
        """Return the next point to look at; without a face it is near the direction ``lead``."""
        face = _nearest_face(place, ahead, faces)
        to_face = self._random.random() < AT_FACE
        self._at_face = face is not None and to_face
        if face is not None and to_face:
            self._feature = (self._feature + self._random.choice((1, 2))) % len(FEATURES)  # never the same again
            return add(face, rotate(turn, FEATURES[self._feature]))
        base = lead if face is None else unit(sub(face, place), ahead)
        far = GAZE_DISTANCE_M if face is None else max(0.3, dot(sub(face, place), base))
        # Eyes Alive: saccade sizes, -6.9 ln(P / 15.7) degrees where P % are larger; about half of it from rest
        size = radians(min(22.7, -6.9 * log(self._random.uniform(0.6, 15.0) / 15.7)))
        way = self._random.choice((0.0, 0.0, 0.5, 1.0, 1.0, 1.5)) * pi + self._random.gauss(0.0, 0.25)
        # rotation about an axis perpendicular to the line of sight, in the head's axes
        axis = rotate(turn, (-VERTICAL * sin(way), cos(way), 0.0))
        aside = rotate(normalized((cos(0.5 * size), *scale(axis, sin(0.5 * size)))), base)
        return add(place, scale(_limited(aside, ahead), far))

    def _eye(self, place: Vec, turn: Quat, side: int, t: float) -> Vec:
        """Return an eye's gaze in the head's axes; ``side`` is -1 for the left eye, 1 for the right."""
        done = 1.0 if self._saccade_s <= 0 else clamp((t - self._saccade_at) / self._saccade_s, 0.0, 1.0)
        done = done * done * done * (10 + done * (6 * done - 15))  # minimum jerk
        point = add(scale(self._previous, 1 - done), scale(self._target, done))
        eye = add(place, rotate(turn, (0.5 * EYE_DISTANCE_M * side, 0.0, 0.0)))
        return rotate(conj(turn), _limited(unit(sub(point, eye)), rotate(turn, (0.0, 0.0, -1.0))))

    def _closed(self, t: float) -> float:
        """Return how far the lids are closed, 0 to 1."""
        since = t - self._blinked_at
        if since < CLOSING_S:
            part = since / CLOSING_S
        else:
            part = 1 - clamp((since - CLOSING_S - CLOSED_S) / OPENING_S, 0.0, 1.0)
        return part * part * (3 - 2 * part)


def _nearest_face(place: Vec, ahead: Vec, faces: Sequence[Sequence[float]]) -> Vec | None:
    """Return the face nearest to straight ahead, or None."""
    best, least = None, cos(FACE_ANGLE)
    for one in faces:
        at = read_position(one, 1.0, 0.0, [])
        if at is None or not MIN_FACE_M**2 < dot(away := sub(at, place), away) < MAX_FACE_M**2:
            continue
        if (along := dot(unit(away), ahead)) > least:
            best, least = at, along
    return best


def _limited(looks: Vec, ahead: Vec) -> Vec:
    """Return a direction limited to MAX_ECCENTRICITY from straight ahead."""
    angle = acos(clamp(dot(looks, ahead), -1.0, 1.0))
    if angle <= MAX_ECCENTRICITY:
        return looks
    turn = between(ahead, looks)
    half = acos(clamp(turn[0], -1.0, 1.0))
    share = sin(half * MAX_ECCENTRICITY / angle) / max(sin(half), 1e-9)
    part = (cos(half * MAX_ECCENTRICITY / angle), turn[1] * share, turn[2] * share, turn[3] * share)
    return rotate(part, ahead)


def _lid_weights(left: Vec, right: Vec) -> dict[str, float]:
    """Return ARKit's eyeLook weights for two directions in the head's axes, as lids follow the gaze."""
    out = {}
    for side, (x, y, z), inwards in (("Left", left, 1), ("Right", right, -1)):
        up, across = asin(clamp(y, -1.0, 1.0)), atan2(x, -z) * inwards
        out[f"eyeLook{'Up' if up > 0 else 'Down'}{side}"] = min(1.0, abs(up) / LID_RANGE)
        out[f"eyeLook{'In' if across > 0 else 'Out'}{side}"] = min(1.0, abs(across) / LID_RANGE)
    return out
