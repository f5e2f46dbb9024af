"""Parts of the solvers by themselves: rotations, joint limits, filters, gait, steps, feet and expected errors."""

from __future__ import annotations

import math
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glsplat.extras.learned.feet import SET_DOWN_S, Feet
from glsplat.extras.learned.hints import FootHint
from glsplat.extras.learned.uncertainty import ExpectedError
from glsplat.extras.motions.derive import resample
from glsplat.rotations import matrix_quaternions, quaternion_vectors, rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker, TrackerConfig
from glsplat.tracking.body_size import STRETCHED_WRISTS as SHOULDER_HEIGHTS
from glsplat.tracking.body_size import BodySizeFinder
from glsplat.tracking.config import HAND_POSITION, HAND_ROTATION, HEAD_POSITION, HEAD_ROTATION, OneEuro
from glsplat.tracking.filters import PositionFilter, RotationFilter
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import ANKLES, COLLARS, ELBOWS, HEAD, HIPS, KNEES, PELVIS, SHOULDERS, WRISTS, Body
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.gait import Gait
from glsplat.tracking.solve.leg import Leg
from glsplat.tracking.solve.legs import STEP_S, STEP_TURN_RAD, Legs
from glsplat.tracking.solve.limits import clamp_joint, violation
from glsplat.tracking.solve.quat import IDENTITY, inverse_mul, mul, rotate, rotation_angle, to_quat, yaw_quat
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.tracked import FOUND_S, TrackedFoot
from tests.tracking.moves import DT, Stage, seconds


def phases(heading: float) -> list[float]:
    """Of a walk that way, facing elsewhere, whose head sways by 3 cm."""
    gait, s, c = Gait(0.83), sin(heading), cos(heading)
    out = []
    for t in seconds(4):
        along, across = 1.2 * t, 0.03 * sin(2 * pi * 0.9 * t)
        neck = (along * s + across * c, 1.4, along * c - across * s)
        gait.update(neck, 0.4, None, None, (1.2 * s, 0.0, 1.2 * c), 1.2, 0.96, True, DT)
        out.append(gait.phase)
    return out


def test_sway_is_across_the_way_a_walk_goes() -> None:
    north = phases(0.0)
    assert len(set(north)) > 100
    for heading in (pi / 2, pi, 1.0):
        assert phases(heading) == pytest.approx(north, abs=1e-6)


@pytest.mark.parametrize("low", [True, False])
def test_hands_at_the_bounds_of_shoulder_height_are_not_stretched(body: Body, low: bool) -> None:
    finder = BodySizeFinder(body, 1.0)
    for height, counts in ((SHOULDER_HEIGHTS[0 if low else 1], False), (0.9, True)):
        hands = [(x, height, 0.0) for x in (-0.7, 0.7)]
        finder.update((0.0, 1.0, 0.0), IDENTITY, hands, DT)
        assert (finder.spans.sum() > 0) == counts


def test_a_body_that_stands_is_not_far_from_where_it_is_shown(body: Body) -> None:
    """Nobody's collars are further off than their pelvis."""
    expected = ExpectedError(body.eye_height)
    out = expected.update(Targets((0.0, body.eye_height, 0.0), IDENTITY), 0.05, DT)
    assert 0.01 < out[PELVIS] < 0.3
    assert all(0.01 < out[joint] < out[PELVIS] for joint in (HEAD, *COLLARS, *SHOULDERS))


def test_a_foot_is_set_down_however_the_samples_divide_the_time(body: Body) -> None:
    """It lands where no time is left, not only where less is."""
    feet, pelvis = Feet(body), body.joints[PELVIS]
    x, _, z = body.joints[10]
    still = FootHint((-x, feet.sole, z), (0.0, 0.0, 0.0), 0.0, 0.0, 1.0, 1.0, (-x, 0.5, z))
    for place, stands, times in ((0.0, 1.0, 10), (0.3, 0.0, 5), (0.3, 1.0, 3)):
        hint = FootHint((x, feet.sole, z + place), (0.0, 0.0, 0.0), 0.0, 0.0, stands, 1.0, (x, 0.5, z))
        for _ in range(times):
            feet.update([hint, still], pelvis, IDENTITY, 0.0, SET_DOWN_S / 2)
        assert feet.feet[0].planted == (stands > 0)


