"""Textured meshes on a rig, made up, and where their triangles are in a pose."""

from __future__ import annotations

import numpy as np

from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

__all__ = ["bends", "chain", "coloured", "corners"]


def coloured(width: int, height: int) -> np.ndarray:
    """A smooth picture."""
    y, x = np.mgrid[:height, :width]
    channels = [x * 255 // width, y * 255 // height, (x + y) * 255 // (width + height), 255 + 0 * x]
    return np.stack(channels, -1).astype(np.uint8)


def chain(influences: int = 4, seed: int = 3) -> RiggedMesh:
    """Two parts on a chain of ten joints; one has holes, both have seams and texture coordinates beyond [0, 1]."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.normal(0, 0.2, (10, 3)), axis=0)
    skeleton = Skeleton.from_joints([f"joint {j}" for j in range(10)], list(range(-1, 9)), places)
    vertices = rng.normal(0, 0.5, (60, 3))
    joints = np.stack([rng.permutation(10)[:influences] for _ in vertices])
    holes = coloured(32, 16)
    holes[:8, :, 3] = 0
    parts = [
        MeshPart(name, rng.integers(0, 60, (40, 3)).astype(np.int32), rng.uniform(-0.5, 1.5, (40, 3, 2)), texture)
        for name, texture in (("whole", coloured(64, 64)), ("holes", holes))
    ]
    weights = rng.uniform(0.05, 2, joints.shape)
    return RiggedMesh(vertices, skeleton, joints, weights, tuple(parts), {"consent": "nobody real", "number": 7})


def bends(mesh: RiggedMesh, seed: int = 1) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(rng.normal(0, 0.5, (len(mesh.skeleton), 3)), rng.normal(0, 1, 3))


def corners(mesh: RiggedMesh, pose: Pose) -> np.ndarray:
    return mesh.posed(pose)[mesh.faces]
