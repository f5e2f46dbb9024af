"""Poses that are drawn ahead of their samples: for whom, how far, and what it is worth."""

from __future__ import annotations

import json

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.extras.motions.derive import derive, truth_from_motion
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.backends.tracking import HORIZON_SHARE, MAX_HORIZON_S, PredictionHorizon, TrackingSolver
from glsplat.net.messages import Decoder, Request
from glsplat.net.session import Session, SessionConfig
from glsplat.net.wire_schema import Arrival
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.config import OneEuro
from glsplat.tracking.filters import PositionFilter, RotationFilter, Trend
from glsplat.tracking.solve.quat import rotation_angle, yaw_quat
from tests.net.wire import EYE

RATE = 72


def test_who_says_nothing_is_drawn_as_it_was() -> None:
    ahead = PredictionHorizon()
    assert [ahead.update(None) for _ in range(100)] == [0.0] * 100


@pytest.mark.parametrize(
    ("age", "expected"), [(20.0, HORIZON_SHARE * 0.02), (100.0, MAX_HORIZON_S), (60_000.0, MAX_HORIZON_S), (0.0, 0.0)]
)
def test_it_follows_the_age_slowly_and_not_too_far(age: float, expected: float) -> None:
    ahead = PredictionHorizon()
    steps = [ahead.update(Arrival(age) if i % 3 == 0 else None) for i in range(300)]
    assert steps[-1] == pytest.approx(expected)
    assert np.abs(np.diff([0.0, *steps])).max() <= 0.001


def test_lies_that_change_each_time_move_nothing_by_much() -> None:
    ahead = PredictionHorizon()
    steps = [ahead.update(Arrival((0.0, 60_000.0)[i % 2])) for i in range(500)]
    assert 0 <= min(steps) and max(steps) <= MAX_HORIZON_S and np.abs(np.diff(steps)).max() <= 0.001


@pytest.mark.parametrize("adapts", [True, False])
def test_a_server_that_fits_nothing_predicts_nothing(adapts: bool) -> None:
    session = Session(Decoder(), SessionConfig(adapt=adapts))
    text = json.dumps({"v": 1, "frame_id": 1, "ack": 0, "arrival": {"age": 80}, "eyes": [EYE]})
    request = session.receive(text, 0.1)
    assert isinstance(request, Request) and (request.arrival is not None) == adapts


@pytest.mark.check
def test_hands_are_nearer_to_where_they_are_when_seen() -> None:
    """A motion that nothing was chosen by, as its headset sees it, 60 ms later; no noise."""
    skeleton = default_avatar().skeleton
    motion = load_embedded_motion("wave-and-turn", skeleton)
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, RATE)
    late = round(0.06 * RATE)
    errors = {}
    for age in (None, 60.0):
        solver = TrackingSolver(skeleton, Calibration())
        hands = []
        for index, sample in enumerate(derive(skeleton, truth, fingers=False)):
            text = {"v": 1, "frame_id": index + 1, "ack": 0, "t": sample.t * 1e3, "tracking": sample.to_json()}
            text |= {} if age is None else {"arrival": {"age": age}}
            request = Decoder().decode(json.dumps(text))
            assert isinstance(request, Request)
            pose = solver.solve(request, sample.t).pose
            hands.append(solver._tracker.joints(pose)[[20, 21]])
        found, true = np.array(hands)[2 * RATE : -late], truth.positions[2 * RATE + late :, [20, 21]]
        errors[age] = np.linalg.norm(found - true, axis=-1).mean()
    assert errors[60.0] < 0.75 * errors[None]


def test_a_trend_is_the_slope_and_asks_for_a_past() -> None:
    trend, noise = Trend(20.0), np.random.default_rng(3)
    assert trend.velocity() is None
    for _ in range(200):
        trend.add((0.5 / RATE, noise.normal(0, 1e-4), -1 / RATE), 1 / RATE)
    found = trend.velocity()
    assert found is not None and np.allclose(found, (0.5, 0.0, -1.0), atol=0.01)
    slow = Trend(20.0)
    for _ in range(20):
        slow.add((1.0, 0.0, 0.0), 0.2)  # five samples a second: no past that is short enough
    assert slow.velocity() is None


def test_a_prediction_trembles_less_than_by_the_filters_own_speed() -> None:
    """Of a hand that waves, with noise: the same way ahead, more often."""
    noise = np.random.default_rng(4)
    place, turn = PositionFilter(OneEuro(1.0, 40.0, 0.5), 20.0), RotationFilter(OneEuro(0.0, 0.0), 100.0)
    by_trend, by_speed = [], []
    for i in range(500):
        raw = tuple(0.2 * np.sin(2 * np.pi * 1.2 * i / RATE + k) + noise.normal(0, 7e-4) for k in range(3))
        value = place.update(raw, 1 / RATE)
        by_speed.append(np.add(value, np.multiply(place.velocity, 0.04)))
        by_trend.append(place.ahead(0.04, 0.1))
        turn.update(yaw_quat(i / RATE), 1 / RATE)
        turned = turn.ahead(0.04, 0.35)
    assert rotation_angle(turned) == pytest.approx(499 / RATE + 0.04 - 2 * np.pi, abs=1e-3)
    trembling = [np.abs(np.diff(np.array(one)[50:], 3, axis=0)).mean() for one in (by_trend, by_speed)]
    assert trembling[0] < 0.75 * trembling[1]