def test_the_further_a_foot_is_off_the_quicker_it_steps(body: Body) -> None:
    durations = []
    for turn in (1.1, 2.2, 3.3):
        legs, pelvis = Legs(body), body.joints[PELVIS]
        for yaw in (0.0, turn * STEP_TURN_RAD / 1.3):  # a step looks 0.3 s ahead in a turn
            legs.update((0.0, 0.0, 0.0), pelvis, IDENTITY, yaw, (0.0,) * 3, (0.0,) * 3, 0.0, 1.0)
        durations.append(next(foot.duration for foot in legs.feet if not foot.planted))
    assert durations == pytest.approx([STEP_S * share for share in (1.0, 0.86, 0.64)], rel=1e-3)


def test_a_foot_whose_tracker_is_found_turns_towards_it(body: Body) -> None:
    leg = Leg(body, 0)
    follow, foot, turn = TrackedFoot(leg), Foot(0), to_quat((0.0, 1.0, 0.0))
    foot.plant((0.1, leg.sole, 0.0), 0.0)
    follow.place(foot, None, None, DT)
    angles = []
    for _ in seconds(FOUND_S + 2 * DT):
        follow.place(foot, ((0.1, 0.1, 0.0), turn), None, DT)
        angles.append(rotation_angle(inverse_mul(follow.turn, turn)))
    assert angles[0] == pytest.approx(1.0, abs=0.02) and angles[-1] == pytest.approx(0.0, abs=1e-6)
    assert angles == sorted(angles, reverse=True)


@pytest.mark.parametrize("speed", [0.45, 1.2])
def test_a_walk_is_the_same_wherever_it_begins(skeleton: Skeleton, stage: Stage, speed: float) -> None:
    poses = []
    for begin in (0.0, 3.0):
        tracker = Tracker(skeleton, config=TrackerConfig.raw())
        moved = [(begin, 0.0, speed * t) for t in seconds(1.0)]
        samples = [
            stage.sample(i * DT, *(tuple(np.add(place, by)) for place in (stage.eye,)), left=None, right=None)
            for i, by in enumerate(moved)
        ]
        poses.append(np.array([tracker.update(sample).rotations for sample in samples]))
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-6)


vectors = st.tuples(*[st.floats(-3.0, 3.0) for _ in range(3)])


@given(vectors, vectors, vectors)
def test_products_and_rotations_agree_with_matrices(a: quat.Vec, b: quat.Vec, v: quat.Vec) -> None:
    qa, qb = quat.to_quat(a), quat.to_quat(b)
    ma, mb = rotation_matrices(a), rotation_matrices(b)
    np.testing.assert_allclose(quat.rotate(quat.mul(qa, qb), v), ma @ mb @ v, atol=1e-9)
    np.testing.assert_allclose(quat.rotate(quat.inverse_mul(qa, qb), v), ma.T @ mb @ v, atol=1e-9)
    np.testing.assert_allclose(rotation_matrices(quat.rotation_vector(qa)), ma, atol=1e-8)
    x, y, z = ma.T  # columns
    np.testing.assert_allclose(rotation_matrices(quat.rotation_vector(quat.from_axes(x, y, z))), ma, atol=1e-6)


@given(vectors, vectors)
def test_between_takes_one_direction_to_the_other(a: quat.Vec, b: quat.Vec) -> None:
    a, b = quat.unit(a), quat.unit(b)
    np.testing.assert_allclose(quat.rotate(quat.between(a, b), a), b, atol=1e-4)  # opposite within 4e-5 rad: any axis
    np.testing.assert_allclose(quat.rotate(quat.between(a, quat.scale(a, -1)), a), quat.scale(a, -1), atol=1e-7)


