"""Reach: how near and how far a posed mesh can be, without posing its vertices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import Skin

__all__ = ["depth_range", "fitted", "reach_of"]


def reach_of(mesh: RiggedMesh, skin: Skin) -> NDArray[np.float64]:
    """[J] metres from each joint to the farthest vertex that rides it at rest, -1 if none does."""
    reach = np.full(len(mesh.skeleton), -1.0)
    for ids, weights in zip(skin.joints.T, skin.weights.T, strict=True):
        distance = np.linalg.norm(mesh.vertices - mesh.skeleton.joints[ids], axis=1)
        np.maximum.at(reach, ids, np.where(weights > 0, distance, -1.0))
    return reach


def depth_range(
    camera: Camera,
    joints: NDArray[np.float64],  # [J, 3] at rest, metres
    reach: NDArray[np.float64],  # [J] as reach_of() has it
    bones: NDArray[np.float64],  # [J, 3, 4] to the world, less ``origin``
    origin: NDArray[np.float64],  # [3] world
) -> tuple[float, float]:
    """Least and largest camera z of a mesh under ``bones``, metres; the first may be negative.

    A vertex is a mean of what its joints make of it, so it lies among the balls around the posed joints.
    """
    places = np.einsum("jik,jk->ji", bones[:, :, :3], joints) + bones[:, :, 3] + origin
    depth = places @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    size = reach * np.linalg.norm(bones[:, :, :3], ord=2, axis=(1, 2))
    used = reach >= 0
    return float((depth - size)[used].min()), float((depth + size)[used].max())


def fitted(camera: Camera, least: float, largest: float) -> Camera:
    """The camera with near and far drawn in to what lies between those depths, metres."""
    near, far = max(camera.near, least * 0.99), min(camera.far, largest * 1.01)
    return replace(camera, near=near, far=max(far, near * 1.001))
