"""Lids of MakeHuman's people: a blink that ends where the lids meet, and lids in the colours of the skin around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.authoring.faces.eyeballs import Eyeball
from glsplat.authoring.faces.trimmings import lid_edges
from glsplat.authoring.visibility import EYES
from glsplat.meshes import Morphs, RiggedMesh

__all__ = ["BACK", "BLINKS", "blink_that_shuts", "even_lids", "lid_corners", "with_blink"]

F64 = NDArray[np.float64]

BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")
BACK = np.array([0.0, 0.0, -0.003])
"""Metres by which eyeballs give way to lids that close: as eyes do (Evinger, Shaw, Peck, Manning and Baker 1984)."""
_SHUT = 0.8  # of the opening's width, which has to be shut; lashes cover what is left in the corners
_OVER = 0.02  # of the shape, further: lids press
_LID = 0.12  # of the largest move; what a blink moves farther is lid
_AROUND = 0.012  # metres from lids, where skin is that has their colour


def blink_that_shuts(mesh: RiggedMesh, balls: Sequence[Eyeball]) -> float:
    """The weight of eyeBlink at which the upper lids of the mesh meet the lower ones.

    The open body's blink is made for its own eyes: in narrower ones the upper lid goes on over the cheek.
    """
    assert mesh.morphs is not None
    found = []
    for ball, name in zip(balls, BLINKS, strict=True):
        edges, moves = lid_edges(mesh, ball), _moves(mesh.morphs, name, len(mesh.vertices))
        upper, lower = (moves[mesh.faces[face], 1].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
        opening = edges.upper_at[:, 1] - edges.lower_at[:, 1]
        found.append(np.quantile(opening / np.maximum(lower - upper, 1e-4), _SHUT))
    return min(float(np.mean(found)) + _OVER, 1.0)


def with_blink(mesh: RiggedMesh, share: float) -> RiggedMesh:
    """The mesh whose lids close by that share of what they do, and whose eyeballs give way to them.

    Shapes are straight ways: half-way down a lid is where the front of the ball is.
    """
    morphs = mesh.morphs
    assert morphs is not None
    each = [share if name in BLINKS else 1.0 for name in morphs.names]
    scaled = morphs.offsets * np.repeat(each, np.diff(morphs.starts))[:, None]
    found: dict[str, list[tuple[NDArray[np.integer], F64]]] = {}
    for target, name in enumerate(morphs.names):
        part = slice(*morphs.starts[target : target + 2])
        found[name] = [(morphs.vertices[part], scaled[part])]
    for eye, name in zip(EYES, BLINKS, strict=True):
        ball = np.unique(next(part.faces for part in mesh.parts if part.name == eye))
        found[name].append((ball, np.tile(BACK, (len(ball), 1))))
    return replace(mesh, morphs=Morphs.of(found))


def lid_corners(mesh: RiggedMesh) -> NDArray[np.bool_]:
    """[V] which vertices are of lids: what a blink moves."""
    assert mesh.morphs is not None
    far = sum(np.linalg.norm(_moves(mesh.morphs, name, len(mesh.vertices)), axis=1) for name in BLINKS)
    return np.asarray(far > _LID * np.max(far))


def even_lids(mesh: RiggedMesh, share: float, part: str = "body") -> RiggedMesh:
    """The mesh whose lids have, in the texture of ``part``, by so large a share the colours of the skin around.

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
            one = replace(one, texture=_evened(texture, mask, ring & ~mask, share))
        parts.append(one)
    return replace(mesh, parts=tuple(parts))


def _evened(
    texture: NDArray[np.uint8], mask: NDArray[np.bool_], ring: NDArray[np.bool_], share: float
) -> NDArray[np.uint8]:
    """Colours in ``mask`` nearer to what the ``ring`` has beside them: a mean that falls off with the distance."""
    colour = texture[..., :3].astype(np.float64)
    wide = texture.shape[0] / 40
    light = colour.mean(axis=2)
    fair = ring & (light >= np.quantile(light[ring], 0.7))  # shade and lashes are no skin
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


def _moves(morphs: Morphs, name: str, count: int) -> F64:
    out = np.zeros((count, 3))
    part = slice(*morphs.starts[morphs.names.index(name) :][:2])
    out[morphs.vertices[part]] = morphs.offsets[part]
    return out