def test_interpolation_is_short_and_even() -> None:
    a, b = quat.yaw_quat(0.2), quat.yaw_quat(1.8)
    minus = tuple(-v for v in b)
    for t in (0.0, 0.3, 1.0):
        expected = quat.yaw_quat(0.2 + 1.6 * t)
        assert abs(np.dot(quat.slerp(a, b, t), expected)) > 1 - 1e-12
        assert abs(np.dot(quat.slerp(a, minus, t), expected)) > 1 - 1e-12
    assert abs(np.dot(quat.nlerp(a, minus, 0.5), quat.yaw_quat(1.0))) > 1 - 1e-12


def test_heading_of_pitched_heads_and_none_upside_down() -> None:
    for pitch in (-1.5, 0.0, 1.5):
        turned = quat.mul(quat.yaw_quat(0.7), quat.to_quat((pitch, 0.0, 0.0)))
        assert abs(quat.wrap(quat.swing_twist_y(turned) - 0.7)) < 1e-9
    assert quat.swing_twist_y(quat.to_quat((math.pi, 0.0, 0.0))) is None


def test_batched_conversions_at_half_turns(rng: np.random.Generator) -> None:
    vectors = rng.normal(size=(200, 3))
    vectors *= (np.linspace(0, math.pi, 200) / np.linalg.norm(vectors, axis=1))[:, None]
    matrices = rotation_matrices(vectors)
    np.testing.assert_allclose(rotation_matrices(quaternion_vectors(matrix_quaternions(matrices))), matrices, atol=1e-9)


def test_resampling_keeps_the_old_moments_and_is_smooth(rng: np.random.Generator) -> None:
    t = np.arange(61) / 60
    rotations = np.zeros((61, 2, 3))
    rotations[:, 0, 1] = 3.5 * t  # beyond half a turn
    trans = np.stack([np.sin(6 * t), t, 0 * t], 1)
    turned, moved = resample(rotations, trans, 60.0, 120.0)
    assert len(moved) == 121
    np.testing.assert_allclose(rotation_matrices(turned[::2]), rotation_matrices(rotations), atol=1e-9)
    fine = np.arange(121) / 120
    np.testing.assert_allclose(moved[:, 0], np.sin(6 * fine), atol=2e-4)
    assert np.abs(np.diff(moved[:, 0], 2)).max() < 36 / 120**2 * 1.1  # no kinks


D = math.pi / 180


@given(st.integers(1, 21), st.tuples(*[st.floats(-3.1, 3.1) for _ in range(3)]))
def test_clamping_lands_inside_and_stays(joint: int, vector: tuple[float, float, float]) -> None:
    inside = clamp_joint(joint, to_quat(vector))
    assert all(math.isfinite(v) for v in inside) and abs(sum(v * v for v in inside) - 1) < 1e-9
    again = clamp_joint(joint, inside)
    assert abs(sum(a * b for a, b in zip(inside, again, strict=True))) > 1 - 1e-6


@given(st.integers(0, 5), st.tuples(*[st.floats(-3.0, 3.0) for _ in range(3)]))
def test_left_and_right_are_mirror_images(which: int, vector: tuple[float, float, float]) -> None:
    pair = (SHOULDERS, ELBOWS, WRISTS, HIPS, KNEES, ANKLES)[which]
    w, x, y, z = clamp_joint(pair[0], to_quat(vector))
    mirrored = clamp_joint(pair[1], to_quat((vector[0], -vector[1], -vector[2])))
    np.testing.assert_allclose(mirrored, (w, x, -y, -z), atol=1e-9)


@pytest.mark.parametrize(
    ("joint", "vector"),
    [
        (SHOULDERS[0], (0, 0, -90 * D)),  # hanging arm
        (SHOULDERS[0], (0, 0, 90 * D)),  # 180 degrees of abduction
        (SHOULDERS[0], (0, -90 * D, 0)),  # 90 degrees of flexion
        (SHOULDERS[0], (0, -134 * D, 0)),  # horizontal adduction across the chest
        (SHOULDERS[0], (0, 78 * D, -45 * D)),  # 60 degrees of extension
        (ELBOWS[0], (0, -150 * D, 0)),
        (WRISTS[0], (0, 0, -80 * D)),
        (WRISTS[0], (0, 0, 70 * D)),
        (HIPS[0], (-130 * D, 0, 0)),  # a deep squat
        (HIPS[0], (30 * D, 0, 0)),
        (HIPS[0], (0, 0, 45 * D)),
        (KNEES[0], (142 * D, 0, 0)),
        (ANKLES[0], (-40 * D, 0, 0)),  # weight-bearing dorsiflexion
        (ANKLES[0], (60 * D, 0, 0)),
    ],
)
def test_the_ranges_of_the_tables_are_allowed(joint: int, vector: tuple[float, float, float]) -> None:
    q = to_quat(vector)
    assert abs(sum(a * b for a, b in zip(q, clamp_joint(joint, q), strict=True))) > 1 - 1e-9


