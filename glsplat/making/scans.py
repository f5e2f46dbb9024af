"""People without a rig: a textured OBJ in a T-pose takes joints and weights from a rigged body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.formats.files import naming, open_regular
from glsplat.formats.npz import read_arrays
from glsplat.making.faces.shapes import body_morphs
from glsplat.making.importers import nearest_weights
from glsplat.making.obj import flat, parse_obj, textures_of
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.expression import MOST_NAMES
from glsplat.skinning.skeleton import Skeleton

__all__ = ["read_body", "read_obj_person", "read_skeleton"]

_JOINTS = ("joint_names", "parents", "joints")
_BODY = ("v_template", "faces", *_JOINTS, "skin_indices", "skin_weights")
_FACE = ("expr_names", "expr_ptr", "expr_idx", "expr_val")
_TYPICAL, _WORST = 0.06, 0.2  # metres a scan may lie off the body: the median, and 95 % of its vertices


def read_body(path: str | Path) -> RiggedMesh:
    """An untextured rigged body (.npz): v_template, faces, joints, parents, joint_names, skin_indices, skin_weights.

    Raises FormatError naming the file and the key.
    """
    with naming(path):
        with open_regular(path) as (file, _):
            data = read_arrays(file, "a body", _BODY, optional=_FACE)
        try:
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
        except (PoseError, TypeError, ValueError) as error:
            raise FormatError(str(error)) from None


def read_skeleton(path: str | Path) -> Skeleton:
    """The skeleton of a body or a person archive (.npz). Raises FormatError naming the file and the key."""
    with naming(path):
        with open_regular(path) as (file, _):
            data = read_arrays(file, "a body", _JOINTS)
        try:
            return _skeleton(data)
        except (PoseError, TypeError, ValueError) as error:
            raise FormatError(str(error)) from None


def _face(data: Mapping[str, NDArray[Any]]) -> Morphs | None:
    """The expressions of a body: expr_names (T), expr_ptr (T + 1), expr_idx (M) and expr_val (M, 3) metres."""
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


def read_obj_person(path: str | Path, body: RiggedMesh) -> RiggedMesh:
    """An OBJ of a person in T-pose (y up, facing +z, any unit) with the joints and weights of ``body``.

    The body is scaled to the person's height and put where it stands; each vertex takes the weights of the nearest
    point of the body. The texture is the first map_Kd of the material file beside the OBJ, or its Kd colour. Raises
    FormatError: no triangles, or a person that lies too far off the body (another pose).
    """
    source = Path(path)
    try:
        text = source.read_text(encoding="utf-8", errors="replace")
        obj = parse_obj(text)
        vertices, faces, corner = obj.vertices, obj.faces, obj.uv
    except OSError as error:
        raise FormatError(f"{path}: cannot read the person ({error.strerror})") from None
    except (ValueError, IndexError) as error:
        raise FormatError(f"{path}: not a usable OBJ ({str(error)[:80]})") from None
    if not len(faces) or not np.isfinite(vertices).all() or not np.ptp(vertices[:, 1]) > 0:
        raise FormatError(f"{path}: a person needs triangles with finite vertices and some height")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = (low + high) / 2
    fitted = _fitted(body, low, high)
    scale = np.ptp(fitted.vertices[:, 1]) / (high[1] - low[1])
    at = (vertices - (middle[0], low[1], middle[2])) * scale
    joints, weights, distance = nearest_weights(fitted, at)
    if np.median(distance) > _TYPICAL or np.percentile(distance, 95) > _WORST:
        raise FormatError(
            f"{path}: the person lies {np.median(distance) * 100:.0f} cm off the body (median); "
            "it needs to stand in a T-pose, y up, facing +z"
        )
    part = MeshPart(source.stem, faces, corner, _texture(source, obj.library))
    morphs = body_morphs(fitted, at)
    return RiggedMesh(at, fitted.skeleton, joints, weights, (part,), {"source": source.name}, morphs)


def _fitted(body: RiggedMesh, low: NDArray[np.float64], high: NDArray[np.float64]) -> RiggedMesh:
    """The body with its feet on y = 0, over the origin; metres if the scan is, else of its own height."""
    own = body.vertices
    height = high[1] - low[1]
    scale = height / np.ptp(own[:, 1]) if 0.5 < height < 2.6 else 1.0  # another unit: keep the body's size
    centre = (own.max(axis=0) + own.min(axis=0)) / 2
    origin = np.array([centre[0], own[:, 1].min(), centre[2]])
    skeleton = Skeleton.from_joints(body.skeleton.names, body.skeleton.parents, (body.skeleton.joints - origin) * scale)
    morphs = None if body.morphs is None else body.morphs.turned(scale * np.eye(3))
    return replace(body, vertices=(own - origin) * scale, skeleton=skeleton, morphs=morphs)


def _texture(source: Path, library: str | None) -> NDArray[np.uint8]:
    """The first image of the material file, else its last colour."""
    colour = flat()
    for _, texture, mapped in textures_of(source, library):
        if mapped:
            return texture
        colour = texture
    return colour
