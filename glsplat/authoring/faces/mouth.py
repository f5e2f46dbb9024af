"""The inside of a mouth, for people from photographs: teeth one by one, and the shade of the lips on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.faces.lining import mouth_lining
from glsplat.authoring.faces.open_face import with_mouth
from glsplat.authoring.faces.trimmings import Extra, added, joined
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.importers import nearest_on
from glsplat.authoring.surface import FEWEST, make_avatar
from glsplat.authoring.threads import abreast
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh
from glsplat.splats import SH_C0

__all__ = ["with_teeth"]

F64 = NDArray[np.float64]

_SAMPLER = SamplerConfig(samples=24, candidates=8, rounds=8, probe=0, color_weight=1.2)
_AHEAD = -0.15  # of a unit normal: what looks back further is seen by nobody
_SHADE = np.array((30, 10, 9)) / 255
# metres from the rim of a lip, inwards, and how dark it is there: the upper lip shades more, as light comes from above
_UPPER, _LOWER = ((0.0000, 0.40), (0.0016, 0.18)), ((0.0000, 0.30), (0.0016, 0.12))
_BEHIND = 0.0030  # metres of the rim that shade lies; teeth are twice as deep
_ABOUT, _APART = 0.02, 0.0015  # metres about the rims, and by which the lining is nearer than the skin outside
_WITHIN = 0.014  # metres from the rim, over which the lining becomes as dark as it is
_RIM, _DEEP = (0.55, 0.28, 0.27), (0.12, 0.045, 0.045)  # sRGB that it has at most, there and deep inside
_SOFT = (0.0020, 0.0010, 0.0001)  # metres, standard deviations of a patch of shade


def with_teeth(avatar: Avatar, mesh: RiggedMesh, same: NDArray[np.intp], count: int, seed: int = 0) -> Avatar:
    """The avatar, made on ``mesh``, which has expressions, with ``count`` splats of teeth, gums and lips' shade.

    ``same`` [V] as of ``open_face.matched``: the open body's vertices, which are the mesh's first, are themselves.
    """
    shaded = _shaded(_darkened(avatar, mesh), mesh)
    left = max(count - (len(shaded.splats) - len(avatar.splats)), FEWEST)
    furnished = with_mouth(mesh, same)
    teeth = next(one for one in furnished.parts if one.name == "teeth")
    one, other, third = (furnished.vertices[teeth.faces[:, k]] for k in range(3))
    facing = np.cross(other - one, third - one)
    ahead = facing[:, 2] > _AHEAD * np.linalg.norm(facing, axis=1)
    seen = ahead & (teeth.uv[:, :, 1].max(axis=1) < 1)  # no roots
    teeth = replace(teeth, faces=teeth.faces[seen], uv=teeth.uv[seen])
    return joined(shaded, make_avatar(replace(furnished, parts=(teeth,)), left, seed, _SAMPLER))


def _darkened(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """The avatar whose splats on the mouth's lining are no lighter than it is: a fit paints with what nobody sees."""
    lining, splats = mouth_lining(), avatar.splats
    rims = np.concatenate([lining.upper, lining.lower])
    low, high = mesh.vertices[rims].min(axis=0) - _ABOUT, mesh.vertices[rims].max(axis=0) + _ABOUT
    near = np.flatnonzero(splats.finite() & np.all((splats.means > low) & (splats.means < high), axis=1))
    box = np.all((mesh.vertices > low - _ABOUT) & (mesh.vertices < high + _ABOUT), axis=1)
    faces = mesh.faces[box[mesh.faces].all(axis=1) & (mesh.faces < len(lining.inside)).all(axis=1)]
    within = np.all(lining.inside[faces], axis=1)
    outside = faces[np.all(open_body().skin[faces], axis=1) & ~within]
    if not len(near) or not within.any() or not len(outside):
        return avatar
    places = splats.means[near].astype(np.float64)
    found = abreast(lambda some: nearest_on(mesh.vertices, some, places), (faces, outside))
    (_, distance, which, bary), (_, apart, _, _) = found
    mine = within[which] & (apart > distance + _APART)
    deep = ((bary[mine] * lining.far[faces[which[mine]]]).sum(axis=1, keepdims=True) / _WITHIN).clip(0, 1) ** 0.5
    most = np.array(_RIM) * (1 - deep) + np.array(_DEEP) * deep
    sh = splats.sh.copy()
    sh[near[mine], 0] = np.minimum(sh[near[mine], 0], (most - 0.5) / SH_C0)
    return replace(avatar, splats=replace(splats, sh=sh))


def _shaded(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """The avatar with dark veils behind the rims of its lips, which go with them and do not stretch."""
    lining, parts = mouth_lining(), []
    inside = np.flatnonzero(lining.inside[np.minimum(mesh.faces, len(lining.inside) - 1)].all(axis=1))
    for rim, rows, way in ((lining.upper, _UPPER, -1), (lining.lower, _LOWER, 1)):
        face = np.array([inside[np.any(mesh.faces[inside] == corner, axis=1)][0] for corner in rim])
        for deep, dark in rows:
            means = mesh.vertices[rim] + (0, way * deep, -_BEHIND)
            many = len(rim)
            axes, scales = np.tile(np.eye(3), (many, 1, 1)), np.tile(_SOFT, (many, 1))
            parts.append(Extra(means, axes, scales, np.full(many, dark), np.tile(_SHADE, (many, 1)), face))
    veils = Extra(*(np.concatenate([getattr(one, key) for one in parts]) for key in Extra._fields))
    made = added(avatar, mesh, veils)
    assert made.shapes is not None
    stiff = (made.shapes.rows >= len(avatar.splats))[:, None, None]
    return replace(made, shapes=replace(made.shapes, bends=np.where(stiff, 0, made.shapes.bends)))
