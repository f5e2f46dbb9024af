"""Idle face: where the eyes look and when the lids close, for a head whose eyes no sensor sees.

Without it an avatar stares past everybody and never blinks. Eyes rest on points of the world and leap from one to the
next; while the head turns they stay on theirs (the vestibulo-ocular reflex), so a nod does not shake the gaze. Leaps
have the sizes and durations that were measured on people in talk (Lee, Badler & Badler, "Eyes Alive", SIGGRAPH 2002).
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

__all__ = ["IdleFace"]

AHEAD = 1.5  # metres to what nobody in particular is looked at
EYES_APART = 0.063  # metres
FIXED, VARIES = 0.34, 0.5  # seconds: median of a rest, and the spread of its logarithm; 2.3 leaps a second
BRIEFEST, LONGEST = 0.15, 2.0  # seconds of a rest
FARTHEST = radians(22)  # of the eyes from straight ahead; farther, the head has to turn
NOTICED = radians(30)  # a face within this angle of straight ahead is looked at
AT_FACE = 0.75  # of the leaps go to the face, from eye to eye to mouth, the others beside it
LED = 0.3  # of the way that the head has turned from what it left behind, the eyes go on beyond straight ahead
NEAREST, FARTHEST_FACE = 0.25, 10.0  # metres; nearer is one's own head, and beyond nobody meets an eye
FEATURES: tuple[Vec, ...] = ((-0.03, 0.0, 0.0), (0.03, 0.0, 0.0), (0.0, -0.07, 0.0))  # metres from between the eyes
LEVEL = 0.5  # of a leap up or down: most of what there is to see lies at the height of the eyes
BLINKS = 15 / 60  # a second
SPARED = 1.0  # seconds after a blink without another
SHIFT = radians(30)  # a leap of gaze beyond this is made with closed eyes
CLOSING, CLOSED, OPENING = 0.08, 0.04, 0.16  # seconds (Trutoiu et al. 2011: lids fall faster than they rise)
LIDS = radians(40)  # of the gaze at which ARKit's eyeLook shapes are full
GAP = 1.0  # seconds without a sample; then everything begins anew


class IdleFace:
    """One person's. Deterministic: the same samples and seed give the same looks.

    >>> idle = IdleFace(seed=1)
    >>> sample = idle.fill(Sample(0.0, head=(0, 1.6, 0, 0, 0, 0, 1)))
    >>> sample.left_eye is not None
    True
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._chance = Random(self._seed)
        self._time: float | None = None
        self._at: Vec = (0.0, 0.0, 0.0)  # the point of the world that is looked at
        self._before: Vec = self._at  # ... and that was, before the last leap
        self._feature = 0  # of the face, that was looked at last
        self._meets = False  # whether that is looked at, as far aside as the eyes turn
        self._leapt = self._leap = 0.0  # when, and the seconds it takes
        self._next = 0.0  # leap
        self._blinked, self._blink = -1e9, 0.0  # when the last began, and when the next will
        self._looks: Vec = (0.0, 0.0, -1.0)  # of the gaze in the world when it was last at rest

    def fill(self, sample: Sample, faces: Sequence[Sequence[float]] = ()) -> Sample:
        """The sample with gaze and lids where it has none of its own.

        ``faces``: places [3] between the eyes of those whom one may look at, a mirror's among them, in the sample's
        space. The one nearest to straight ahead is looked at, up to 30 degrees aside and .25 to 10 m away. A sample
        without a head, or with eyes and eyelids of its own, is returned as it came.
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
            weights |= _lids(*eyes)
        if blinks:
            closed = self._closed(sample.t)
            weights |= {"eyeBlinkLeft": closed, "eyeBlinkRight": closed} if closed > 0 else {}
        expression: Mapping[str, float] | None = {**weights, **(sample.expression or {})} or sample.expression
        if not gazes:
            return replace(sample, expression=expression)
        return replace(sample, expression=expression, left_eye=eyes[0], right_eye=eyes[1])

    def _advance(self, t: float, place: Vec, turn: Quat, faces: Sequence[Sequence[float]]) -> None:
        ahead = rotate(turn, (0.0, 0.0, -1.0))
        fresh = self._time is None or not 0 <= t - self._time < GAP
        if fresh:
            self.reset()
            self._blink = t + self._pause()
        self._time = t
        if t < self._leapt + self._leap:
            return
        gaze = unit(sub(self._at, place), ahead)
        left_behind = not fresh and dot(gaze, ahead) < cos(NOTICED if self._meets else FARTHEST)
        if fresh or left_behind or t >= self._next:
            # eyes lead a head that turns, else they would have to leap after it all the time
            lead = unit(add(ahead, scale(sub(ahead, gaze), LED)), ahead) if left_behind else ahead
            self._before, self._at = self._at, self._chosen(place, turn, ahead, lead, faces)
            looks = unit(sub(self._at, place), ahead)
            angle = 0.0 if fresh else acos(clamp(dot(looks, self._looks), -1.0, 1.0))
            if fresh:
                self._before = self._at
            self._looks, self._leapt = looks, t
            self._leap = 0.025 + 0.0024 * degrees(angle)  # Eyes Alive: 25 ms and 2.4 ms a degree
            rest = FIXED * exp(VARIES * self._chance.gauss(0.0, 1.0))
            self._next = t + self._leap + clamp(rest, BRIEFEST, LONGEST)
            if angle > SHIFT and t - self._blinked > SPARED:
                self._blinked, self._blink = t, t + self._pause()
        if t >= self._blink:
            self._blinked, self._blink = t, t + self._pause()

    def _pause(self) -> float:
        return SPARED + self._chance.expovariate(1 / (1 / BLINKS - SPARED))

    def _chosen(self, place: Vec, turn: Quat, ahead: Vec, lead: Vec, faces: Sequence[Sequence[float]]) -> Vec:
        """The next point to look at; where there is no face, about the direction ``lead``."""
        face = _noticed(place, ahead, faces)
        to_face = self._chance.random() < AT_FACE
        self._meets = face is not None and to_face
        if face is not None and to_face:
            self._feature = (self._feature + self._chance.choice((1, 2))) % len(FEATURES)  # never the same again
            return add(face, rotate(turn, FEATURES[self._feature]))
        base = lead if face is None else unit(sub(face, place), ahead)
        far = AHEAD if face is None else max(0.3, dot(sub(face, place), base))
        # Eyes Alive: sizes of leaps, -6.9 ln(P / 15.7) degrees where P % of them are larger; about half of it from rest
        size = radians(min(22.7, -6.9 * log(self._chance.uniform(0.6, 15.0) / 15.7)))
        way = self._chance.choice((0.0, 0.0, 0.5, 1.0, 1.0, 1.5)) * pi + self._chance.gauss(0.0, 0.25)
        # a turn about an axis across the line of sight, in the head's own axes
        axis = rotate(turn, (-LEVEL * sin(way), cos(way), 0.0))
        aside = rotate(normalized((cos(0.5 * size), *scale(axis, sin(0.5 * size)))), base)
        return add(place, scale(_within(aside, ahead), far))

    def _eye(self, place: Vec, turn: Quat, side: int, t: float) -> Vec:
        """Where an eye looks, in the head's axes; ``side`` -1 is the left one's."""
        done = 1.0 if self._leap <= 0 else clamp((t - self._leapt) / self._leap, 0.0, 1.0)
        done = done * done * done * (10 + done * (6 * done - 15))  # minimum jerk
        point = add(scale(self._before, 1 - done), scale(self._at, done))
        eye = add(place, rotate(turn, (0.5 * EYES_APART * side, 0.0, 0.0)))
        return rotate(conj(turn), _within(unit(sub(point, eye)), rotate(turn, (0.0, 0.0, -1.0))))

    def _closed(self, t: float) -> float:
        """How far the lids are closed, 0 to 1."""
        since = t - self._blinked
        if since < CLOSING:
            part = since / CLOSING
        else:
            part = 1 - clamp((since - CLOSING - CLOSED) / OPENING, 0.0, 1.0)
        return part * part * (3 - 2 * part)


def _noticed(place: Vec, ahead: Vec, faces: Sequence[Sequence[float]]) -> Vec | None:
    """The face nearest to straight ahead, or None."""
    best, least = None, cos(NOTICED)
    for one in faces:
        at = read_position(one, 1.0, 0.0, [])
        if at is None or not NEAREST**2 < dot(away := sub(at, place), away) < FARTHEST_FACE**2:
            continue
        if (along := dot(unit(away), ahead)) > least:
            best, least = at, along
    return best


def _within(looks: Vec, ahead: Vec) -> Vec:
    """No farther from straight ahead than eyes turn without the head."""
    angle = acos(clamp(dot(looks, ahead), -1.0, 1.0))
    if angle <= FARTHEST:
        return looks
    turn = between(ahead, looks)
    half = acos(clamp(turn[0], -1.0, 1.0))
    share = sin(half * FARTHEST / angle) / max(sin(half), 1e-9)
    part = (cos(half * FARTHEST / angle), turn[1] * share, turn[2] * share, turn[3] * share)
    return rotate(part, ahead)


def _lids(left: Vec, right: Vec) -> dict[str, float]:
    """ARKit's eyeLook weights of two directions in the head's axes: lids follow the gaze."""
    out = {}
    for side, (x, y, z), inwards in (("Left", left, 1), ("Right", right, -1)):
        up, across = asin(clamp(y, -1.0, 1.0)), atan2(x, -z) * inwards
        out[f"eyeLook{'Up' if up > 0 else 'Down'}{side}"] = min(1.0, abs(up) / LIDS)
        out[f"eyeLook{'In' if across > 0 else 'Out'}{side}"] = min(1.0, abs(across) / LIDS)
    return out