@pytest.mark.parametrize(
    ("joint", "vector"),
    [
        (SHOULDERS[0], (0, 75 * D, 0)),  # horizontal extension
        (SHOULDERS[0], (150 * D, 0, 0)),
        (ELBOWS[0], (0, 20 * D, 0)),  # hyperextension
        (KNEES[0], (-15 * D, 0, 0)),
        (KNEES[0], (160 * D, 0, 0)),
        (HIPS[0], (60 * D, 0, 0)),
        (ANKLES[0], (-60 * D, 0, 0)),
        (3, (60 * D, 0, 0)),
        (12, (0, 60 * D, 0)),
    ],
)
def test_what_no_joint_does_is_refused(joint: int, vector: tuple[float, float, float]) -> None:
    q = to_quat(vector)
    assert abs(sum(a * b for a, b in zip(q, clamp_joint(joint, q), strict=True))) < 1 - 1e-3
    rotations = np.zeros((55, 3))
    rotations[joint] = vector
    assert violation(rotations) > 4
    assert violation(np.zeros((55, 3))) == 0


def test_a_twisted_bone_keeps_its_direction() -> None:
    q = mul(to_quat((-80 * D, 0, 0)), to_quat((0, 90 * D, 0)))  # thigh forward, rotated too far about itself
    inside = clamp_joint(HIPS[0], q)
    np.testing.assert_allclose(rotate(inside, (0, -1, 0)), rotate(q, (0, -1, 0)), atol=1e-9)


@pytest.mark.parametrize("side", [0, 1])
def test_a_thigh_that_points_up_is_brought_to_the_front_whichever_way_it_passes(side: int) -> None:
    """Around 180 degrees of flexion, where swing and twist from the rest pose are undefined."""
    before = None
    for step in range(73):
        x, z = 6 * math.cos(step * 5 * D), 6 * math.sin(step * 5 * D)
        asked = mul(to_quat((0.0, 0.0, z * D)), to_quat(((x - 178) * D, 0.0, 0.0)))
        inside = clamp_joint(HIPS[side], asked)
        assert rotate(inside, (0.0, -1.0, 0.0))[2] > 0.3  # the knee in front
        if before is not None:
            turned = 2 * math.acos(min(1.0, abs(sum(a * b for a, b in zip(before, inside, strict=True)))))
            assert turned < 6 * D
        before = inside


@pytest.mark.parametrize("setting", [HEAD_POSITION, HAND_POSITION])
def test_a_step_never_overshoots_and_arrives(setting: OneEuro) -> None:
    filter = PositionFilter(setting, 20.0)
    filter.update((0.0, 0.0, 0.0), DT)
    path = [filter.update((0.1, 0.0, 0.0), DT)[0] for _ in range(72)]
    assert max(path) <= 0.1 + 1e-12 and path == sorted(path)
    assert path[5] > 0.09  # a small step is there within 0.1 s
    assert path[-1] == pytest.approx(0.1, abs=1e-4)


@pytest.mark.parametrize("setting", [HEAD_ROTATION, HAND_ROTATION])
def test_a_step_of_rotation_never_overshoots(setting: OneEuro) -> None:
    filter = RotationFilter(setting, 50.0)
    filter.update(yaw_quat(0.0), DT)
    path = [rotation_angle(filter.update(yaw_quat(1.0), DT)) for _ in range(72)]
    assert max(path) <= 1 + 1e-9 and np.diff(path).min() > -1e-12 and path[-1] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("speed", [0.05, 0.11, 0.2, 1.0, 5.0])
