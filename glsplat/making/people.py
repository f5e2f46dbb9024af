"""People: the reader of the person archives (.npz), and of their textures."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton

__all__ = ["decode_texture", "read_person"]

_NEEDED = ("vertices", "joints", "parents", "joint_names", "skin_indices", "skin_weights", "part_names")


def decode_texture(data: bytes | NDArray[np.uint8], where: str) -> NDArray[np.uint8]:
    """RGBA uint8 [H, W, 4] of a JPEG or PNG; FormatError naming ``where`` if it is neither."""
    buffer = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else data
    image = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED) if buffer.size else None
    if image is None:
        raise FormatError(f"{where}: a texture is a JPEG or PNG, found {bytes(buffer[:4])!r}")
    if image.dtype != np.uint8:
        image = (image / 257).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGBA if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def read_person(path: str | Path) -> RiggedMesh:
    """Read a person archive: an .npz of a rigged mesh with textured parts.

    Keys: vertices (V, 3) metres, joints (J, 3) rest positions with frames parallel to the world, parents (J,),
    joint_names (J,), skin_indices and skin_weights (V, K), part_names (P,), and for part i: faces_i, faces_uv_i (F, 3),
    uv_i (T, 2) with v up, texture_i (bytes of a JPEG or PNG). Raises FormatError naming the file and the key.
    """
    try:
        with open(path, "rb") as file:
            if file.read(2) != b"PK":
                raise FormatError(f"{path}: a person is an .npz archive, but this is none")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                data = {key: np.asarray(archive[key]) for key in archive.files}
    except OSError as error:
        raise FormatError(f"{path}: cannot read the person ({error.strerror or error})") from None
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{path}: a person is an .npz archive, but {error}") from None
    count = len(data.get("part_names", ()))
    needed = [*_NEEDED, *(f"{key}_{i}" for i in range(count) for key in ("faces", "faces_uv", "uv", "texture"))]
    missing = [key for key in needed if key not in data]
    if missing:
        raise FormatError(f"{path}: a person needs the key {missing[0]}; found {', '.join(list(data)[:8])}")
    try:
        skeleton = Skeleton.from_joints(tuple(map(str, data["joint_names"])), data["parents"], data["joints"])
        parts = tuple(_part(data, i, str(name), str(path)) for i, name in enumerate(data["part_names"]))
        meta = {"source": Path(path).name}
        indices, weights = data["skin_indices"].astype(np.int64), data["skin_weights"].astype(np.float64)
        return RiggedMesh(data["vertices"].astype(np.float64), skeleton, indices, weights, parts, meta)
    except (FormatError, PoseError) as error:
        message = str(error)
        raise FormatError(message if message.startswith(str(path)) else f"{path}: {message}") from None
    except (TypeError, ValueError) as error:
        raise FormatError(f"{path}: {error}") from None


def _part(data: Mapping[str, NDArray[Any]], i: int, name: str, path: str) -> MeshPart:
    faces, faces_uv, uv = data[f"faces_{i}"], data[f"faces_uv_{i}"], data[f"uv_{i}"]
    if faces.ndim != 2 or faces.shape[1] != 3 or faces_uv.shape != faces.shape or uv.ndim != 2 or uv.shape[1] != 2:
        raise FormatError(f"faces_{i} and faces_uv_{i} need one shape (F, 3) and uv_{i} needs (T, 2)")
    if faces_uv.size and not 0 <= faces_uv.min() <= faces_uv.max() < len(uv):
        raise FormatError(f"faces_uv_{i} names texture coordinate {faces_uv.max()} of {len(uv)}")
    texture = decode_texture(data[f"texture_{i}"], f"{path}: texture_{i}")
    return MeshPart(name, faces.astype(np.int32), uv[faces_uv].astype(np.float64), texture)
