"""Cameras of a runtime's eyes; place the avatar: in the mirror, facing its user, or as the user's own body.

Twin of the page's net/web/space/placing.js. The renderer draws the avatar in its user's place. ``shown`` transforms
the user's room to the shown room; an eye sees in the shown room what inverse(shown) of it would see in the user's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import isfinite, pi, tan
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera, head_matrix
from glsplat.errors import GlsplatError
from glsplat.extras.openxr.eyes import Surroundings
from glsplat.extras.openxr.runtime import Fov, ViewPose
from glsplat.rotations import FLIP_YZ
from glsplat.tracking.sample import Transform

_EYES = 8  # cached eyes: a frame uses each several times
NEAR = 0.05  # near plane in metres

ViewName = Literal["mirror", "facing", "own"]
VIEWS: tuple[ViewName, ...] = ("mirror", "facing", "own")  # views in the order of the button

MIRROR = {"distance": 1.2, "width": 1.1, "bottom": 0.05, "top": 2.05}
"""Mirror's distance from the user, width and heights, metres."""

FACING = 1.8  # metres from the user to the avatar

FRAME = 0.03  # metres around a mirror's glass
FLOOR = (5.0, 6.0)  # half of its side, and distance from the eye at which it is dark; metres

_X, _Y, _Z = np.eye(3)


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


@dataclass(frozen=True, eq=False)
class Glass:
    """An upright mirror: its foot on the floor, and its level unit normal."""

    foot: F64  # [3]
    normal: F64  # [3]

    @property
    def right(self) -> F64:
        """Unit vector [3] to the right, as seen by its user."""
        return np.array([self.normal[2], 0.0, -self.normal[0]])


@dataclass(frozen=True, eq=False)
class Place:
    """A view, which stays in place until it is chosen again."""

    view: ViewName
    shown: F64  # [4, 4] the user's room to the shown room
    glass: Glass | None = None
    whole: bool = False  # in a room with others: show all that is in sight


def heading(head: F64) -> F64:
    """Return the level unit direction [3] in which a head [4, 4] looks; (0, 0, -1) if that is undefined."""
    back, up = head[:3, 2], head[:3, 1]
    level = np.array([-back[0], 0.0, -back[2]])
    if np.hypot(level[0], level[2]) > 0.1:
        return level / np.linalg.norm(level)
    sign = 1.0 if back[1] > 0 else -1.0  # looking down, the head's up is ahead; looking up, behind
    level = sign * np.array([up[0], 0.0, up[2]])
    if np.hypot(level[0], level[2]) > 0.1:
        return level / np.linalg.norm(level)
    return np.array([0.0, 0.0, -1.0])


def placing(view: ViewName, head: F64, room: bool = False) -> Place:
    """Return a view for a user whose head is at ``head`` (room from head, [4, 4]).

    With others in a ``room`` there are only the mirror and the own body.
    """
    if room:
        return replace(placing("mirror" if view == "mirror" else "own", head), whole=True)
    ahead, ground = heading(head), np.array([head[0, 3], 0.0, head[2, 3]])
    shown = np.eye(4)
    if view == "mirror":
        glass = Glass(ground + MIRROR["distance"] * ahead, -ahead)
        shown[:3, :3] -= 2 * np.outer(glass.normal, glass.normal)
        shown[:3, 3] = 2 * (glass.foot @ glass.normal) * glass.normal
        return Place(view, shown, glass)
    if view == "facing":
        pivot = ground + FACING / 2 * ahead
        shown[0, 0] = shown[2, 2] = -1.0  # half a turn about the vertical through the pivot
        shown[:3, 3] = 2 * pivot[0], 0.0, 2 * pivot[2]
    return Place(view, shown)


def standing(head: F64) -> tuple[float, float, float, float]:
    """Return the pose of a space in which this head is over the origin and looks along +z: x, z, and y and w of its
    quaternion (docs/protocol.md, 2.1)."""
    ahead = heading(head)
    yaw = np.arctan2(ahead[0], ahead[2])
    return float(head[0, 3]), float(head[2, 3]), float(np.sin(yaw / 2)), float(np.cos(yaw / 2))


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
