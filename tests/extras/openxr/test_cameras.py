"""Eyes to cameras: frusta, poses, and where the avatar is shown."""

from __future__ import annotations

from math import cos, inf, nan, pi, sin, tan

import numpy as np
import pytest

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.extras.openxr.placing import (
    camera_of,
    heading,
    intrinsics,
    matrix_of,
    placing,
    plane_from_pixel,
    surroundings,
)
from glsplat.extras.openxr.runtime import Fov, ViewPose


def random_pose(rng: np.random.Generator) -> tuple[float, ...]:
    return (*rng.normal(size=3).tolist(), *rng.normal(size=4).tolist())


def random_fov(rng: np.random.Generator) -> Fov:
    left, down = -rng.uniform(0.2, 1.2, 2)
    right, up = rng.uniform(-0.1, 1.2, 2)  # also frusta that do not hold the line of sight
    return Fov(left, right, up, down)


def pixel(camera: Camera, point: np.ndarray) -> np.ndarray:
    x, y, z = (camera.viewmat @ [*point, 1.0])[:3]
    assert z > 0
    return (camera.K @ [x / z, y / z, 1.0])[:2]


def test_the_sides_of_the_frustum_are_those_of_the_picture(rng: np.random.Generator) -> None:
    for _ in range(50):
        pose, fov, size = random_pose(rng), random_fov(rng), (int(rng.integers(1, 900)), int(rng.integers(1, 900)))
        camera = camera_of(ViewPose(pose, fov), size, np.eye(4))  # type: ignore[arg-type]
        eye = matrix_of(pose)  # type: ignore[arg-type]
        for x, column in ((fov.left, 0), (fov.right, size[0])):
            for y, row in ((fov.up, 0), (fov.down, size[1])):  # rows count from the top
                point = eye @ [2 * tan(x), 2 * tan(y), -2.0, 1.0]
                assert np.allclose(pixel(camera, point[:3]), (column, row), atol=1e-6 * max(size))
        assert np.allclose(camera.position, pose[:3])


def test_angles_that_span_nothing_and_a_pose_that_is_none_are_refused() -> None:
    for fov in (Fov(0, 0, 0, 0), Fov(0.3, -0.3, 0.3, -0.3), Fov(nan, 1, 1, -1), Fov(-1, inf, 1, -1)):
        with pytest.raises(GlsplatError, match="field of view"):
            intrinsics(fov, (10, 10))
    with pytest.raises(GlsplatError, match="within 90 degrees"):
        intrinsics(Fov(-pi / 2, 0.1, 0.1, -0.1), (10, 10))
    with pytest.raises(GlsplatError, match="quaternion"):
        camera_of(ViewPose((0, 0, 0, 0, 0, 0, 0), Fov(-1, 1, 1, -1)), (8, 8), np.eye(4))


def test_a_mirror_shows_what_an_eye_behind_the_glass_would_see(rng: np.random.Generator) -> None:
    head = matrix_of((0.3, 1.7, -0.4, 0.1, 0.5, 0.0, 0.8))
    view = ViewPose((0.3, 1.7, -0.4, 0.1, 0.5, 0.0, 0.8), Fov(-1.0, 0.8, 0.9, -1.1))
    place = placing("mirror", head)
    assert place.glass is not None
    camera = camera_of(view, (200, 160), place.shown)
    assert np.linalg.det(camera.viewmat[:3, :3]) == pytest.approx(-1)
    glass = place.glass
    assert glass.normal[1] == 0 and glass.normal @ (head[:3, 3] - glass.foot) == pytest.approx(1.2)
    direct = camera_of(view, (200, 160), np.eye(4))
    seen = 0
    for point in head[:3, 3] + rng.normal(size=(30, 3)) * 0.3:
        image = point - 2 * (glass.normal @ (point - glass.foot)) * glass.normal  # behind the glass
        if (direct.viewmat @ [*image, 1.0])[2] > 0.1:
            assert np.allclose(pixel(camera, point), pixel(direct, image))
            seen += 1
    assert seen > 10
    on = glass.foot + [0, 1.2, 0] + 0.2 * glass.right
    assert np.allclose(pixel(camera, on), pixel(direct, on))  # what is on the glass is where it is


def test_facing_is_a_half_turn_and_own_nothing() -> None:
    head = matrix_of((1.0, 1.6, 2.0, 0.0, sin(0.4), 0.0, cos(0.4)))
    facing, own = placing("facing", head), placing("own", head)
    feet = np.array([1.0, 0.0, 2.0, 1.0])
    there = (facing.shown @ feet)[:3]
    assert np.allclose(there - feet[:3], 1.8 * heading(head)) and np.linalg.det(facing.shown) == pytest.approx(1)
    assert np.array_equal(own.shown, np.eye(4))
    assert placing("facing", head, room=True).view == "own" and placing("mirror", head, room=True).whole


def test_planes_are_met_where_rays_meet_them(rng: np.random.Generator) -> None:
    view = ViewPose((0.2, 1.5, 0.3, 0.1, 0.2, 0.0, 0.9), Fov(-0.8, 0.9, 0.7, -0.9))
    camera, eye, K = camera_of(view, (64, 48), np.eye(4)), matrix_of(view.pose), intrinsics(view.fov, (64, 48))
    x, y, z = np.eye(3)
    ahead = 0
    for normal, right, up, origin in ((y, x, z, np.zeros(3)), (z, x, y, np.array([0.3, 0.2, -1.0])), (-z, -x, y, x)):
        matrix = plane_from_pixel(eye, K, origin, right, up, normal)
        for a, b in rng.normal(size=(20, 2)):
            point = origin + a * right + b * up
            depth = (camera.viewmat @ [*point, 1.0])[2]
            if abs(depth) < 1e-3:
                continue
            at = (camera.K @ (camera.viewmat @ [*point, 1.0])[:3] / depth)[:2]
            found = matrix @ [*at, 1.0]
            assert np.allclose(found[:2] / found[2], (a, b)) and (found[2] > 0) == (depth > 0)
            ahead += depth > 0
    assert ahead > 10
    nothing, glass = placing("facing", np.eye(4)), placing("mirror", np.eye(4))
    assert surroundings([view] * 2, (8, 8), nothing, floor=False) is None
    assert surroundings([view] * 2, (8, 8), glass, floor=False) is not None
