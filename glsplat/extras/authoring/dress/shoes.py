"""Put a pair of shoes on the dressed body, in place of its feet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

_SIDES = (("left", 1.0), ("right", -1.0))
_SOCK_HEIGHT_M = 0.18  # above the sole: only a template's socks reach so high
# of the open body's zero shape: the foot below is inside the shoe, and between both heights it enters it
_HIDDEN_BELOW_M, _ENTERS_BELOW_M = -0.745, -0.705
_TAPER_M = 0.03  # above a shoe's rim: trousers narrow into it, so that they do not cut through its heel
_WIDE_HEM_M = 0.02, 0.035  # off the leg: wider hems hang over the shoe
_FOOT_TOP_M = 0.08  # above the sole: higher up an outline is that of trousers
_REACH = 1.0, 1.25  # range of a shoe's length and width in the picture, over that of the template on the bare foot
_OUTLINE_QUANTILES = 0.005, 0.995


def feet_vertices(body: Body, side: str) -> NDArray[np.bool_]:
    """Return [V] the vertices of one foot."""
    joints = [JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "foot")]
    return np.asarray(body.skin & np.isin(body.part, joints))


def with_shoes(body: Body, bare: F64, mesh: RiggedMesh, pair: RiggedMesh) -> RiggedMesh:
    """Return the dressed body ``mesh`` with a part "shoes", a ``pair`` of the template library, after its own parts.

    ``bare`` [V, 3] is the shaped body without clothes, soles on y = 0. Shoes are as long and wide as the dressed feet.
    The shoes' vertices come after the body's; the feet in them lose their triangles.
    """
    part = pair.parts[0]
    edges = part.faces.ravel(), np.roll(part.faces, 1, axis=1).ravel()
    piece = connected_components(coo_array((np.ones(part.faces.size), edges), (len(pair.vertices),) * 2))[1]
    top = np.full(piece.max() + 1, -np.inf)
    np.maximum.at(top, piece, pair.vertices[:, 1])
    kept = top[piece[part.faces[:, 0]]] < pair.vertices[:, 1].min() + _SOCK_HEIGHT_M
    used, faces = np.unique(part.faces[kept], return_inverse=True)
    places, uv = pair.vertices[used], part.uv[kept].copy()
    vertices, inside = mesh.vertices.copy(), np.zeros(len(bare), bool)
    height, worn = body.vertices[:, 1], lengths(vertices[: len(bare)] - bare)
    rim = places[:, 1].max()
    for side, sign in _SIDES:
        foot, mine = feet_vertices(body, side), sign * places[:, 0] > 0
        basis = np.column_stack([body.vertices[foot], np.ones(foot.sum())])
        shaped = np.column_stack([places[mine], np.ones(mine.sum())]) @ np.linalg.lstsq(basis, bare[foot])[0]
        shaped[:, 1] -= shaped[:, 1].min()
        outline = mesh.vertices[: len(bare)][foot & (mesh.vertices[: len(bare), 1] < _FOOT_TOP_M)]
        for axis in (0, 2):
            low, high = np.quantile(outline[:, axis], _OUTLINE_QUANTILES)
            first, last = shaped[:, axis].min(), shaped[:, axis].max()
            middle = (first + last) / 2
            shaped[:, axis] = middle + (shaped[:, axis] - middle) * np.clip((high - low) / (last - first), *_REACH)
        places[mine] = shaped
        inside |= foot & (height < _HIDDEN_BELOW_M)
        share = np.interp(height, (_HIDDEN_BELOW_M, _ENTERS_BELOW_M), (1, 0)) * foot
        leg = body.skin & np.isin(
            body.part, [JOINT_NAMES.index(f"{side}_{name}") for name in ("knee", "ankle", "foot")]
        )
        taper = np.interp(height, (rim, rim + _TAPER_M), (1, 0)) * np.interp(worn, _WIDE_HEM_M, (1, 0))
        share = np.maximum(share, taper * leg)
        vertices[: len(bare)] += share[:, None] * (bare - vertices[: len(bare)])
    uv[places[faces.reshape(-1, 3)[:, 0], 0] < 0, :, 0] += 1  # textures repeat: baked side by side
    parts = []
    for own in mesh.parts:
        shown = ~inside[own.faces].all(axis=1)
        parts.append(MeshPart(own.name, own.faces[shown], own.uv[shown], own.texture))
    shoes = MeshPart("shoes", (faces.reshape(-1, 3) + len(vertices)).astype(np.int32), uv, part.texture)
    return replace(
        mesh,
        vertices=np.concatenate([vertices, np.round(places, 7)]),
        joints=np.concatenate([mesh.joints, pair.joints[used]]),
        weights=np.concatenate([mesh.weights, pair.weights[used]]),
        parts=(*parts, shoes),
    )
