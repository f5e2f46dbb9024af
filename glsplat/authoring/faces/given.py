"""A face that moves for a person from a photograph: the open body's expressions, teeth and lashes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.faces.eyeballs import eyeballs
from glsplat.authoring.faces.open_face import with_expressions, with_mouth
from glsplat.authoring.faces.shapes import with_shapes
from glsplat.authoring.faces.trimmings import joined, with_lashes
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.surface import FEWEST, make_avatar
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh
from glsplat.skinning.shapes import BEND

__all__ = ["FACE_SPLATS", "with_face"]

FACE_SPLATS = 900
"""Splats that teeth, gums and lashes take of those of an avatar."""

_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, probe=128)
_LASHES = 0.45  # of opacities: what photographs show of lashes is there already
_BENT = round(0.8 / BEND)  # lids have few splats, of the eye's colours in part, which smear where they stretch more
_NEAR = 0.03  # metres from what expressions move; splats farther off stay


def with_face(avatar: Avatar, mesh: RiggedMesh, total: int, seed: int = 0) -> Avatar:
    """The avatar that was made on ``mesh``, whose first vertices are the open body's, with 52 shapes of ARKit.

    Teeth and lashes are added behind the lips and at the lids, ``total`` splats with them; the rest keeps its places
    and colours. The mesh has parts called eyes, mouth and skin. Without levels and cones.
    """
    count = len(open_body().vertices)
    same = np.where(np.arange(len(mesh.vertices)) < count, np.arange(len(mesh.vertices)), -1)
    face = with_expressions(mesh, same)
    assert face.morphs is not None
    stirred = mesh.vertices[np.unique(face.morphs.vertices)]
    usable = avatar.splats.finite()
    means = np.where(usable[:, None], avatar.splats.means, 1e3)
    near = np.flatnonzero(np.isfinite(cKDTree(stirred).query(means, distance_upper_bound=_NEAR)[0]))
    skin = replace(avatar.skin, joints=avatar.skin.joints[near], weights=avatar.skin.weights[near])
    part = replace(avatar, splats=avatar.splats.take(near), skin=skin, shapes=None, levels=())
    shapes = with_shapes(part, face).shapes
    assert shapes is not None
    spread = np.zeros(len(avatar.splats) + 1, np.int64)
    spread[near + 1] = np.diff(shapes.starts)
    bends = np.clip(shapes.bends, -_BENT, _BENT)
    whole = replace(shapes, starts=np.cumsum(spread), bends=bends)
    splats = replace(avatar.splats, cones=None, cones_psnr=None)
    given = replace(avatar, splats=splats, shapes=whole, levels=())
    furnished = with_mouth(face, same)
    teeth = tuple(one for one in furnished.parts if one.name == "teeth")
    given = with_lashes(given, face, eyeballs(mesh, "eyes"), seed, strength=_LASHES, light=False)
    left = max(total - len(given.splats), FEWEST)
    return joined(given, make_avatar(replace(furnished, parts=teeth), left, seed, _SAMPLER))
