"""Where the feet of who stands are, and how far off the body says it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.checked import checked, standing
from glsplat.tracking.learned.expected import FARTHEST, ExpectedError
from glsplat.tracking.learned.hints import FootHint
from glsplat.tracking.learned.stance import NETWORK, Stance
from glsplat.tracking.solve.body import ANKLES, HEAD, PELVIS, WRISTS, Body
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.stepping.foot import Foot
from tests.tracking.moves import DT, Stage, head_turn, seconds

Place = tuple[float, float, float]


def hints_at(left: Place, right: Place) -> list[FootHint]:
    return [FootHint(ball, (0.0, 0.0, 0.0), 0.0, 0.0, 1.0, 1.0, ball) for ball in (left, right)]


def feet_at(left: Place, right: Place) -> list[Foot]:
    feet = [Foot(0), Foot(1)]
    for foot, place in zip(feet, (left, right), strict=True):
        foot.plant(place, 0.0)
    return feet


def stood(body: Body, moves: Callable[[float], Place], hint: Place, plain: Place) -> tuple[Stance, FootHint]:
    """The left foot's hint after two seconds of a head that ``moves`` from its rest place."""
    stance = Stance(body)
    x, _, z = body.joints[HEAD]
    other = (-0.15, 0.02, 0.0)
    hints = hints_at(hint, other)
    for i in range(144):
        a, b, c = moves(i * DT)
        targets = Targets((x + a, body.eye_height + b, z + c), (1.0, 0.0, 0.0, 0.0))
        hints = hints_at(hint, other)
        stance.update(targets, hints, feet_at(plain, other), DT)
    return stance, hints[0]


def test_a_lone_wild_guess_of_a_standing_foot_is_outvoted(body: Body) -> None:
    """The network's guess is a metre off: the analytic foot or the usual stance, whichever is nearer, halves that."""
    sane = (0.15, 0.02, -0.1)
    stance, hint = stood(body, lambda t: (0.0, 0.0, 0.0), (0.15, 0.02, 1.0), sane)
    assert stance.share == 1
    assert hint.ball[2] < NETWORK * 1.0 + 0.05
    assert hint.ball[1] == 0.02  # only over the ground
    # a wild analytic foot changes nothing that the other two agree on
    home = stance.home[0]
    eye = body.joints[HEAD]
    agreed = (eye[0] + home[0], 0.02, eye[2] + home[2])
    _, hint = stood(body, lambda t: (0.0, 0.0, 0.0), agreed, (3.0, 0.02, 3.0))
    np.testing.assert_allclose(hint.ball, agreed, atol=1e-6)


def test_who_walks_squats_or_sits_has_the_feet_that_the_network_says(body: Body) -> None:
    far = (0.15, 0.02, 1.0)
    for moves in (lambda t: (0.0, 0.0, 1.2 * t), lambda t: (0.0, -0.35, 0.0)):
        stance, hint = stood(body, moves, far, (0.15, 0.02, -0.1))
        assert stance.share == 0 and hint.ball == far
    # who sways on the spot stands all the same
    stance, hint = stood(body, lambda t: (0.03 * np.sin(6 * t), 0.0, 0.0), far, (0.15, 0.02, -0.1))
    assert stance.share > 0.6


def test_a_body_says_how_far_off_it_is(stage: Stage, skeleton: Skeleton) -> None:
    """Twenty-two distances: small where a device is, larger for feet, for low heads, and without hands; smooth."""
    x, y, z = stage.eye
    tracker = Tracker(skeleton)
    said = []
    for t in seconds(4.0):
        low = 0.3 * y * min(max(t - 2.0, 0.0), 1.0)
        tracker.update(stage.sample(t, head=(x, y - low, z), turn=head_turn(0.1 * np.sin(t))))
        said.append(tracker.expected_error)
    table = np.array(said)
    assert table.shape == (len(said), 22) and np.isfinite(table).all() and (table >= 0).all()
    stands, low = table[140], table[-1]
    assert stands[HEAD] < stands[PELVIS] < stands[ANKLES[0]] < 0.5
    assert low[PELVIS] > 1.2 * stands[PELVIS]
    assert np.abs(np.diff(table, axis=0)).max() < 0.02
    blind = Tracker(skeleton, head_only=True)
    for t in seconds(1.0):
        blind.update(stage.sample(t))
    assert blind.expected_error[WRISTS[0]] > 0.05 > 10 * stands[WRISTS[0]]


def test_metres_are_the_users_and_the_analytic_solver_says_nothing(stage: Stage, skeleton: Skeleton) -> None:
    sample = stage.sample(0.0)
    whole = Tracker(skeleton)
    whole.update(sample)
    small = Tracker(skeleton, Calibration(scale=0.5))
    poses = {name: getattr(sample, name) for name in ("head", "left", "right")}
    small.update(replace(sample, **{name: (*np.multiply(p[:3], 0.5), *p[3:]) for name, p in poses.items()}))
    np.testing.assert_allclose(small.expected_error, np.multiply(whole.expected_error, 0.5), rtol=1e-6)
    plain = Tracker(skeleton, solver="analytic")
    plain.update(sample)
    assert plain.expected_error == ()


def test_any_gap_gives_finite_metres(body: Body) -> None:
    expected = ExpectedError(body.eye_height)
    for gap in (0.0, 1e-9, 1e3, 1e30):
        out = expected.update(Targets((0.0, 1e6, 0.0), (1.0, 0.0, 0.0, 0.0)), gap, 1e-4)
        assert np.isfinite(out).all() and 0 <= min(out) and max(out) <= FARTHEST * expected.unit + 1e-9


def test_a_solver_of_ones_own_may_say_it_too() -> None:
    known = standing((0.0, 1.0, 0.0))
    known.expected_error = (0.1,) * 22
    assert checked(known).expected_error == (0.1,) * 22
    for wrong in ((0.1,) * 3, (-1.0,) + (0.1,) * 21, (float("nan"),) + (0.1,) * 21):
        known.expected_error = wrong
        with pytest.raises(PoseError, match="expected_error"):
            checked(known)
