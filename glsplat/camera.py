"""Cameras: one view (world-to-camera matrix, intrinsics, size) and the stereo pair of a head pose.

Frames (docs/conventions.md): world right-handed, y up, metres; camera axes of OpenCV (x right, y down, z forward);
head axes of OpenXR (x right, y up, -z forward); pixel (i, j) covers [i, i+1) x [j, j+1).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyrr
from numpy.typing import ArrayLike, NDArray

from glsplat.errors import FormatError

__all__ = [
    "Camera",
    "head_matrix",
    "load_cameras",
    "look_at",
    "passes_of",
    "pinhole",
    "read_cameras",
    "sorting_camera",
    "stereo_cameras",
]

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns the camera by 180 degrees about x: from (x right, y up, -z forward) to (x right, y down, z forward)."""

_LARGEST = 1e12  # of pixels and metres; squares of it still fit into float32

PAPER_IPD = 0.055
PAPER_FOV = 65.0
"""Inter-pupillary distance (m) and vertical field of view (degrees) of the paper's table of system parameters."""


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole view. Matrices are float64 so that the host can compose them without loss."""

    viewmat: NDArray[np.float64]  # [4, 4] world to camera, row-major, OpenCV axes
    K: NDArray[np.float64]  # [3, 3] pixels; fx, fy may differ, cx, cy may be anywhere
    width: int
    height: int
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: float = 0.01  # metres along the optical axis
    far: float = 1e10
    sh_degree: int = 3  # evaluate at most this degree
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        view, k = np.asarray(self.viewmat, np.float64), np.asarray(self.K, np.float64)
        if view.shape != (4, 4) or k.shape != (3, 3):
            raise FormatError(f"a camera needs a 4x4 viewmat and a 3x3 K, not {view.shape} and {k.shape}")
        if not (np.isfinite(view).all() and np.isfinite(k).all()):
            raise FormatError("a camera needs finite numbers in viewmat and K, found NaN or infinity")
        gram = view[:3, :3] @ view[:3, :3].T
        if np.abs(gram - np.eye(3)).max() > 1e-3 or np.abs(view[3] - (0, 0, 0, 1)).max() > 1e-6:
            raise FormatError("viewmat needs a rotation (or reflection) with the last row 0 0 0 1")
        if np.abs(k - np.array([[k[0, 0], 0, k[0, 2]], [0, k[1, 1], k[1, 2]], [0, 0, 1]])).max() > 1e-9:
            raise FormatError("K needs the form fx 0 cx, 0 fy cy, 0 0 1; a skew is not supported")
        if k[0, 0] <= 0 or k[1, 1] <= 0:
            raise FormatError(f"a camera needs fx, fy > 0, not {k[0, 0]:g} and {k[1, 1]:g}")
        if max(np.abs(k).max(), np.abs(view).max()) > _LARGEST:
            raise FormatError(f"a camera needs numbers below {_LARGEST:g} in viewmat and K")
        if len(self.background) != 3 or not (np.abs(self.background) <= _LARGEST).all():
            raise FormatError(f"a background is three finite numbers, not {self.background}")
        if self.sh_degree not in (0, 1, 2, 3):
            raise FormatError(f"sh_degree is 0 to 3, not {self.sh_degree}")
        if self.width < 1 or self.height < 1:
            raise FormatError(f"a camera needs a size of at least 1x1, not {self.width}x{self.height}")
        if not 0 < self.near < self.far:
            raise FormatError(f"a camera needs 0 < near < far, not near {self.near:g} and far {self.far:g}")
        object.__setattr__(self, "viewmat", view)
        object.__setattr__(self, "K", k)

    @property
    def position(self) -> NDArray[np.float64]:
        """[3] the eye in world coordinates."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    def resized(self, width: int, height: int) -> Camera:
        """The same view with another number of pixels (K scales with it)."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def to_json(self) -> dict[str, Any]:
        """The camera-file object of docs/conventions.md."""
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
        }


def pinhole(width: int, height: int, fov: float = PAPER_FOV) -> NDArray[np.float64]:
    """K [3, 3] with square pixels and a centred principal point for a vertical field of view in degrees."""
    if not 0 < fov < 180:
        raise FormatError(f"the field of view needs to lie between 0 and 180 degrees, not {fov:g}")
    f = height / 2 / np.tan(np.radians(fov) / 2)
    return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> NDArray[np.float64]:
    """viewmat [4, 4] of a camera at ``eye`` looking at ``target`` (OpenCV axes).

    Looking straight along ``up`` is legal: another axis takes its place.
    """
    eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
    forward = target - eye
    if not np.linalg.norm(forward) > 0:
        raise FormatError("eye and target are the same point; move one of them")
    if np.linalg.norm(np.cross(forward, up)) < 1e-9 * np.linalg.norm(forward):
        up = np.array([0.0, 0.0, -1.0])
    opengl = pyrr.matrix44.create_look_at(eye, target, up, dtype=np.float64).T  # pyrr stores columns as rows
    return OPENCV_FROM_OPENGL @ np.asarray(opengl)


def head_matrix(position: ArrayLike, quat_xyzw: ArrayLike) -> NDArray[np.float64]:
    """T_W_H [4, 4] from a position (3,) and a quaternion xyzw (4,) of any non-zero length (OpenXR axes)."""
    quat = np.asarray(quat_xyzw, np.float64)
    norm = np.linalg.norm(quat)
    if not (np.isfinite(quat).all() and norm > 1e-9):
        raise FormatError(f"a head pose needs a finite quaternion of non-zero length, not {quat.tolist()}")
    matrix = np.eye(4)
    matrix[:3, :3] = pyrr.matrix33.create_from_quaternion(quat / norm)  # column vectors, unlike its 4x4 ones
    matrix[:3, 3] = np.asarray(position, np.float64)
    return matrix


def stereo_cameras(
    head_pose: ArrayLike,  # [4, 4] T_W_H
    ipd: float = PAPER_IPD,
    fov: float = PAPER_FOV,
    K: ArrayLike | Sequence[ArrayLike] | None = None,  # [3, 3], or one a side [2, 3, 3]
    size: tuple[int, int] = (1024, 1024),
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Camera, Camera]:
    """The left and right eye of a head (paper, equations 1 to 3).

    T_H_e = translate(-+ipd/2, 0, 0) along the head's x axis; T_W_e = T_W_H T_H_e; viewmat = its inverse, turned to
    OpenCV axes. ``K`` overrides ``fov`` (vertical, degrees, square pixels); one K a side gives off-centre frusta.
    """
    head = np.asarray(head_pose, np.float64)
    if head.shape != (4, 4):
        raise FormatError(f"a head pose is a 4x4 matrix, not {head.shape}")
    ks = np.asarray(pinhole(*size, fov) if K is None else K, np.float64)
    if ks.shape not in ((3, 3), (2, 3, 3)):
        raise FormatError(f"K needs shape (3, 3), or (2, 3, 3) for one a side, not {ks.shape}")
    ks = np.broadcast_to(ks, (2, 3, 3))
    eyes = []
    for index, (name, sign) in enumerate((("left", -0.5), ("right", 0.5))):
        world_from_eye = head.copy()
        world_from_eye[:3, 3] += head[:3, 0] * (sign * ipd)
        viewmat = OPENCV_FROM_OPENGL @ np.linalg.inv(world_from_eye)
        eyes.append(Camera(viewmat, ks[index].copy(), *size, background=background, name=name))
    return eyes[0], eyes[1]


def sorting_camera(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """viewmat [4, 4] whose z orders the splats for all ``cameras``: the first one's axes at the eyes' centre."""
    viewmat = cameras[0].viewmat.copy()
    centre = np.mean([c.position for c in cameras], axis=0)
    if len(cameras) > 1:
        viewmat[:3, 3] = -viewmat[:3, :3] @ centre
    return viewmat


def passes_of(cameras: Sequence[Camera], shared: bool = True) -> list[list[int]]:
    """Which views are drawn in one pass, in one order: indices, one or two each.

    A list of two is a pair unless its axes are more than 60 degrees apart; in longer lists neighbours pair up where
    they look the same way. Not ``shared``: every view has an order of its own.
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


