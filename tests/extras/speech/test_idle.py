"""The idle face: eyes that rest and leap, lids that close, and neither where a sensor knows better."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import cos, degrees, radians, sin

import numpy as np
import pytest

from glsplat.extras.speech.idle import IdleFace
from glsplat.tracking.face import eye_turn
from glsplat.tracking.sample import Sample

RATE = 90


def head(yaw: float = 0.0, place=(0.3, 1.6, -0.2)):
    """Degrees about y."""
    return (*place, 0.0, sin(radians(yaw) / 2), 0.0, cos(radians(yaw) / 2))


def played(seconds: float, yaw=lambda t: 0.0, faces=(), seed=3, rate=RATE) -> list[Sample]:
    idle = IdleFace(seed)
    return [idle.fill(Sample(k / rate, head(yaw(k / rate))), faces) for k in range(int(seconds * rate))]


def in_world(sample: Sample, eye="left_eye") -> np.ndarray:
    x, y, z = getattr(sample, eye)
    _, qy, _, qw = sample.head[3:]
    yaw = 2 * np.arctan2(qy, qw)
    return np.array([cos(yaw) * x + sin(yaw) * z, y, cos(yaw) * z - sin(yaw) * x])


def degrees_between(a, b) -> float:
    return degrees(np.arccos(np.clip(np.dot(a, b), -1, 1)))


def leaps(samples: list[Sample]) -> int:
    """Moments at which the gaze begins to move faster than 30 degrees a second."""
    looks = np.array([in_world(one) for one in samples])
    turned = np.degrees(np.arccos(np.clip((looks[1:] * looks[:-1]).sum(axis=1), -1, 1))) * RATE
    fast = turned > 30
    return int((fast[1:] & ~fast[:-1]).sum())


@pytest.mark.parametrize("face", [(), ((0.5, 1.7, -1.4),)], ids=["nobody", "a face"])
@pytest.mark.parametrize("swing", [5, 30, 60])
def test_leaps_are_two_or_three_a_second_whatever_the_head_does(swing, face):
    samples = played(60, yaw=lambda t: swing * np.sin(t), faces=face)
    assert 2 <= leaps(samples) / 60 <= 3
    for one in samples[::7]:
        for gaze in (one.left_eye, one.right_eye):
            turn = np.array(eye_turn(gaze, []))
            assert np.linalg.norm(turn) < radians(22.1) and abs(turn[2]) < 1e-12, "no roll: Listing's law"


@pytest.mark.parametrize("face", [(0.3, 1.6, -0.3), (0.3, 1.6, -80.0), (float("nan"), 0, 0), (0.0,), "x"])
def test_what_is_no_face_to_meet_is_not_looked_at(face):
    assert played(3, faces=[face]) == played(3)


def test_lids_close_fifteen_times_a_minute_and_fall_faster_than_they_rise():
    closed = np.array([(one.expression or {}).get("eyeBlinkLeft", 0.0) for one in played(300)])
    begins = np.flatnonzero((closed[1:] > 0) & (closed[:-1] == 0))
    assert 12 <= len(begins) / 5 <= 18
    assert np.diff(begins).min() / RATE > 0.5
    first = closed[begins[0] : begins[0] + RATE // 2]
    assert first.max() == 1
    assert np.argmax(first == 1) < np.flatnonzero(first > 0)[-1] - np.flatnonzero(first == 1)[-1]


def test_while_the_head_turns_the_eyes_stay_on_their_point():
    """At 30 degrees a second a gaze that is fixed to the head would move as fast; this one moves in leaps alone."""
    samples = played(20, yaw=lambda t: 30 * np.sin(t))
    speeds = [degrees_between(in_world(a), in_world(b)) * RATE for a, b in pairwise(samples)]
    still = [speed for speed in speeds if speed < 30]
    assert len(still) > 0.8 * len(samples)
    assert np.median(still) < 1.0


def test_a_face_ahead_is_looked_at_and_one_behind_is_not():
    face = np.array([0.5, 1.7, -1.4])
    towards = (face - (0.3, 1.6, -0.2)) / np.linalg.norm(face - (0.3, 1.6, -0.2))
    near = [degrees_between(in_world(one), towards) for one in played(60, faces=[face])]
    assert np.mean(np.array(near) < 5) > 0.6
    assert played(3, faces=[(0.3, 1.6, 3.0)]) == played(3)


def test_eyes_converge_on_what_is_near():
    apart = []
    for far in (0.4, 4.0):
        sample = played(0.1, faces=[(0.3, 1.6, -0.2 - far)], seed=5)[-1]
        apart.append(degrees_between(sample.left_eye, sample.right_eye))
    assert apart[0] == pytest.approx(degrees(0.063 / 0.4), rel=0.1)
    assert apart[1] == pytest.approx(degrees(0.063 / 4.0), rel=0.1)


def test_a_turn_of_the_gaze_beyond_thirty_degrees_comes_with_a_blink():
    samples = played(1.0) + []
    idle = IdleFace(3)
    for one in samples:
        idle.fill(replace(one, left_eye=None, right_eye=None, expression=None))
    turned = [idle.fill(Sample(1.0 + k / RATE, head(80))) for k in range(RATE // 2)]
    assert max((one.expression or {}).get("eyeBlinkLeft", 0.0) for one in turned) == 1


def test_sensors_win():
    idle = IdleFace()
    seen = Sample(0.0, head(), left_eye=(0, 0, -1), right_eye=(0, 0, -1), expression={"eyeBlinkLeft": 0.3})
    assert idle.fill(seen) == seen
    eyes = replace(seen, expression=None)
    assert idle.fill(eyes).left_eye == eyes.left_eye
    talks = idle.fill(Sample(0.1, head(), expression={"jawOpen": 0.4}))
    assert talks.expression["jawOpen"] == 0.4 and talks.left_eye is not None
    live_link = Sample(0.2, head(), expression={"EyeBlinkLeft": 0.9})
    assert "eyeBlinkLeft" not in (idle.fill(live_link).expression or {})


@pytest.mark.parametrize("sample", [Sample(0.0), Sample(float("nan"), head()), Sample(0.0, (float("nan"),) * 7)])
def test_what_cannot_be_a_head_is_returned_as_it_came(sample):
    assert IdleFace().fill(sample) is sample


def test_gaps_and_clocks_that_go_back_begin_anew():
    idle = IdleFace()
    for t in (0.0, 100.0, 3.0, 3.0, -1e9):
        one = idle.fill(Sample(t, head(place=(t % 7, 1.6, 0.0))))
        assert np.degrees(np.arccos(-one.left_eye[2])) < 22.1
