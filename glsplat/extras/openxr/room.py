"""Mirror and floor around the avatar for eyes.frag.glsl, seen by each eye."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.openxr.cameras import intrinsics, matrix_of
from glsplat.extras.openxr.eyes import Surroundings
from glsplat.extras.openxr.placing import MIRROR, Place
from glsplat.extras.openxr.runtime import ViewPose

FRAME = 0.03  # metres around a mirror's glass
FLOOR = (5.0, 6.0)  # half of its side, and distance from the eye at which it is dark; metres

_X, _Y, _Z = np.eye(3)


def plane_from_pixel(eye: F64, K: F64, origin: F64, right: F64, up: F64, normal: F64) -> F64:
    """Return [3, 3] from pixel (x, y, 1) to w (a, b, 1): a plane's point origin + a right + b up; w > 0 if ahead.

    ``eye`` [4, 4] room from eye (OpenXR's axes); ``origin`` [3]; ``right``, ``up``, ``normal`` [3] unit vectors.
    """
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    back = np.array([[1 / fx, 0, -cx / fx], [0, -1 / fy, cy / fy], [0, 0, -1.0]])  # pixel to a direction of the eye's
    rays, away = eye[:3, :3] @ back, origin - eye[:3, 3]
    height = float(normal @ away)  # along the normal; the ray meets the plane at height / (normal . ray)
    rows = [height * along - float(along @ away) * normal for along in (right, up)]
    sign = 1.0 if height >= 0 else -1.0
    return sign * np.stack([*rows, normal]) @ rays


def surroundings(
    views: Sequence[ViewPose], size: tuple[int, int], place: Place, floor: bool = True
) -> Surroundings | None:
    """Return the mirror of ``place`` and a floor at y = 0; None without either."""
    if place.glass is None and not floor:
        return None
    eyes = [matrix_of(view.pose) for view in views]
    ks = [intrinsics(view.fov, size) for view in views]
    floors = [plane_from_pixel(eye, K, np.zeros(3), _X, _Z, _Y) for eye, K in zip(eyes, ks, strict=True)]
    shape = (0.0, 0.0, 0.0, FRAME)
    mirrors = floors
    if place.glass is not None:
        glass = place.glass
        shape = (MIRROR["width"] / 2, MIRROR["bottom"], MIRROR["top"], FRAME)
        mirrors = [
            plane_from_pixel(eye, K, glass.foot, glass.right, _Y, glass.normal) for eye, K in zip(eyes, ks, strict=True)
        ]
    over = np.array([[eye[0, 3], eye[2, 3]] for eye in eyes])
    return Surroundings(np.stack(mirrors), np.stack(floors), shape, (*FLOOR, float(floor)), over)
