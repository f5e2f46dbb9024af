"""A person as a rigged mesh: a box at each joint of the default skeleton, and its archive."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from glsplat.data import default_avatar
from glsplat.meshes import MeshPart, RiggedMesh

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
_FACES = np.array([[[a, b, c], [a, c, d]] for a, b, c, d in _SIDES]).reshape(-1, 3)


def boxes() -> RiggedMesh:
    """Each box rides its joint, the larger ones half of it its parent; the head's box is the largest."""
    skeleton = default_avatar().skeleton
    count = len(skeleton)
    size = np.full(count, 0.015)
    size[:22] = 0.07
    size[list(skeleton.names).index("head")] = 0.12
    vertices = (skeleton.joints[:, None] + size[:, None, None] * _CORNERS).reshape(-1, 3)
    joints = np.repeat(np.stack([np.arange(count), np.maximum(skeleton.parents, 0)], 1), 8, axis=0)
    share = np.where(np.repeat(size, 8) == 0.07, 0.7, 1.0)
    weights = np.stack([share, 1 - share], axis=1)
    faces = (8 * np.arange(count)[:, None, None] + _FACES).reshape(-1, 3).astype(np.int32)
    texture = np.full((8, 8, 4), 255, np.uint8)
    texture[..., :3] = np.random.default_rng(3).integers(60, 255, (8, 8, 3))
    uv = np.random.default_rng(4).random((count * 8, 2))
    part = MeshPart("boxes", faces, uv[faces], texture)
    return RiggedMesh(vertices, skeleton, joints.astype(np.int64), weights, (part,), {"source": "boxes"})


def save_person(mesh: RiggedMesh, path: Path) -> Path:
    """A person archive (.npz) of one part."""
    (part,) = mesh.parts
    corners = np.arange(3 * len(part.faces), dtype=np.int32).reshape(-1, 3)
    np.savez(
        path,
        vertices=mesh.vertices,
        joints=mesh.skeleton.joints,
        parents=mesh.skeleton.parents,
        joint_names=np.array(mesh.skeleton.names),
        skin_indices=mesh.joints,
        skin_weights=mesh.weights,
        part_names=np.array([part.name]),
        faces_0=part.faces,
        faces_uv_0=corners,
        uv_0=part.uv.reshape(-1, 2),
        texture_0=cv2.imencode(".png", cv2.cvtColor(part.texture, cv2.COLOR_RGBA2BGRA))[1].reshape(-1),
    )
    return path
