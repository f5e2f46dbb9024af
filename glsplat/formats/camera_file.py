"""Camera files: one view as JSON, or a list of views of one size (docs/conventions.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.arrays import count, number
from glsplat.camera import Camera
from glsplat.errors import FormatError


def load_cameras(path: str | Path) -> list[Camera]:
    """Return the cameras of a camera file; see read_cameras()."""
    return read_cameras(path)[0]


def read_cameras(path: str | Path) -> tuple[list[Camera], bool]:
    """Read a camera file: one object, or a list of objects of one size (True: it was a list).

    Raises FormatError that names the file, the view and the wrong or missing key.
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
    cameras = [camera_from_json(view, f"{path}: camera {index}") for index, view in enumerate(views)]
    if len({(c.width, c.height) for c in cameras}) > 1:
        raise FormatError(f"{path}: all cameras of a file need the same width and height")
    return cameras, isinstance(data, list)


def camera_from_json(view: Any, where: str) -> Camera:
    """Return the camera of one object of a camera file. Raises FormatError that begins with ``where``."""
    if not isinstance(view, dict):
        raise FormatError(f"{where}: expected an object, found {type(view).__name__}")
    missing = [key for key in ("width", "height", "fx", "fy", "w2c") if key not in view]
    if missing:
        raise FormatError(f"{where}: missing {', '.join(missing)} (needed: width, height, fx, fy, w2c)")
    try:
        width, height = _whole(view["width"], "width"), _whole(view["height"], "height")
        fx, fy = number(view["fx"], "fx"), number(view["fy"], "fy")
        cx, cy = number(view.get("cx", width / 2), "cx"), number(view.get("cy", height / 2), "cy")
        background = [number(v, "bg") for v in _list(view.get("bg", [0, 0, 0]), "bg", 3)]
        rows = [[number(v, "w2c") for v in _list(row, "w2c", 4)] for row in _list(view["w2c"], "w2c", 4)]
        return Camera(
            np.array(rows, np.float64),
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
            width,
            height,
            background=background,
            near=view.get("near", 0.01),
            far=view.get("far", 1e10),
            sh_degree=_whole(view.get("sh_degree", 3), "sh_degree"),
            name=view.get("name", ""),
        )
    except FormatError as error:
        raise FormatError(f"{where}: {error}") from None


def _whole(value: Any, key: str) -> int:
    return count(int(value) if isinstance(value, float) and value.is_integer() else value, key)


def _list(value: Any, key: str, length: int) -> list[Any]:
    if not isinstance(value, list) or len(value) != length:
        wanted = "a 4x4 matrix (four lists of four numbers)" if key == "w2c" else f"{length} numbers"
        raise FormatError(f"{key} needs {wanted}, not {value!r:.40}")
    return value
