"""Splats and scans without a rig take joints and weights of a rigged mesh in the same pose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.mesh_shapes import body_morphs
from glsplat.extras.authoring.geometry.surface_points import nearest_weights
from glsplat.extras.formats.obj import flat, parse_obj, textures_of
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

_MAX_MEDIAN_M, _MAX_P95_M = 0.06, 0.2  # distance of vertices from the body


def bind_to_mesh(splats: Splats, mesh: RiggedMesh, reach: float = 0.05) -> Avatar:
    """Return an avatar of static splats in the mesh's zero pose, with the weights of the nearest surface points.

    Raises FormatError if more than one splat in a hundred lies farther than ``reach`` metres from the surface (another
    pose, scale or person).
    """
    usable = splats.finite()
    points = np.where(usable[:, None], splats.means, 0).astype(np.float64)
    joints, weights, distance = nearest_weights(mesh, points)
    far = usable & (distance > reach)
    if far.sum() > 0.01 * max(int(usable.sum()), 1):
        raise FormatError(
            f"{int(far.sum())} of {len(splats)} splats lie more than {reach * 100:g} cm from the mesh "
            f"(median {np.median(distance[usable]) * 100:.1f} cm); both need one pose, place and scale"
        )
    skin = Skin.create(joints, weights, len(mesh.skeleton))
    return Avatar(splats, mesh.skeleton, skin, dict(mesh.meta))


def read_obj_person(path: str | Path, body: RiggedMesh) -> RiggedMesh:
    """Read an OBJ of a person in T-pose (y up, facing +z, any unit) with the joints and weights of ``body``.

    The body is scaled to the person's height and placed at its feet; each vertex takes the weights of the nearest
    point of the body. The texture is the first map_Kd of the material file beside the OBJ, or its Kd colour. Raises
    FormatError without triangles, or for a person too far from the body (another pose).
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
    fitted = _scaled_body(body, low, high)
    scale = np.ptp(fitted.vertices[:, 1]) / (high[1] - low[1])
    at = (vertices - (middle[0], low[1], middle[2])) * scale
    joints, weights, distance = nearest_weights(fitted, at)
    if np.median(distance) > _MAX_MEDIAN_M or np.percentile(distance, 95) > _MAX_P95_M:
        raise FormatError(
            f"{path}: the person lies {np.median(distance) * 100:.0f} cm off the body (median); "
            "it needs to stand in a T-pose, y up, facing +z"
        )
    part = MeshPart(source.stem, faces, corner, _texture(source, obj.library))
    morphs = body_morphs(fitted, at)
    return RiggedMesh(at, fitted.skeleton, joints, weights, (part,), {"source": source.name}, morphs)


def _scaled_body(body: RiggedMesh, low: F64, high: F64) -> RiggedMesh:
    """Return the body with its feet at the origin, of the scan's height if that is in metres, else of its own."""
    own = body.vertices
    height = high[1] - low[1]
    scale = height / np.ptp(own[:, 1]) if 0.5 < height < 2.6 else 1.0  # the scan is in another unit
    centre = (own.max(axis=0) + own.min(axis=0)) / 2
    origin = np.array([centre[0], own[:, 1].min(), centre[2]])
    skeleton = Skeleton.from_joints(body.skeleton.names, body.skeleton.parents, (body.skeleton.joints - origin) * scale)
    morphs = None if body.morphs is None else body.morphs.turned(scale * np.eye(3))
    return replace(body, vertices=(own - origin) * scale, skeleton=skeleton, morphs=morphs)


def _texture(source: Path, library: str | None) -> NDArray[np.uint8]:
    """Return the first image of the material file, else its last colour."""
    colour = flat()
    for _, texture, mapped in textures_of(source, library):
        if mapped:
            return texture
        colour = texture
    return colour
