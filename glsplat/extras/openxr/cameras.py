"""Convert the eyes of a runtime to cameras: any pose, off-centre frusta, a moved or mirrored room."""

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

_EYES = 8  # cached eyes: a frame uses each several times
NEAR = 0.05
"""Near plane in metres."""


@lru_cache(_EYES)
def intrinsics(fov: Fov, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return K [3, 3] in pixels of a frustum that fills the image (OpenXR 1.1, 8.1, "XrFovf").

    Raises GlsplatError for an empty frustum, as a runtime may report before its device is ready.
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
    """Return the matrix [4, 4] from the pose's frame to the room. Raises FormatError for an invalid pose."""
    return _kept(head_matrix(pose[:3], pose[3:]))


def rigid_inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a rotation or reflection with a translation, [4, 4]."""
    out = np.eye(4)
    out[:3, :3] = matrix[:3, :3].T
    out[:3, 3] = -out[:3, :3] @ matrix[:3, 3]
    return out


def sighted(views: tuple[ViewPose, ViewPose] | None) -> tuple[ViewPose, ViewPose] | None:
    """Return the eyes if they are valid, else None: runtimes report zeros at first, and NaN on errors."""
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
    shown: NDArray[np.float64],  # [4, 4] the user's room to the shown room; a reflection for a mirror
    background: ArrayLike = (0.0, 0.0, 0.0),
) -> Camera:
    """Return an eye's camera for the user's room, which is displaced by ``Place.shown``.

    viewmat = diag(1, -1, -1, 1) inverse(T_W_e) shown (docs/conventions.md); in a mirror its determinant is -1.
    """
    viewmat = FLIP_YZ @ rigid_inverse(matrix_of(view.pose)) @ shown
    return Camera(viewmat, intrinsics(view.fov, size), *size, background=background, near=NEAR)


def _kept(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix, read-only, as the cache shares it."""
    matrix.setflags(write=False)
    return matrix
