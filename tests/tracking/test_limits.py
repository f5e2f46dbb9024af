from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glsplat.tracking.solve.body import ANKLES, ELBOWS, HIPS, KNEES, SHOULDERS, WRISTS
from glsplat.tracking.solve.limits import clamp_joint, violation
from glsplat.tracking.solve.quat import mul, rotate, to_quat

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
