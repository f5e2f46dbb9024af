"""Lids of MakeHuman's people, in the colours of the skin around."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.extras.authoring.faces.blinks import BLINK_SHAPES
from glsplat.meshes import RiggedMesh

_LID = 0.12  # of the largest move; what a blink moves farther is lid
_AROUND = 0.012  # metres from lids, where skin is that has their colour


def lid_corners(mesh: RiggedMesh) -> NDArray[np.bool_]:
    """[V] which vertices are of lids: what a blink moves."""
    assert mesh.morphs is not None
    far = sum(np.linalg.norm(mesh.morphs.dense(name, len(mesh.vertices)), axis=1) for name in BLINK_SHAPES)
    return np.asarray(far > _LID * np.max(far))


def even_lids(mesh: RiggedMesh, share: float, part: str = "body", fair: float = 0.7) -> RiggedMesh:
    """The mesh whose lids have, in the texture of ``part``, by so large a share the colours of the skin around, of
    what there is lighter than the share ``fair`` of it.

    Textures are photographs: shade under brows and make-up are painted on lids, and stretch over the eye that closes.
    """
    lids = np.flatnonzero(lid_corners(mesh))
    parts = []
    for one in mesh.parts:
        if one.name == part:
            middle = mesh.vertices[one.faces].mean(axis=1)
            front = np.isin(one.faces, lids).all(axis=1)
            near = (cKDTree(middle[front]).query(middle)[0] < _AROUND) & ~np.isin(one.faces, lids).any(axis=1)
            texture = one.texture
            mask, ring = (_drawn(one.uv[which], texture.shape[:2]) for which in (front, near))
            one = replace(one, texture=_evened(texture, mask, ring & ~mask, share, fair))
        parts.append(one)
    return replace(mesh, parts=tuple(parts))


def _evened(
    texture: NDArray[np.uint8], mask: NDArray[np.bool_], ring: NDArray[np.bool_], share: float, least: float
) -> NDArray[np.uint8]:
    """Colours in ``mask`` nearer to what the ``ring`` has beside them: a mean that falls off with the distance."""
    colour = texture[..., :3].astype(np.float64)
    wide = texture.shape[0] / 40
    light = colour.mean(axis=2)
    fair = ring & (light >= np.quantile(light[ring], least))  # shade and lashes are no skin
    held = fair.astype(np.float64)[..., None]
    around = cv2.GaussianBlur(colour * held, (0, 0), wide)
    found = cv2.GaussianBlur(held[..., 0], (0, 0), wide)[..., None]
    usual = np.where(found > 1e-3, around / np.maximum(found, 1e-3), colour[fair].mean(axis=0))
    soft = cv2.GaussianBlur(mask.astype(np.float64), (0, 0), texture.shape[0] / 250)[..., None] * share
    out = texture.copy()
    out[..., :3] = np.rint(colour * (1 - soft) + usual * soft).clip(0, 255)
    return out


def _drawn(uv: F64, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """[H, W] the texels that triangles [F, 3, 2] cover."""
    height, width = shape
    at = np.rint(uv * (width, -height) + (0, height)).astype(np.int32)
    out = np.zeros(shape, np.uint8)
    for triangle in at:
        cv2.fillConvexPoly(out, triangle, 1)
    return out.astype(bool)
