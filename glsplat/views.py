"""Views of a scene that nobody chose: where to stand to see all of it, and the cameras there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.splats import Splats

__all__ = ["splats_of", "view_of", "viewing_point"]

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def splats_of(scene: Splats | Avatar) -> Splats:
    """The splats of either kind of scene."""
    return scene.splats if isinstance(scene, Avatar) else scene


def viewing_point(scene: Splats | Avatar, fov: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(eye, target) that shows 98 % of the splats from the front (+z)."""
    splats = splats_of(scene)
    usable = splats.finite()
    if not usable.any():
        return np.array([0.0, 0.0, 1.0]), np.zeros(3)
    low, high = np.percentile(splats.means[usable].astype(np.float64), (1, 99), axis=0)
    centre, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)
    distance = half * 1.25 / np.tan(np.radians(fov) / 2) + float(high[2] - low[2]) / 2
    return centre + np.array([0, 0, distance]), centre


def view_of(
    eye: NDArray[np.float64],  # [3]
    target: NDArray[np.float64],  # [3]
    pixels: tuple[int, int],
    fov: float,
    ipd: float | None = None,  # a stereo pair with this distance between the eyes
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[Camera]:
    """One camera, or the two eyes of a head, looking from ``eye`` to ``target``."""
    viewmat = look_at(eye, target)
    if ipd is None:
        return [Camera(viewmat, pinhole(*pixels, fov), *pixels, background=background)]
    head = np.linalg.inv(OPENGL_FROM_OPENCV @ viewmat)
    return list(stereo_cameras(head, ipd, fov, size=pixels, background=background))
