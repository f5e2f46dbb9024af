"""A face that moves for a person from a photograph: the open body's expressions, teeth, lids and lashes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.faces.eyeballs import eyeballs
from glsplat.authoring.faces.open_face import with_expressions, with_mouth
from glsplat.authoring.faces.shapes import with_shapes
from glsplat.authoring.faces.trimmings import joined, with_lashes
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.importers import nearest_on
from glsplat.authoring.surface import FEWEST, make_avatar
from glsplat.avatar import Avatar
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.splats import SH_C0

__all__ = ["FACE_SPLATS", "with_face"]

FACE_SPLATS = 900
"""Splats that teeth, gums, lids and lashes take of those of an avatar."""

_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, probe=64)
_OPEN = replace(_SAMPLER, probe=0)  # nothing hides a lid
_LASHES = 0.45  # of opacities: what photographs show of lashes is there already
_BENT = round(0.8 / BEND)  # lids have few splats, of the eye's colours in part, which smear where they stretch more
_LIDS = FEWEST  # splats of an upper lid in the skin's colour, which photographs of open eyes do not show
_CLOSER = 1.8  # times as large as they lie, so that they leave no gaps where the lid stretches
_COMES = 0.003  # metres that a closing lid comes down
_SHADED = 0.95  # of that skin's colour
_ABOVE = 0.008  # metres from a lid's middle to the skin below the brow
_UNLIKE = 0.1  # of 1, from the skin about it: what lies on a lid and has the eye's colours or a lash's
_SUNK = np.array(
    [0.0, 0.0, -0.008]
)  # metres into the head, where such goes when the lid closes, and its skin comes from
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
    _, _, which, _ = nearest_on(face.vertices, face.faces, part.splats.means.astype(np.float64))
    shapes = with_shapes(part, face, which).shapes
    assert shapes is not None
    spread = np.zeros(len(avatar.splats) + 1, np.int64)
    spread[near + 1] = np.diff(shapes.starts)
    bends = np.clip(shapes.bends, -_BENT, _BENT)
    whole = replace(shapes, starts=np.cumsum(spread), bends=bends)
    lids = [_lid(face, avatar, near, which, side) for side in ("Left", "Right")]
    for lid in lids:
        whole = _sinking(whole, lid)
    splats = replace(avatar.splats, cones=None, cones_psnr=None)
    given = replace(avatar, splats=splats, shapes=whole, levels=())
    furnished = with_mouth(face, same)
    teeth = tuple(one for one in furnished.parts if one.name == "teeth")
    for lid in lids:
        if len(lid.part.faces):
            given = joined(given, _rising(make_avatar(replace(face, parts=(lid.part,)), _LIDS, seed, _OPEN), lid))
    given = with_lashes(given, face, eyeballs(mesh, "eyes"), seed, strength=_LASHES, light=False)
    left = max(total - len(given.splats), FEWEST)
    return joined(given, make_avatar(replace(furnished, parts=teeth), left, seed, _SAMPLER))


class _Lid(NamedTuple):
    """An upper lid as it closes."""

    blink: str  # the shape
    part: MeshPart  # in the colour of the skin about it
    strangers: NDArray[np.intp]  # splats that lie on it and are not of its skin


def _lid(face: RiggedMesh, avatar: Avatar, near: NDArray[np.intp], which: NDArray[np.intp], side: str) -> _Lid:
    """Of the splats ``near`` [K], which lie on the triangles ``which`` [K]."""
    assert face.morphs is not None
    blink = f"eyeBlink{side}"
    still = np.zeros((len(face.skeleton), 3))
    comes = -face.morphs.moved(Pose(still, expression={blink: 1.0}), len(face.vertices))[:, 1]
    lid: NDArray[np.bool_] = np.any(comes[face.faces] > _COMES, axis=1)
    middle = face.vertices[face.faces[lid]].reshape(-1, 3).mean(axis=0)
    means, rgb = avatar.splats.means[near].astype(np.float64), avatar.splats.sh[near, 0] * SH_C0 + 0.5
    close: NDArray[np.bool_] = np.less(np.linalg.norm(means - middle, axis=1), _NEAR)
    about = rgb[close & (means[:, 1] > middle[1] + _ABOVE) & (np.abs(means[:, 0] - middle[0]) < _NEAR / 2)]
    about = about[about.sum(axis=1) >= np.quantile(about.sum(axis=1), 0.3)] if len(about) else np.full((1, 3), 0.5)
    colour = np.median(about, axis=0) * _SHADED
    strangers = close & lid[which] & (np.linalg.norm(rgb - colour, axis=1) > _UNLIKE)
    texture = np.full((2, 2, 4), 255, np.uint8)
    texture[..., :3] = np.rint(np.clip(colour, 0, 1) * 255)
    faces = face.faces[(comes[face.faces] > _COMES).all(axis=1)]
    return _Lid(blink, MeshPart(f"lid{side}", faces, np.full((len(faces), 3, 2), 0.5), texture), near[strangers])


def _rising(skin: Avatar, lid: _Lid) -> Avatar:
    """The skin of a lid, which lies behind the eye and comes before it as the lid closes."""
    shapes = skin.shapes
    assert shapes is not None
    closing = shapes.targets == shapes.names.index(lid.blink)
    moves = shapes.metres - np.where(closing[:, None], _SUNK, 0)
    whole = Shapes.create(
        shapes.names,
        shapes.splats,
        splats=shapes.rows,
        targets=shapes.targets,
        moves=moves,
        bends=shapes.bends * BEND,
        limits=shapes.limits,
    )
    means, scales = (skin.splats.means + _SUNK).astype(np.float32), skin.splats.scales * np.float32(_CLOSER)
    return replace(skin, splats=replace(skin.splats, means=means, scales=scales), shapes=whole)


def _sinking(shapes: Shapes, lid: _Lid) -> Shapes:
    """The shapes, of which what lies on the lid and is not of its skin takes none, but goes behind when that closes."""
    if not len(lid.strangers) or lid.blink not in shapes.names:
        return shapes
    rows = shapes.rows
    kept = ~np.isin(rows, lid.strangers)
    more = len(lid.strangers)
    return Shapes.create(
        shapes.names,
        shapes.splats,
        splats=np.concatenate([rows[kept], lid.strangers]),
        targets=np.concatenate([shapes.targets[kept].astype(np.int64), np.full(more, shapes.names.index(lid.blink))]),
        moves=np.concatenate([shapes.metres[kept], np.tile(_SUNK, (more, 1))]),
        bends=np.concatenate([shapes.bends[kept] * BEND, np.zeros((more, 2, 3))]),
        limits=shapes.limits,
    )