def test_the_stated_lag_holds_at_constant_speed(speed: float) -> None:
    filter = PositionFilter(HAND_POSITION, 50.0)
    for i in range(200):
        value = filter.update((speed * i * DT, 0.0, 0.0), DT)
    behind = speed * 199 * DT - value[0]
    assert behind < speed * HAND_POSITION.lag(speed) + 1e-6
    assert behind < 0.009  # metres, whatever the speed


def test_noise_at_rest_is_damped(rng: np.random.Generator) -> None:
    filter = PositionFilter(HAND_POSITION, 50.0)
    noise = rng.normal(0, 0.001, (600, 3))
    out = np.array([filter.update(tuple(v), DT) for v in noise])[50:]
    assert out.std() < 0.75 * noise.std()
    assert np.diff(out, 3, axis=0).std() < 0.05 * np.diff(noise, 3, axis=0).std()


def test_speed_is_limited_and_zero_cutoff_passes() -> None:
    limited = PositionFilter(OneEuro(0.0, 0.0), 2.0)
    limited.update((0.0, 0.0, 0.0), 0.01)
    assert limited.update((1.0, 0.0, 0.0), 0.01) == pytest.approx((0.02, 0.0, 0.0))
    turning = RotationFilter(OneEuro(0.0, 0.0), 3.0)
    turning.update(yaw_quat(0.0), 0.01)
    assert rotation_angle(turning.update(yaw_quat(2.0), 0.01)) == pytest.approx(0.03)
    free = RotationFilter(OneEuro(0.0, 0.0), 500.0)
    free.update(yaw_quat(0.0), 0.01)
    assert rotation_angle(free.update(yaw_quat(2.0), 0.01)) == pytest.approx(2.0)


def test_the_sign_of_a_quaternion_does_not_matter() -> None:
    one, two = RotationFilter(HEAD_ROTATION, 50.0), RotationFilter(HEAD_ROTATION, 50.0)
    for i in range(60):
        q = yaw_quat(0.05 * i)
        a = one.update(q, DT)
        b = two.update(tuple(-v for v in q) if i % 2 else q, DT)
        assert abs(np.dot(a, b)) > 1 - 1e-12


def test_prediction_is_right_at_constant_speed_and_bounded() -> None:
    place, turn = PositionFilter(OneEuro(0.0, 0.0), 100.0), RotationFilter(OneEuro(0.0, 0.0), 100.0)
    for i in range(100):
        place.update((2.0 * i * DT, 0.0, 0.0), DT)
        turn.update(yaw_quat(1.0 * i * DT), DT)
    assert place.ahead(0.03, 0.1)[0] == pytest.approx(2.0 * (99 * DT + 0.03), abs=1e-3)
    assert place.ahead(0.1, 0.1)[0] == pytest.approx(2.0 * 99 * DT + 0.1, abs=1e-6)
    expected = yaw_quat(99 * DT + 0.05)
    assert rotation_angle(inverse_mul(expected, turn.ahead(0.05, 0.35))) < 1e-3
    assert rotation_angle(inverse_mul(turn.value, turn.ahead(0.1, 0.02))) == pytest.approx(0.02, abs=1e-6)
    assert mul(yaw_quat(0.0), turn.value) == turn.value


def test_a_device_that_is_found_elsewhere_is_not_drawn_beyond_it() -> None:
    """It moves there at the fastest speed that is allowed, and nothing is predicted from its leap."""
    place, turn = PositionFilter(OneEuro(0.0, 0.0), 8.0), RotationFilter(OneEuro(0.0, 0.0), 30.0)
    for i in range(60):
        there = i >= 30
        place.update((1.5 * there, 0.0, 0.0), DT)
        turn.update(yaw_quat(2.0 * there), DT)
        assert 0.0 <= place.ahead(0.036, 0.25)[0] <= 1.5 + 8.0 * DT
        assert rotation_angle(inverse_mul(yaw_quat(1.0), turn.ahead(0.036, 0.6))) <= 1.0 + 30.0 * DT
