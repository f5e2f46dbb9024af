"""The inside of a mouth, for people from photographs: its lining, teeth, lips' shade, and a tongue that is put out."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.mouth_lining import mouth_lining
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.open_face import of_open_body, open_face, with_mouth
from glsplat.extras.authoring.compute.threads import abreast
from glsplat.extras.authoring.faces.lashes_and_hair import Extra, added, frames, joined
from glsplat.extras.authoring.faces.tiles import Tiles, tiled
from glsplat.extras.authoring.geometry.nearest import nearest_on
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.surface import MIN_SPLATS, make_avatar
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import SH_C0

__all__ = ["with_open_lips", "with_teeth"]

F64 = NDArray[np.float64]

_SAMPLER = SamplerConfig(samples=24, candidates=8, rounds=8, probe=0, color_weight=1.2)
_AHEAD = -0.15  # of a unit normal: what looks back further is seen by nobody
_OUT, _FORWARD = "tongueOut", 0.006  # metres by which it moves a tongue at least
_PARTED = {"jawOpen": 0.15} | {
    f"mouth{way}{side}": 0.4 for way in ("LowerDown", "UpperUp") for side in ("Left", "Right")
}
_HANGS = 0.012  # metres, of its tip
_THIN = 0.0002  # metres of a tooth's splats
_COLOURED = 0.12  # between the channels of sRGB: a photograph of less has no colours
_BRIGHT, _WHITE, _DARKEST = 0.9, 0.70, 0.55  # of an eye's white: its brighter part, as it mostly is, and at the least
_SHADE = np.array((30, 10, 9)) / 255
# metres from the rim of a lip, inwards, and how dark it is there: the upper lip shades more, as light comes from above
_UPPER, _LOWER = ((0.0000, 0.40), (0.0016, 0.18)), ((0.0000, 0.30), (0.0016, 0.12))
_BEHIND = 0.0030  # metres of the rim that shade lies; teeth are twice as deep
_ABOUT, _APART = 0.02, 0.0015  # metres about the rims, and by which the lining is nearer than the skin outside
_WITHIN = 0.014  # metres from the rim, over which the lining becomes as dark as it is
_RIM, _DEEP = (0.55, 0.28, 0.27), (0.12, 0.045, 0.045)  # sRGB that it has at most, there and deep inside
_SOFT = (0.0020, 0.0010, 0.0001)  # metres, standard deviations of a patch of shade


def with_open_lips(mesh: RiggedMesh) -> RiggedMesh:
    """The mesh, whose first vertices are the open body's, with lips that part for a tongue that is put out.

    The open body's tongueOut is meant with an open jaw: alone the tongue goes through the lower lip, and it stays
    straight. Here its tip hangs over the lip.
    """
    assert mesh.morphs is not None
    body, count = open_body(), len(mesh.vertices)
    own = np.arange(len(body.vertices))
    out = mesh.morphs.dense(_OUT, count)
    before = mesh.vertices[own] + out[own]
    parted = np.sum([share * mesh.morphs.dense(name, count) for name, share in _PARTED.items()], axis=0)
    lip = mesh.vertices[mouth_lining().lower, 2].max()
    tongue = ~body.skin & (out[own, 2] > _FORWARD)
    beyond = ((before[:, 2] - lip) / max(before[tongue, 2].max(initial=lip) - lip, 1e-6)).clip(0, 1)
    parted[own, 1] -= np.where(tongue, _HANGS * beyond**2, 0)
    moved = np.flatnonzero(np.abs(parted).max(axis=1) > 0)
    return replace(mesh, morphs=mesh.morphs.plus({_OUT: (moved, parted[moved])}))


def with_teeth(avatar: Avatar, mesh: RiggedMesh, count: int, photographed: int, seed: int = 0) -> Avatar:
    """The avatar, made on ``mesh``, which has expressions, with ``count`` splats of teeth, gums and lips' shade.

    The mesh's first vertices are the open body's, the avatar's first splats those that were ``photographed``.
    """
    lined, inside = _darkened(avatar, mesh)
    shaded = _shaded(lined, mesh)
    furnished = with_mouth(mesh, of_open_body(mesh))
    teeth = next(one for one in furnished.parts if one.name == "teeth")
    light = _light(avatar, mesh)
    whole = added(shaded, furnished, _rows(furnished, teeth, light))
    left = max(count - (len(whole.splats) - len(avatar.splats)), MIN_SPLATS)
    one, other, third = (furnished.vertices[teeth.faces[:, k]] for k in range(3))
    facing = np.cross(other - one, third - one)
    seen = ~_enamel() & (facing[:, 2] > _AHEAD * np.linalg.norm(facing, axis=1))
    dimmed = np.rint(teeth.texture * (light, light, light, 1)).astype(np.uint8)
    gums = replace(teeth, faces=teeth.faces[seen], uv=teeth.uv[seen], texture=dimmed)
    made = joined(whole, make_avatar(replace(furnished, parts=(gums,)), left, seed, _SAMPLER))
    some = np.append(inside, np.arange(len(shaded.splats), len(made.splats)))
    return _without_colours(made, some, photographed)


def _without_colours(avatar: Avatar, some: NDArray[np.integer], photographed: int) -> Avatar:
    """The avatar, of whose splats ``some`` are as grey as the head that was ``photographed``; the tongue, too."""
    shapes, rgb = avatar.shapes, avatar.splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5
    head = strongest_joint(avatar.skin.joints, avatar.skin.weights) == avatar.skeleton.names.index("head")
    head[some], head[photographed:] = False, False
    colour = float(np.clip(np.quantile(np.ptp(rgb[head], axis=1), _BRIGHT) / _COLOURED, 0, 1)) if head.any() else 1.0
    if shapes is None or colour == 1:
        return avatar
    out = (shapes.targets == shapes.names.index(_OUT)) & (shapes.metres[:, 2] > _FORWARD)
    some = np.union1d(some, shapes.rows[out])
    grey = rgb[some].mean(axis=1, keepdims=True)
    sh = avatar.splats.sh.copy()
    sh[some, 0] = (grey + colour * (rgb[some] - grey) - 0.5) / SH_C0
    return replace(avatar, splats=replace(avatar.splats, sh=sh))


def _enamel() -> NDArray[np.bool_]:
    """[F] of the faces that ``with_mouth`` adds."""
    face = open_face()
    return face.tooth[face.whole]


@lru_cache(maxsize=1)
def _tiles() -> Tiles:
    face = open_face()
    return tiled(face.mouth, face.faces[face.whole], face.tooth[face.whole], face.lower)


def _rows(furnished: RiggedMesh, teeth: MeshPart, light: float) -> Extra:
    """The teeth of the mesh, as ``tiles`` has them."""
    tiles, first = _tiles(), 0
    for part in furnished.parts:
        if part is teeth:
            break
        first += len(part.faces)
    means = np.einsum("nk,nkc->nc", tiles.shares, furnished.vertices[teeth.faces[tiles.faces]])
    scales = np.concatenate([tiles.scales, np.full((len(means), 1), _THIN)], axis=1)
    means += tiles.facing * np.where(tiles.solid < 0.9, _THIN, 0)[:, None]  # seams before what they part
    return Extra(means, frames(tiles.along, tiles.facing), scales, tiles.solid, tiles.rgb * light, tiles.faces + first)


def _light(avatar: Avatar, mesh: RiggedMesh) -> float:
    """How bright teeth are: as the whites of the eyes are in the photograph."""
    ball = np.isin(
        strongest_joint(avatar.skin.joints, avatar.skin.weights), [mesh.skeleton.names.index(e) for e in EYES]
    )
    if not ball.any():
        return 1.0
    white = np.quantile((avatar.splats.sh[ball, 0] * SH_C0 + 0.5).mean(axis=1), _BRIGHT)
    return float(np.clip(white / _WHITE, _DARKEST, 1.0))


def _darkened(avatar: Avatar, mesh: RiggedMesh) -> tuple[Avatar, NDArray[np.integer]]:
    """The avatar whose splats on the mouth's lining are no lighter than it is, and those: a fit paints with them."""
    lining, splats = mouth_lining(), avatar.splats
    rims = np.concatenate([lining.upper, lining.lower])
    low, high = mesh.vertices[rims].min(axis=0) - _ABOUT, mesh.vertices[rims].max(axis=0) + _ABOUT
    near = np.flatnonzero(splats.finite() & np.all((splats.means > low) & (splats.means < high), axis=1))
    box = np.all((mesh.vertices > low - _ABOUT) & (mesh.vertices < high + _ABOUT), axis=1)
    faces = mesh.faces[box[mesh.faces].all(axis=1) & (mesh.faces < len(lining.inside)).all(axis=1)]
    within = np.all(lining.inside[faces], axis=1)
    outside = faces[np.all(open_body().skin[faces], axis=1) & ~within]
    if not len(near) or not within.any() or not len(outside):
        return avatar, near[:0]
    places = splats.means[near].astype(np.float64)
    found = abreast(lambda some: nearest_on(mesh.vertices, some, places), (faces, outside))
    (_, distance, which, bary), (_, apart, _, _) = found
    mine = within[which] & (apart > distance + _APART)
    deep = ((bary[mine] * lining.far[faces[which[mine]]]).sum(axis=1, keepdims=True) / _WITHIN).clip(0, 1) ** 0.5
    most = np.array(_RIM) * (1 - deep) + np.array(_DEEP) * deep
    sh = splats.sh.copy()
    sh[near[mine], 0] = np.minimum(sh[near[mine], 0], (most - 0.5) / SH_C0)
    return replace(avatar, splats=replace(splats, sh=sh)), near[mine]


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
