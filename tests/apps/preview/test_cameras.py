"""Orbit and flight without a window: the view's geometry and the cameras of each layout."""

from __future__ import annotations

import numpy as np
import pytest

from apps.preview.cameras import View, cameras_of
from glsplat.camera import Camera
from glsplat.errors import FormatError
from glsplat.views import view_of

SIZE = (320, 200)
BLACK = (0.0, 0.0, 0.0)


def pixel(camera: Camera, point: np.ndarray) -> np.ndarray:
    p = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
    return p[:2] / p[2]


def test_view_is_what_render_looks_at() -> None:
    eye = (-3, 0.2, -1)
    target = np.array([0.1, 0.9, -0.2])
    view = View.between(eye, target)
    assert np.allclose(view.eye, eye, atol=1e-12)
    assert np.allclose(view.axes.T @ view.axes, np.eye(3)) and np.linalg.det(view.axes) > 0
    for layout, ipd in (("mono", None), ("side-by-side", 0.06)):
        ours = cameras_of(view, layout, SIZE, 50, 0.06, BLACK)  # type: ignore[arg-type]
        pixels = (SIZE[0] // (1 if ipd is None else 2), SIZE[1])
        theirs = view_of(np.array(eye, float), target, pixels, 50, ipd)
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs, strict=True):
            assert (a.width, a.height) == (b.width, b.height)
            assert np.allclose(a.viewmat, b.viewmat, atol=1e-12) and np.allclose(a.K, b.K)


def test_orbit_keeps_target_and_distance_and_stops_overhead() -> None:
    view = View(np.array([1.0, 2, 3]), 2.5, 0.4, 0.3)
    quarter = View(view.target, 2.5).orbited(np.pi / 2, 0)
    assert np.allclose(quarter.eye, view.target + (2.5, 0, 0))  # to the right: +x, an avatar's left hand
    for right, up in ((0.7, 0.2), (-9, 4), (100, -50)):
        turned = view.orbited(right, up)
        assert np.array_equal(turned.target, view.target)
        assert np.linalg.norm(turned.eye - view.target) == pytest.approx(2.5)
        assert 0 <= turned.yaw < 2 * np.pi and turned.axes[1, 1] > -1e-12  # never upside down
    above = view.orbited(0, 10)
    assert np.allclose(above.eye, view.target + (0, 2.5, 0)) and np.isfinite(above.head).all()
    assert np.allclose(above.orbited(0, -1).axes, view.orbited(0, np.pi / 2 - 1 - view.pitch).axes)


def test_zoom_and_windows_stay_within_bounds() -> None:
    view = View(np.zeros(3), 2.0)
    assert view.zoomed(0.5).distance == 1
    assert view.zoomed(1e-30, 0.1, 10).distance == 0.1 and view.zoomed(1e30, 0.1, 10).distance == 10
    cameras = cameras_of(view, "side-by-side", (1, 1), 65, 0.06, BLACK)
    assert all(camera.width >= 1 and camera.height == 1 for camera in cameras)
    with pytest.raises(FormatError, match="the same point"):
        View.between((1, 2, 3), (1, 2, 3))


def test_look_and_flight() -> None:
    view = View(np.zeros(3), 3.0, 0.5, 0.2)
    looked = view.looked(0.3, 0.1)
    assert np.allclose(looked.eye, view.eye) and looked.distance == view.distance
    ahead = -looked.axes[:, 2]
    assert ahead @ view.axes[:, 0] > 0.2 and ahead @ view.axes[:, 1] > 0.05  # to the right and up
    moved = view.moved(1, 2, 3)
    x, y, z = view.axes.T
    assert np.allclose(moved.eye - view.eye, x + 2 * y - 3 * z)
    assert np.allclose(moved.target - view.target, moved.eye - view.eye)


def test_anaglyph_has_the_target_in_the_plane_of_the_screen() -> None:
    view = View.between((0.5, 1.2, 2), (0, 1, 0))
    left, right = cameras_of(view, "anaglyph", SIZE, 60, 0.1, BLACK)
    assert np.allclose(pixel(left, view.target), pixel(right, view.target))
    assert np.allclose(pixel(left, view.target), (160, 100))
    near, far = view.target + 0.5 * view.axes[:, 2], view.target - 0.5 * view.axes[:, 2]
    assert pixel(left, near)[0] > pixel(right, near)[0] + 1 and pixel(left, far)[0] < pixel(right, far)[0] - 1
    parallel = cameras_of(view, "side-by-side", SIZE, 60, 0.1, BLACK)
    assert all(camera.K[0, 2] == 80 for camera in parallel)
