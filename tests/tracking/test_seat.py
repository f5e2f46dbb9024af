"""Who plays seated: told by a head that keeps as high as over a chair, the pelvis below it, the feet on the ground."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.tracking import Sample
from glsplat.tracking.learned.seat import LONG, Seat
from glsplat.tracking.solve.body import FEET, HEAD, KNEES, Body
from tests.tracking.moves import Stage, Track, head_turn, seconds

RATE = 30


def seated(stage: Stage, length: float, high: float = 0.76, lean: float = 0.0) -> list[Sample]:
    """Somebody on a chair who looks about and moves both controllers ahead of the chest."""
    samples = []
    for t in seconds(length, 1 / RATE):
        sway = 0.02 * np.sin(1.7 * t)
        forward = lean * np.clip(t - 6, 0, 1)
        eyes = (sway, high * stage.body.eye_height - 0.3 * forward + 0.01 * np.sin(2.3 * t), 0.13 + forward)
        left = (0.2 + 0.1 * np.sin(2 * t), eyes[1] - 0.35, 0.45 + forward)
        right = (-0.2, eyes[1] - 0.4 + 0.15 * np.sin(3 * t), 0.4 + forward)
        turn = head_turn(0.4 * np.sin(0.9 * t), 0.15)
        samples.append(stage.sample(t, head=eyes, turn=turn, left=left, right=right))
    return samples


@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_a_seated_start_is_told_and_sits(stage: Stage, track: Track, lean: float) -> None:
    samples = seated(stage, 9.0, lean=lean)
    run = track(samples, solver="learned")
    late = slice(5 * RATE, None)
    assert all("sitting" in flags for flags in run.flags[late])
    eyes = np.array([s.head[:3] for s in samples])[late]  # type: ignore[index]
    pelvis, knees, feet = (run.joints[late, list(which)] for which in ((0,), KNEES, FEET))
    assert np.abs(pelvis[:RATE, 0, [0, 2]] - eyes[:RATE, [0, 2]] + [0, 0.13]).max() < 0.1  # below the head
    assert np.ptp(pelvis[:, 0], axis=0).max() < 0.07  # whatever the head does above it
    assert (knees[..., 1] > 0.35).all() and (knees[..., 2] > pelvis[..., 2] + 0.25).all()  # thighs ahead
    feet = feet[2 * RATE :]  # they have come to where they stay
    assert np.ptp(feet, axis=0).max() < 0.05 and feet[..., 1].max() < stage.body.sole + 0.03
    assert np.abs(run.joints[late, HEAD, 1] - run.joints[late, HEAD, 1].mean()).max() < 0.08


def test_who_gets_up_stands(stage: Stage, track: Track) -> None:
    samples = seated(stage, 6.0)
    top = samples[-1].head
    for i, t in enumerate(seconds(3.0, 1 / RATE)):
        up = 0.5 - 0.5 * np.cos(np.pi * min(t, 1.0))
        height = top[1] + up * (0.98 * stage.body.eye_height - top[1])
        samples.append(stage.sample(6.0 + i / RATE, head=(top[0], height, top[2] + 0.3 * up)))
    run = track(samples, solver="learned")
    assert "sitting" in run.flags[6 * RATE - 1] and "sitting" not in run.flags[-1]
    assert run.joints[-1, 0, 1] > 0.9 * stage.body.joints[0][1] - stage.body.ground
    assert np.linalg.norm(np.diff(run.joints[:, 0], axis=0), axis=-1).max() * RATE < 3


@pytest.mark.parametrize(
    ("high", "pace", "dips"), [(0.76, 0.5, 0.0), (0.76, 0.0, 0.12), (0.98, 0.0, 0.0), (0.5, 0.0, 0.0)]
)
def test_who_walks_bobs_stands_or_kneels_sits_on_no_chair(body: Body, high: float, pace: float, dips: float) -> None:
    seat = Seat(body)
    for t in seconds(2 * LONG, 1 / RATE):
        eye = (pace * t, high * body.eye_height + dips * np.sin(4 * t), 0.0)
        assert seat.update((eye[0], 0.97 * seat.size, -0.1), eye, (1.0, 0.0, 0.0, 0.0), 1 / RATE) is None
    assert not seat.sits
