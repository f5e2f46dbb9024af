"""People and bodies in NumPy archives (.npz): rigged meshes with textures or expressions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.extras.formats.npz import array_names, read_arrays
from glsplat.formats.format import Format, Opened, opened
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.expression import MOST_NAMES
from glsplat.skinning.skeleton import Skeleton

_JOINTS = ("joint_names", "parents", "joints")
_NEEDED = ("vertices", "joints", "parents", "joint_names", "skin_indices", "skin_weights", "part_names")
_BODY = ("v_template", "faces", *_JOINTS, "skin_indices", "skin_weights")
_FACE = ("expr_names", "expr_ptr", "expr_idx", "expr_val")
_SHOWN = {"v_template", "vertices"}  # every archive with a mesh has one of them


def read_person(path: str | Path) -> RiggedMesh:
    """Read a person archive, an .npz of a rigged mesh with textured parts.

    Keys: vertices (V, 3) metres, joints (J, 3) rest positions with frames parallel to the world, parents (J,),
    joint_names (J,), skin_indices and skin_weights (V, K), part_names (P,), and for part i: faces_i, faces_uv_i (F, 3),
    uv_i (T, 2) with v up, texture_i (bytes of a JPEG or PNG). Raises FormatError naming the file and the key.
    """
    with opened(path) as start:
        return person_in(start)


def person_in(start: Opened) -> RiggedMesh:
    """Read an open person archive, as ``read_person`` does."""
    data = read_arrays(start.file, "a person")
    with _refused():
        return _person(data, start.name)


def _person(data: Mapping[str, NDArray[Any]], path: str) -> RiggedMesh:
    count = np.size(data.get("part_names", ()))
    needed = [*_NEEDED, *(f"{key}_{i}" for i in range(count) for key in ("faces", "faces_uv", "uv", "texture"))]
    missing = [key for key in needed if key not in data]
    if missing:
        raise FormatError(f"a person needs the key {missing[0]}; found {', '.join(list(data)[:8])}")
    parts = tuple(_part(data, i, str(name), path) for i, name in enumerate(data["part_names"]))
    indices, weights = data["skin_indices"].astype(np.int64), data["skin_weights"].astype(np.float64)
    vertices = data["vertices"].astype(np.float64)
    return RiggedMesh(vertices, _skeleton(data), indices, weights, parts, {"source": Path(path).name})


def _part(data: Mapping[str, NDArray[Any]], i: int, name: str, path: str) -> MeshPart:
    faces, faces_uv, uv = data[f"faces_{i}"], data[f"faces_uv_{i}"], data[f"uv_{i}"]
    if faces.ndim != 2 or faces.shape[1] != 3 or faces_uv.shape != faces.shape or uv.ndim != 2 or uv.shape[1] != 2:
        raise FormatError(f"faces_{i} and faces_uv_{i} need one shape (F, 3) and uv_{i} needs (T, 2)")
    if faces_uv.size and not 0 <= faces_uv.min() <= faces_uv.max() < len(uv):
        raise FormatError(f"faces_uv_{i} names texture coordinate {faces_uv.max()} of {len(uv)}")
    from glsplat.extras.formats.texture import decode_texture  # not at the top, as it needs OpenCV

    texture = decode_texture(data[f"texture_{i}"], f"{path}: texture_{i}")
    return MeshPart(name, faces.astype(np.int32), uv[faces_uv].astype(np.float64), texture)


def read_body(path: str | Path) -> RiggedMesh:
    """Read an untextured rigged body (.npz): v_template, faces, joints, parents, joint_names, skin_indices, _weights.

    Raises FormatError naming the file and the key.
    """
    with opened(path) as start:
        return _body(start)


def _body(start: Opened) -> RiggedMesh:
    data = read_arrays(start.file, "a body", _BODY, optional=_FACE)
    with _refused():
        faces = data["faces"].astype(np.int32)
        part = MeshPart("body", faces, np.zeros((*faces.shape, 2)), np.full((4, 4, 4), 255, np.uint8))
        return RiggedMesh(
            data["v_template"].astype(np.float64),
            _skeleton(data),
            data["skin_indices"].astype(np.int64),
            data["skin_weights"].astype(np.float64),
            (part,),
            morphs=_face(data),
        )


def read_skeleton(path: str | Path) -> Skeleton:
    """Read the skeleton of a body or a person archive (.npz). Raises FormatError naming the file and the key."""
    with opened(path) as start:
        data = read_arrays(start.file, "a body", _JOINTS)
        with _refused():
            return _skeleton(data)


@contextmanager
def _refused() -> Iterator[None]:
    """Convert errors of inconsistent arrays to FormatError."""
    try:
        yield
    except (PoseError, TypeError, ValueError) as error:
        raise FormatError(str(error)) from None


def _face(data: Mapping[str, NDArray[Any]]) -> Morphs | None:
    """Return the expressions of a body: expr_names (T), expr_ptr (T + 1), expr_idx (M) and expr_val (M, 3) metres."""
    if any(key not in data for key in _FACE):
        return None
    names = tuple(map(str, data["expr_names"]))
    starts, rows = data["expr_ptr"].astype(np.int64), data["expr_idx"].astype(np.int64)
    offsets = data["expr_val"].astype(np.float32)
    whole = starts.shape == (len(names) + 1,) and starts[0] == 0 and starts[-1] == len(rows)
    if not (whole and (np.diff(starts) >= 0).all() and offsets.shape == (len(rows), 3) and (rows >= 0).all()):
        raise FormatError("the expressions of a body need expr_ptr (T + 1), expr_idx (M) and expr_val (M, 3) that fit")
    if len(set(names)) != len(names) or len(names) > MOST_NAMES:
        raise FormatError(f"a body has at most {MOST_NAMES} expressions of distinct names")
    return Morphs(names, starts, rows.astype(np.uint32), offsets)


def _skeleton(data: Mapping[str, NDArray[Any]]) -> Skeleton:
    return Skeleton.from_joints(tuple(map(str, data["joint_names"])), data["parents"], data["joints"])


def _sniff(start: Opened) -> bool:
    return start.named(*PERSON.suffixes) or (start.head.startswith(b"PK") and bool(_arrays(start) & _SHOWN))


def _arrays(start: Opened) -> set[str]:
    start.file.seek(0)
    return set(array_names(start.file))


def _load(start: Opened) -> RiggedMesh:
    body = "v_template" in _arrays(start)
    start.file.seek(0)
    return _body(start) if body else person_in(start)


PERSON = Format(name="npz", title="a person or body (.npz)", suffixes=(".npz",), sniff=_sniff, load=_load, marked=False)
