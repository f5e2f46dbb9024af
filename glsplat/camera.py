"""Cameras: a pinhole view (world-to-camera matrix, intrinsics, size) and the stereo pair of a head pose.

Frames (docs/conventions.md): world right-handed, y up, metres; camera axes of OpenCV (x right, y down, z forward);
head axes of OpenXR (x right, y up, -z forward); pixel (i, j) covers [i, i+1) x [j, j+1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf, isfinite
from typing import Any, SupportsFloat, SupportsIndex

import numpy as np
import pyrr
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import Value, bits, colour, count, frozen, number, own, pixels, plain
from glsplat.errors import FormatError
from glsplat.rotations import FLIP_YZ

__all__ = [
    "ORTHONORMAL",
    "Camera",
    "head_matrix",
    "look_at",
    "passes_of",
    "pinhole",
    "sorting_camera",
    "stereo_cameras",
]

_NO_ROTATION = "viewmat needs a rotation (or reflection) with the last row 0 0 0 1"
ORTHONORMAL = 2e-5
"""Largest entry of R R^T - I of a viewmat: its numbers may be rounded to five digits, a centimetre at 1000 m."""

_MAX_VALUE = 1e12  # pixels or metres; its square fits into float32
_MIN_DISTANCE = 1e-12  # metres, or of the eye's distance from the origin; below, float64 has no direction
_MAX_IPD_M = 2.0  # a larger distance between the eyes was given in millimetres

PAPER_IPD = 0.055
PAPER_FOV = 65.0
"""Inter-pupillary distance (m) and vertical field of view (degrees) of the paper's table of system parameters."""


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Camera(Value):
    """A pinhole view: pose, intrinsics and size in pixels.

    Accepts anything that numpy reads as numbers, validates it and keeps read-only copies. Matrices are float64, so that
    composing them loses no precision. ``dataclasses.replace(camera, ...)`` returns a changed copy. Raises FormatError.

    >>> view = glsplat.look_at(eye=(0, 1.2, 2.5), target=(0, 1, 0))
    >>> glsplat.Camera(view, glsplat.pinhole(640, 480, fov=40), 640, 480, background=[1, 1, 1])
    Camera(640x480, at (0, 1.2, 2.5), 40 degrees high)
    """

    viewmat: NDArray[np.float64]  # [4, 4] world to camera, row-major, OpenCV axes
    K: NDArray[np.float64]  # [3, 3] pixels; fx, fy may differ, cx, cy may be anywhere
    width: int
    height: int
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: float = 0.01  # metres along the optical axis
    far: float = 1e10
    sh_degree: int = 3  # evaluate at most this degree
    name: str = field(default="", compare=False)
    layers: int = 1  # bit mask; items that share no bit with it are not drawn (Item.layers)

    def __init__(
        self,
        viewmat: ArrayLike,  # [4, 4]
        K: ArrayLike,  # [3, 3]
        width: SupportsIndex,
        height: SupportsIndex,
        background: ArrayLike = (0.0, 0.0, 0.0),  # [3] red, green, blue; 1 is full
        near: SupportsFloat = 0.01,
        far: SupportsFloat = 1e10,
        sh_degree: SupportsIndex = 3,
        name: str = "",
        layers: SupportsIndex = 1,
    ) -> None:
        view, k = own(viewmat, np.float64, "viewmat"), own(K, np.float64, "K")
        if view.shape != (4, 4) or k.shape != (3, 3):
            raise FormatError(f"a camera needs a 4x4 viewmat and a 3x3 K, not {view.shape} and {k.shape}")
        _check_matrices(view.tolist(), k.tolist())
        size = count(width, "width"), count(height, "height")
        if min(size) < 1:
            raise FormatError(f"a camera needs a size of at least 1x1, not {size[0]}x{size[1]}")
        behind = colour(background, "a background")
        depths = number(near, "near"), number(far, "far")
        if not 0 < depths[0] < depths[1]:
            raise FormatError(f"a camera needs 0 < near < far, not near {depths[0]:g} and far {depths[1]:g}")
        degree = count(sh_degree, "sh_degree")
        if degree not in (0, 1, 2, 3):
            raise FormatError(f"sh_degree is 0 to 3, not {degree}")
        if not isinstance(name, str):
            raise FormatError(f"a camera's name is text, not {type(name).__name__}")
        self._keep(viewmat=view, K=k, width=size[0], height=size[1], background=behind, near=depths[0], far=depths[1])
        self._keep(sh_degree=degree, name=name, layers=bits(layers, "layers"))

    def __repr__(self) -> str:
        x, y, z = self.position
        fov = np.degrees(2 * np.arctan(self.height / 2 / self.K[1, 1]))
        named = f"{self.name}, " if self.name else ""
        return f"Camera({named}{self.width}x{self.height}, at ({x:.4g}, {y:.4g}, {z:.4g}), {fov:.4g} degrees high)"

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the eye [3] in world coordinates."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    def resized(self, width: int, height: int) -> Camera:
        """Return the same view with another size in pixels; K is scaled."""
        width, height = count(width, "width"), count(height, "height")
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def in_space(self, transform: NDArray[np.float64]) -> Camera:
        """Return the same view in a space that ``transform`` [4, 4] maps to this one (``scene.similarity``).

        Positions, ``near`` and ``far`` are divided by the scale of ``transform``.
        """
        size = float(np.cbrt(np.linalg.det(transform[:3, :3])))
        viewmat = self.viewmat.copy()
        viewmat[:3, :3] = viewmat[:3, :3] @ (transform[:3, :3] / size)
        viewmat[:3, 3] = -self.viewmat[:3, :3] @ ((self.position - transform[:3, 3]) / size)
        return replace(self, viewmat=viewmat, near=self.near / size, far=self.far / size)

    def to_json(self) -> dict[str, Any]:
        """Return the object of a camera file (docs/conventions.md), which has no layers."""
        return {
            "width": self.width,
            "height": self.height,
            "fx": self.K[0, 0],
            "fy": self.K[1, 1],
            "cx": self.K[0, 2],
            "cy": self.K[1, 2],
            "w2c": self.viewmat.tolist(),
            "bg": list(self.background),
            "sh_degree": self.sh_degree,
            "near": self.near,
            "far": self.far,
        } | ({"name": self.name} if self.name else {})


