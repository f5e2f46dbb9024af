"""Eyes of a runtime to cameras: any pose, off-centre frusta, the room as it is shown (mirror, facing)."""

from __future__ import annotations

from functools import lru_cache
from math import isfinite, pi, tan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.camera import Camera, head_matrix
from glsplat.errors import GlsplatError
from glsplat.extras.openxr.runtime import Fov, ViewPose
from glsplat.rotations import FLIP_YZ
from glsplat.tracking.sample import Transform

_EYES = 8  # that are remembered: a frame asks for each of its eyes several times, and every microsecond makes it late
NEAR = 0.05
"""Metres; what is nearer to an eye than this cannot be looked at."""


@lru_cache(_EYES)
def intrinsics(fov: Fov, size: tuple[int, int]) -> NDArray[np.float64]:
    """K [3, 3] in pixels of the frustum whose sides are the image's sides (OpenXR 1.1, 8.1, "XrFovf").

    Raises GlsplatError for angles that span nothing, as a runtime may give them before it knows its device.
    """
    width, height = size
    angles = (fov.left, fov.right, fov.up, fov.down)
    if not (all(isfinite(angle) and abs(angle) < pi / 2 for angle in angles)):
        raise GlsplatError(f"a field of view needs angles within 90 degrees, not {angles}")
    left, right, up, down = map(tan, angles)
    if not (right - left > 1e-6 and up - down > 1e-6):
        raise GlsplatError(f"a field of view needs left < right and down < up, not {angles} (left, right, up, down)")
    fx, fy = width / (right - left), height / (up - down)
    return _kept(np.array([[fx, 0, -left * fx], [0, fy, up * fy], [0, 0, 1.0]]))


@lru_cache(_EYES)
def matrix_of(pose: Transform) -> NDArray[np.float64]:
    """[4, 4] room from what has this pose. Raises FormatError for what is no pose."""
    return _kept(head_matrix(pose[:3], pose[3:]))


def rigid_inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a rotation or reflection with a translation."""
    out = np.eye(4)
    out[:3, :3] = matrix[:3, :3].T
    out[:3, 3] = -out[:3, :3] @ matrix[:3, 3]
    return out


def sighted(views: tuple[ViewPose, ViewPose] | None) -> tuple[ViewPose, ViewPose] | None:
    """The eyes if they can be drawn for: runtimes tell zeros before they know their device, and NaN when they err."""
    try:
        for view in views or ():
            intrinsics(view.fov, (1, 1))
            matrix_of(view.pose)
    except GlsplatError:
        return None
    return views


def camera_of(
    view: ViewPose,
    size: tuple[int, int],
    shown: NDArray[np.float64],  # [4, 4] the user's room to the room as it is shown; of a mirror a reflection
    background: ArrayLike = (0.0, 0.0, 0.0),
) -> Camera:
    """What an eye sees of the user's own room while that is shown elsewhere (``Place.shown``).

    viewmat = diag(1, -1, -1, 1) inverse(T_W_e) shown (docs/conventions.md); in a mirror its determinant is -1.
    """
    viewmat = FLIP_YZ @ rigid_inverse(matrix_of(view.pose)) @ shown
    return Camera(viewmat, intrinsics(view.fov, size), *size, background=background, near=NEAR)


def _kept(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Several share it."""
    matrix.setflags(write=False)
    return matrix