def load_cameras(path: str | Path) -> list[Camera]:
    """The cameras of a camera file; see read_cameras()."""
    return read_cameras(path)[0]


def read_cameras(path: str | Path) -> tuple[list[Camera], bool]:
    """Read a camera file: one object, or a list of objects of one size (True: it was a list).

    Raises FormatError with the file, the view and the key that is missing or wrong.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise FormatError(f"{path}: cannot read the camera file ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: a camera file is JSON, but {error}") from None
    views = data if isinstance(data, list) else [data]
    if not views:
        raise FormatError(f"{path}: expected at least one camera, found an empty list")
    cameras = [_from_json(view, f"{path}: camera {index}") for index, view in enumerate(views)]
    if len({(c.width, c.height) for c in cameras}) > 1:
        raise FormatError(f"{path}: all cameras of a file need the same width and height")
    return cameras, isinstance(data, list)


def _from_json(view: Any, where: str) -> Camera:
    if not isinstance(view, dict):
        raise FormatError(f"{where}: expected an object, found {type(view).__name__}")
    missing = [key for key in ("width", "height", "fx", "fy", "w2c") if key not in view]
    if missing:
        raise FormatError(f"{where}: missing {', '.join(missing)} (needed: width, height, fx, fy, w2c)")
    try:
        width, height = _whole(view["width"], "width"), _whole(view["height"], "height")
        fx, fy = _number(view["fx"], "fx"), _number(view["fy"], "fy")
        cx, cy = _number(view.get("cx", width / 2), "cx"), _number(view.get("cy", height / 2), "cy")
        red, green, blue = (_number(v, "bg") for v in _list(view.get("bg", [0, 0, 0]), "bg", 3))
        rows = [[_number(v, "w2c") for v in _list(row, "w2c", 4)] for row in _list(view["w2c"], "w2c", 4)]
        return Camera(
            np.array(rows, np.float64),
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
            width,
            height,
            background=(red, green, blue),
            near=_number(view.get("near", 0.01), "near"),
            far=_number(view.get("far", 1e10), "far"),
            sh_degree=_whole(view.get("sh_degree", 3), "sh_degree"),
        )
    except FormatError as error:
        raise FormatError(f"{where}: {error}") from None


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300 or value != value:
        raise FormatError(f"{key} needs a finite number, not {value!r:.40}")
    return float(value)


def _whole(value: Any, key: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != int(_number(value, key)):
        raise FormatError(f"{key} needs a whole number, not {value!r:.40}")
    return int(value)


def _list(value: Any, key: str, length: int) -> list[Any]:
    if not isinstance(value, list) or len(value) != length:
        wanted = "a 4x4 matrix (four lists of four numbers)" if key == "w2c" else f"{length} numbers"
        raise FormatError(f"{key} needs {wanted}, not {value!r:.40}")
    return value