def pinhole(width: SupportsIndex, height: SupportsIndex, fov: SupportsFloat = PAPER_FOV) -> NDArray[np.float64]:
    """Return K [3, 3] with square pixels and a centred principal point for a vertical field of view in degrees.

    >>> glsplat.pinhole(640, 480, fov=90).round(9).tolist()
    [[240.0, 0.0, 320.0], [0.0, 240.0, 240.0], [0.0, 0.0, 1.0]]
    """
    size = count(width, "width"), count(height, "height")
    if min(size) < 1:
        raise FormatError(f"pinhole needs a size of at least 1x1, not {size[0]}x{size[1]}")
    angle = number(fov, "the field of view")
    if not 0 < angle < 180:
        raise FormatError(f"the field of view needs to lie between 0 and 180 degrees, not {angle:g}")
    f = size[1] / 2 / np.tan(np.radians(angle) / 2)
    return np.array([[f, 0, size[0] / 2], [0, f, size[1] / 2], [0, 0, 1.0]])


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> NDArray[np.float64]:
    """Return the viewmat [4, 4] of a camera at ``eye`` that looks at ``target`` (OpenCV axes); [3], metres, world.

    If the view is parallel to ``up``, another axis replaces it.

    >>> view = glsplat.look_at(eye=(0, 0, 3), target=(0, 0, 0))
    >>> (view @ [0, 0, 0, 1])[:3].tolist()  # the target lies 3 m ahead
    [0.0, 0.0, 3.0]
    """
    start, end, above = _vector(eye, "eye"), _vector(target, "target"), _vector(up, "up")
    if max(np.abs(start).max(), np.abs(end).max()) > _MAX_VALUE:
        raise FormatError(f"eye and target need metres below {_MAX_VALUE:g}")
    forward, most = end - start, float(np.abs(above).max())
    if not np.linalg.norm(forward) > _MIN_DISTANCE * max(1.0, float(np.abs(start).max())):
        raise FormatError("eye and target are the same point; move one of them")
    if not most > 0:
        raise FormatError("up needs a direction, not zero")
    if not 1e-6 < most < 1e6:  # avoids overflow and underflow of squares
        above = above / most
    others = (above, np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    above = next(one for one in others if _apart(forward, one))
    opengl = pyrr.matrix44.create_look_at(start, end, above, dtype=np.float64).T  # pyrr stores columns as rows
    return FLIP_YZ @ np.asarray(opengl)


def _apart(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether two vectors are not parallel."""
    return bool(np.linalg.norm(np.cross(one, other)) >= 1e-9 * np.linalg.norm(one) * np.linalg.norm(other))


def head_matrix(position: ArrayLike, quat_xyzw: ArrayLike) -> NDArray[np.float64]:
    """Return T_W_H [4, 4] of a position (3,) and a quaternion xyzw (4,) of any non-zero length (OpenXR axes)."""
    quat = plain(quat_xyzw, "a quaternion").astype(np.float64)
    norm = float(np.linalg.norm(quat))
    if quat.shape != (4,) or not 1e-9 < norm < inf:
        raise FormatError(f"a head pose needs a finite quaternion of non-zero length, not {quat.tolist()!r:.60}")
    px, py, pz = _vector(position, "a head's position").tolist()
    x, y, z, w = (value / norm for value in quat.tolist())  # plain floats: a matrix is made for every request
    xx, yy, zz, ww = x**2, y**2, z**2, w**2
    scale = 1 / (xx + yy + zz + ww)
    return np.array(
        [
            [(xx - yy - zz + ww) * scale, 2 * (x * y - z * w) * scale, 2 * (x * z + y * w) * scale, px],
            [2 * (x * y + z * w) * scale, (-xx + yy - zz + ww) * scale, 2 * (y * z - x * w) * scale, py],
            [2 * (x * z - y * w) * scale, 2 * (y * z + x * w) * scale, (-xx - yy + zz + ww) * scale, pz],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def stereo_cameras(
    head_pose: ArrayLike,  # [4, 4] T_W_H
    ipd: SupportsFloat = PAPER_IPD,
    fov: SupportsFloat = PAPER_FOV,
    K: ArrayLike | Sequence[ArrayLike] | None = None,  # [3, 3], or one a side [2, 3, 3]
    size: tuple[SupportsIndex, SupportsIndex] = (1024, 1024),
    background: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Camera, Camera]:
    """Return the left and right eye of a head (paper, equations 1 to 3).

    T_H_e = translate(-+ipd/2, 0, 0) along the head's x axis; T_W_e = T_W_H T_H_e; viewmat = its inverse, turned to
    OpenCV axes. ``K`` overrides ``fov`` (vertical, degrees, square pixels); one K a side gives off-centre frusta.

    >>> head = np.eye(4)
    >>> head[:3, 3] = 0, 1.6, 2
    >>> glsplat.stereo_cameras(head, ipd=0.064, size=(1024, 1024))[0]
    Camera(left, 1024x1024, at (-0.032, 1.6, 2), 65 degrees high)
    """
    head = plain(head_pose, "a head pose").astype(np.float64)
    if head.shape != (4, 4):
        raise FormatError(f"a head pose is a 4x4 matrix, not {head.shape}")
    width, height = pixels(size)
    if K is None:
        ks = _pinhole(width, height, number(fov, "the field of view"))
    else:
        ks = own(K, np.float64, "K")  # type: ignore[arg-type]
    if ks.shape not in ((3, 3), (2, 3, 3)):
        raise FormatError(f"K needs shape (3, 3), or (2, 3, 3) for one a side, not {ks.shape}")
    half = 0.5 * number(ipd, "ipd")
    if not 0 <= 2 * half <= _MAX_IPD_M:
        raise FormatError(f"ipd needs metres from 0 to {_MAX_IPD_M:g}, not {2 * half:g}; 63 mm are 0.063")
    world_from_eyes = np.stack([head, head])
    world_from_eyes[0, :3, 3] -= head[:3, 0] * half
    world_from_eyes[1, :3, 3] += head[:3, 0] * half
    try:
        left, right = FLIP_YZ @ np.linalg.inv(world_from_eyes)
    except np.linalg.LinAlgError:
        raise FormatError("a head pose needs a rotation and a place; this matrix has no inverse") from None
    left_k, right_k = (ks, ks) if ks.ndim == 2 else ks
    return (
        Camera(left, left_k, width, height, background=background, name="left"),
        Camera(right, right_k, width, height, background=background, name="right"),
    )


@lru_cache(maxsize=16)
def _pinhole(width: int, height: int, fov: float) -> NDArray[np.float64]:
    """Return ``pinhole()``, shared and read-only: the eyes of a stream have the same."""
    return frozen(pinhole(width, height, fov))


def sorting_camera(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """Return the viewmat [4, 4] whose z orders the splats of all ``cameras``: axes of the first, mean position."""
    viewmat = cameras[0].viewmat.copy()
    centre = np.mean([c.position for c in cameras], axis=0)
    if len(cameras) > 1:
        viewmat[:3, 3] = -viewmat[:3, :3] @ centre
    return viewmat


def passes_of(cameras: Sequence[Camera], shared: bool = True) -> list[list[int]]:
    """Return the view indices of each pass: one or two views that share a depth order.

    Two views form a pair unless their axes are more than 60 degrees apart. In longer lists, neighbours with parallel
    axes form pairs. With ``shared`` False every view has its own order.
    """
    closest = 0.5 if len(cameras) == 2 else 1 - 1e-6
    passes: list[list[int]] = []
    for index, camera in enumerate(cameras):
        partner = cameras[passes[-1][0]] if shared and passes and len(passes[-1]) == 1 else None
        if (
            partner is not None
            and partner.sh_degree == camera.sh_degree
            and float(partner.viewmat[2, :3] @ camera.viewmat[2, :3]) > closest
        ):
            passes[-1].append(index)
        else:
            passes.append([index])
    return passes


def _check_matrices(view: list[list[float]], k: list[list[float]]) -> None:
    """Raise FormatError for an invalid viewmat or K. Uses plain floats for speed: a pair is made for every frame."""
    values = (*view[0], *view[1], *view[2], *view[3], *k[0], *k[1], *k[2])
    if not all(map(isfinite, values)):
        raise FormatError("a camera needs finite numbers in viewmat and K, found NaN or infinity")
    if max(map(abs, values)) > _MAX_VALUE:
        raise FormatError(f"a camera needs numbers below {_MAX_VALUE:g} in viewmat and K")
    for i in range(3):
        for j in range(i, 3):
            a, b = view[i], view[j]
            off = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] - (i == j))
            if off > ORTHONORMAL:
                raise FormatError(f"{_NO_ROTATION}; R R^T is off by {off:.2g}, more than rounding is")
    x, y, z, w = view[3]
    if max(abs(x), abs(y), abs(z), abs(w - 1)) > 1e-6:
        raise FormatError(_NO_ROTATION)
    (fx, skew, _), (zero, fy, _), (left, low, one) = k
    if max(abs(skew), abs(zero), abs(left), abs(low), abs(one - 1)) > 1e-9:
        raise FormatError("K needs the form fx 0 cx, 0 fy cy, 0 0 1; a skew is not supported")
    if fx <= 0 or fy <= 0:
        raise FormatError(f"a camera needs fx, fy > 0, not {fx:g} and {fy:g}")


def _vector(value: ArrayLike, what: str) -> NDArray[np.float64]:
    vector = plain(value, what).astype(np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise FormatError(f"{what} needs 3 finite numbers, not {value!r:.60}")
    return vector
