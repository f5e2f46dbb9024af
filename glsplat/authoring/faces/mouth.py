"""The inside of a mouth, for people from photographs: teeth one by one, and the shade of the lips on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.faces.lining import mouth_lining
from glsplat.authoring.faces.open_face import with_mouth
from glsplat.authoring.faces.trimmings import Extra, added, joined
from glsplat.authoring.surface import FEWEST, make_avatar
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh

__all__ = ["with_teeth"]

F64 = NDArray[np.float64]

_SAMPLER = SamplerConfig(samples=24, candidates=8, rounds=8, probe=0, color_weight=1.2)
_AHEAD = -0.15  # of a unit normal: what looks back further is seen by nobody
_SHADE = np.array((30, 10, 9)) / 255
# metres from the rim of a lip, inwards, and how dark it is there: the upper lip shades more, as light comes from above
_UPPER, _LOWER = ((0.0000, 0.40), (0.0016, 0.18)), ((0.0000, 0.30), (0.0016, 0.12))
_BEHIND = 0.0030  # metres of the rim that shade lies; teeth are twice as deep
_SOFT = (0.0020, 0.0010, 0.0001)  # metres, standard deviations of a patch of shade


def with_teeth(avatar: Avatar, mesh: RiggedMesh, same: NDArray[np.intp], count: int, seed: int = 0) -> Avatar:
    """The avatar, made on ``mesh``, which has expressions, with ``count`` splats of teeth, gums and lips' shade.

    ``same`` [V] as of ``open_face.matched``: the open body's vertices, which are the mesh's first, are themselves.
    """
    shaded = _shaded(avatar, mesh)
    left = max(count - (len(shaded.splats) - len(avatar.splats)), FEWEST)
    furnished = with_mouth(mesh, same)
    teeth = next(one for one in furnished.parts if one.name == "teeth")
    one, other, third = (furnished.vertices[teeth.faces[:, k]] for k in range(3))
    facing = np.cross(other - one, third - one)
    ahead = facing[:, 2] > _AHEAD * np.linalg.norm(facing, axis=1)
    seen = ahead & (teeth.uv[:, :, 1].max(axis=1) < 1)  # no roots
    teeth = replace(teeth, faces=teeth.faces[seen], uv=teeth.uv[seen])
    return joined(shaded, make_avatar(replace(furnished, parts=(teeth,)), left, seed, _SAMPLER))


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
