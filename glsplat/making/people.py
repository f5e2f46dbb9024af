"""People: the reader of the person archives (.npz), and of their textures."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.formats.files import naming, open_regular
from glsplat.formats.npz import read_arrays
from glsplat.making.photo.png import clean_png
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton

__all__ = ["decode_texture", "read_person"]

_NEEDED = ("vertices", "joints", "parents", "joint_names", "skin_indices", "skin_weights", "part_names")
_LONGEST = 16_384  # pixels; what GL takes
_MOST = 1 << 26  # pixels: a small file may claim more than there is memory


def decode_texture(data: bytes | NDArray[np.uint8], where: str) -> NDArray[np.uint8]:
    """RGBA uint8 [H, W, 4] of a JPEG, PNG or WebP; FormatError naming ``where`` if it is none, or damaged."""
    buffer = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else data
    if buffer.dtype != np.uint8 or buffer.ndim != 1:
        raise FormatError(f"{where}: a texture is the bytes of a file, not {buffer.dtype} of shape {buffer.shape}")
    said = bytes(buffer[:32])
    width, height = _size(said, buffer)
    if not (width and height):
        raise FormatError(f"{where}: a texture is a JPEG, PNG or WebP, found {said[:4]!r}")
    if width * height > _MOST and max(width, height) <= _LONGEST:
        raise FormatError(f"{where}: a texture has at most {_MOST >> 20} Mi pixels, this one {width} x {height}")
    if max(width, height) > _LONGEST:
        raise FormatError(f"{where}: a texture has at most {_LONGEST} pixels a side, this one {width} x {height}")
    try:
        image = _decoded(said, buffer)
    except (cv2.error, MemoryError, ValueError, RuntimeError, struct.error, IndexError):
        image = None
    except FormatError as error:
        raise FormatError(f"{where}: {error}") from None
    if image is None:
        raise FormatError(f"{where}: the texture, {width} x {height} pixels, cannot be decoded (damaged?)")
    return image


def _decoded(head: bytes, data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """RGBA; None or any error of the decoders where it is damaged. They say nothing on standard error."""
    if head.startswith(b"\xff\xd8"):
        space = simplejpeg.decode_jpeg_header(data, strict=False)[2]
        if space != "CMYK":
            return cv2.cvtColor(simplejpeg.decode_jpeg(data, "RGB", strict=False), cv2.COLOR_RGB2RGBA)
    if head.startswith(b"\x89PNG"):
        data = np.frombuffer(clean_png(data.tobytes()), np.uint8)
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the one line is ours
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        return None
    if image.dtype != np.uint8:
        image = (image / 257).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGBA if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def _size(head: bytes, data: NDArray[np.uint8]) -> tuple[int, int]:
    """Width and height that a picture claims, before a pixel is unpacked; 0, 0 of other kinds."""
    if len(head) < 32:
        return 0, 0
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        width, height = struct.unpack_from(">II", head, 16)
        return width, height
    if head.startswith(b"RIFF") and head[8:15] == b"WEBPVP8":
        lossy, kind = struct.unpack_from("<I", head, 26)[0], head[15:16]
        if kind == b"X":
            wide, high = (int.from_bytes(head[at : at + 3], "little") + 1 for at in (24, 27))
            return wide, high
        bits = struct.unpack_from("<I", head, 21)[0]
        if kind == b"L":
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        return lossy & 0x3FFF, lossy >> 16 & 0x3FFF
    if head.startswith(b"\xff\xd8"):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data, strict=False)
            return width, height
        except (ValueError, RuntimeError, KeyError):
            pass
    return 0, 0


def read_person(path: str | Path) -> RiggedMesh:
    """Read a person archive: an .npz of a rigged mesh with textured parts.

    Keys: vertices (V, 3) metres, joints (J, 3) rest positions with frames parallel to the world, parents (J,),
    joint_names (J,), skin_indices and skin_weights (V, K), part_names (P,), and for part i: faces_i, faces_uv_i (F, 3),
    uv_i (T, 2) with v up, texture_i (bytes of a JPEG or PNG). Raises FormatError naming the file and the key.
    """
    with naming(path):
        with open_regular(path) as (file, _):
            data = read_arrays(file, "a person")
        try:
            return _person(data, path)
        except (PoseError, TypeError, ValueError) as error:
            raise FormatError(str(error)) from None


def _person(data: Mapping[str, NDArray[Any]], path: str | Path) -> RiggedMesh:
    count = np.size(data.get("part_names", ()))
    needed = [*_NEEDED, *(f"{key}_{i}" for i in range(count) for key in ("faces", "faces_uv", "uv", "texture"))]
    missing = [key for key in needed if key not in data]
    if missing:
        raise FormatError(f"a person needs the key {missing[0]}; found {', '.join(list(data)[:8])}")
    skeleton = Skeleton.from_joints(tuple(map(str, data["joint_names"])), data["parents"], data["joints"])
    parts = tuple(_part(data, i, str(name), str(path)) for i, name in enumerate(data["part_names"]))
    indices, weights = data["skin_indices"].astype(np.int64), data["skin_weights"].astype(np.float64)
    vertices = data["vertices"].astype(np.float64)
    return RiggedMesh(vertices, skeleton, indices, weights, parts, {"source": Path(path).name})


def _part(data: Mapping[str, NDArray[Any]], i: int, name: str, path: str) -> MeshPart:
    faces, faces_uv, uv = data[f"faces_{i}"], data[f"faces_uv_{i}"], data[f"uv_{i}"]
    if faces.ndim != 2 or faces.shape[1] != 3 or faces_uv.shape != faces.shape or uv.ndim != 2 or uv.shape[1] != 2:
        raise FormatError(f"faces_{i} and faces_uv_{i} need one shape (F, 3) and uv_{i} needs (T, 2)")
    if faces_uv.size and not 0 <= faces_uv.min() <= faces_uv.max() < len(uv):
        raise FormatError(f"faces_uv_{i} names texture coordinate {faces_uv.max()} of {len(uv)}")
    texture = decode_texture(data[f"texture_{i}"], f"{path}: texture_{i}")
    return MeshPart(name, faces.astype(np.int32), uv[faces_uv].astype(np.float64), texture)
