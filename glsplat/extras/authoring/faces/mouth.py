"""Add the inside of a mouth for people from photographs: its lining, teeth, lips' shadows, and a tongue."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.open_face import mouth_lining, open_face, with_mouth
from glsplat.extras.authoring.body.teeth import ToothTiles, tile_teeth
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.faces.lashes import ExtraSplats, add_splats, axes_along, joined_splats, unbent
from glsplat.extras.authoring.geometry.surface_points import nearest_on
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.merge import merge_avatars
from glsplat.extras.authoring.sample.surface import MIN_SPLATS, make_avatar
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import SH_C0

_SAMPLER = SamplerConfig(samples=24, candidates=8, rounds=8, probe=0, color_weight=1.2)
_MIN_NORMAL_Z = -0.15  # surface facing farther back is never visible
_TONGUE_OUT, _MIN_TONGUE_MOVE_M = "tongueOut", 0.006
_PARTED_LIPS = {"jawOpen": 0.15} | {
    f"mouth{way}{side}": 0.4 for way in ("LowerDown", "UpperUp") for side in ("Left", "Right")
}
_TONGUE_DROP_M = 0.012  # at its tip
_TOOTH_SIGMA_M = 0.0002  # across the surface
_FULL_CHROMA = 0.12  # range of a face's sRGB channels; a photograph of less has muted colours
_BRIGHT_QUANTILE = 0.9
_USUAL_EYE_WHITE, _MIN_TOOTH_LIGHT = 0.70, 0.55
_LIP_SHADOW_RGB = np.array((30, 10, 9)) / 255
# inwards from a lip's rim, metres, and opacity; the upper lip shades more, since light comes from above
_UPPER_SHADOWS, _LOWER_SHADOWS = ((0.0000, 0.40), (0.0016, 0.18)), ((0.0000, 0.30), (0.0016, 0.12))
_SHADOW_DEPTH_M, _SHADOW_SIGMAS_M = 0.0030, (0.0020, 0.0010, 0.0001)  # behind the rim; teeth are twice as deep
_LINING_REACH_M, _LINING_MARGIN_M = 0.02, 0.0015  # around the rims; how much nearer than the skin the lining must be
_LINING_FADE_M = 0.014  # from the rim, until the lining is darkest
_MAX_RIM_RGB, _MAX_DEEP_RGB = (0.55, 0.28, 0.27), (0.12, 0.045, 0.045)  # of the lining, sRGB


def with_open_lips(mesh: RiggedMesh) -> RiggedMesh:
    """Return the mesh, first the open body's vertices, with lips that part for a tongue that is put out.

    The open body's tongueOut is meant with an open jaw: alone the tongue goes through the lower lip, and it stays
    straight. Here its tip hangs over the lip.
    """
    assert mesh.morphs is not None
    body, count = open_body(), len(mesh.vertices)
    own = np.arange(len(body.vertices))
    moved_out = mesh.morphs.dense(_TONGUE_OUT, count)
    before = mesh.vertices[own] + moved_out[own]
    parted = np.sum([share * mesh.morphs.dense(name, count) for name, share in _PARTED_LIPS.items()], axis=0)
    lip = mesh.vertices[mouth_lining().lower, 2].max()
    tongue = ~body.skin & (moved_out[own, 2] > _MIN_TONGUE_MOVE_M)
    tip_share = ((before[:, 2] - lip) / max(before[tongue, 2].max(initial=lip) - lip, 1e-6)).clip(0, 1)
    parted[own, 1] -= np.where(tongue, _TONGUE_DROP_M * tip_share**2, 0)
    moved = np.flatnonzero(np.abs(parted).max(axis=1) > 0)
    return replace(mesh, morphs=mesh.morphs.plus({_TONGUE_OUT: (moved, parted[moved])}))


def with_teeth(avatar: Avatar, mesh: RiggedMesh, count: int, photographed: int, seed: int = 0) -> Avatar:
    """Return the avatar, made on ``mesh``, with ``count`` splats of teeth, gums and lips' shadows.

    ``mesh`` has expressions. Its first vertices are the open body's; the avatar's first ``photographed`` splats come
    from the photograph.
    """
    lined, inside = _darken_lining(avatar, mesh)
    shaded = _with_lip_shadows(lined, mesh)
    furnished = with_mouth(mesh)
    teeth = furnished.parts[-1]
    light = _tooth_brightness(avatar, mesh)
    whole = add_splats(shaded, furnished, _tooth_splats(furnished, light))
    left = max(count - (len(whole.splats) - len(avatar.splats)), MIN_SPLATS)
    one, other, third = (furnished.vertices[teeth.faces[:, k]] for k in range(3))
    facing = np.cross(other - one, third - one)
    visible = ~open_face().tooth & (facing[:, 2] > _MIN_NORMAL_Z * np.linalg.norm(facing, axis=1))
    dimmed = np.rint(teeth.texture * (light, light, light, 1)).astype(np.uint8)
    gums = replace(teeth, faces=teeth.faces[visible], uv=teeth.uv[visible], texture=dimmed)
    made = merge_avatars(whole, make_avatar(replace(furnished, parts=(gums,)), left, seed, _SAMPLER))
    some = np.append(inside, np.arange(len(shaded.splats), len(made.splats)))
    return _match_saturation(made, some, photographed)


def _match_saturation(avatar: Avatar, some: NDArray[np.integer], photographed: int) -> Avatar:
    """Return the avatar with ``some`` splats, and the tongue, as unsaturated as the ``photographed`` head."""
    shapes, rgb = avatar.shapes, avatar.splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5
    head = strongest_joint(avatar.skin.joints, avatar.skin.weights) == avatar.skeleton.names.index("head")
    head[some], head[photographed:] = False, False
    if shapes is None or not head.any():
        return avatar
    colour = float(np.clip(np.quantile(np.ptp(rgb[head], axis=1), _BRIGHT_QUANTILE) / _FULL_CHROMA, 0, 1))
    if colour == 1:
        return avatar
    moved_out = (shapes.targets == shapes.names.index(_TONGUE_OUT)) & (shapes.metres[:, 2] > _MIN_TONGUE_MOVE_M)
    some = np.union1d(some, shapes.rows[moved_out])
    grey = rgb[some].mean(axis=1, keepdims=True)
    sh = avatar.splats.sh.copy()
    sh[some, 0] = (grey + colour * (rgb[some] - grey) - 0.5) / SH_C0
    return replace(avatar, splats=replace(avatar.splats, sh=sh))


@lru_cache(maxsize=1)
def _tiles() -> ToothTiles:
    face = open_face()
    return tile_teeth(face.mouth, face.faces, face.tooth, face.lower)


def _tooth_splats(furnished: RiggedMesh, light: float) -> ExtraSplats:
    """Return the teeth of a mesh of ``with_mouth`` as splats, from ``_tiles``."""
    tiles, teeth = _tiles(), furnished.parts[-1]
    first = len(furnished.faces) - len(teeth.faces)
    means = np.einsum("nk,nkc->nc", tiles.shares, furnished.vertices[teeth.faces[tiles.faces]])
    scales = np.concatenate([tiles.scales, np.full((len(means), 1), _TOOTH_SIGMA_M)], axis=1)
    means += tiles.facing * np.where(tiles.opacity < 0.9, _TOOTH_SIGMA_M, 0)[:, None]  # seams lie before the teeth
    axes, rgb = axes_along(tiles.along, tiles.facing), tiles.rgb * light
    return ExtraSplats(means, axes, scales, tiles.opacity, rgb, tiles.faces + first)


def _tooth_brightness(avatar: Avatar, mesh: RiggedMesh) -> float:
    """Return the brightness of teeth: that of the eyes' whites in the photograph."""
    ball = np.isin(
        strongest_joint(avatar.skin.joints, avatar.skin.weights), [mesh.skeleton.names.index(e) for e in EYES]
    )
    if not ball.any():
        return 1.0
    white = np.quantile((avatar.splats.sh[ball, 0] * SH_C0 + 0.5).mean(axis=1), _BRIGHT_QUANTILE)
    return float(np.clip(white / _USUAL_EYE_WHITE, _MIN_TOOTH_LIGHT, 1.0))


def _darken_lining(avatar: Avatar, mesh: RiggedMesh) -> tuple[Avatar, NDArray[np.integer]]:
    """Return the avatar with splats on the mouth's lining no lighter than it, and their indices.

    A fit paints with these splats.
    """
    lining, splats = mouth_lining(), avatar.splats
    rims = np.concatenate([lining.upper, lining.lower])
    low, high = mesh.vertices[rims].min(axis=0) - _LINING_REACH_M, mesh.vertices[rims].max(axis=0) + _LINING_REACH_M
    near = np.flatnonzero(splats.finite() & np.all((splats.means > low) & (splats.means < high), axis=1))
    box = np.all((mesh.vertices > low - _LINING_REACH_M) & (mesh.vertices < high + _LINING_REACH_M), axis=1)
    faces = mesh.faces[box[mesh.faces].all(axis=1) & (mesh.faces < len(lining.inside)).all(axis=1)]
    within = np.all(lining.inside[faces], axis=1)
    outside = faces[np.all(open_body().skin[faces], axis=1) & ~within]
    if not len(near) or not within.any() or not len(outside):
        return avatar, near[:0]
    places = splats.means[near].astype(np.float64)
    found = map_threads(lambda some: nearest_on(mesh.vertices, some, places), (faces, outside))
    (_, distance, which, bary), (_, apart, _, _) = found
    mine = within[which] & (apart > distance + _LINING_MARGIN_M)
    deep = ((bary[mine] * lining.far[faces[which[mine]]]).sum(axis=1, keepdims=True) / _LINING_FADE_M).clip(0, 1) ** 0.5
    most = np.array(_MAX_RIM_RGB) * (1 - deep) + np.array(_MAX_DEEP_RGB) * deep
    sh = splats.sh.copy()
    sh[near[mine], 0] = np.minimum(sh[near[mine], 0], (most - 0.5) / SH_C0)
    return replace(avatar, splats=replace(splats, sh=sh)), near[mine]


def _with_lip_shadows(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """Return the avatar with shadows behind the rims of its lips, which move with them and do not stretch."""
    lining, parts = mouth_lining(), []
    inside = np.flatnonzero(lining.inside[np.minimum(mesh.faces, len(lining.inside) - 1)].all(axis=1))
    for rim, rows, way in ((lining.upper, _UPPER_SHADOWS, -1), (lining.lower, _LOWER_SHADOWS, 1)):
        face = np.array([inside[np.any(mesh.faces[inside] == corner, axis=1)][0] for corner in rim])
        for deep, dark in rows:
            means = mesh.vertices[rim] + (0, way * deep, -_SHADOW_DEPTH_M)
            many = len(rim)
            axes, scales = np.tile(np.eye(3), (many, 1, 1)), np.tile(_SHADOW_SIGMAS_M, (many, 1))
            rgb = np.tile(_LIP_SHADOW_RGB, (many, 1))
            parts.append(ExtraSplats(means, axes, scales, np.full(many, dark), rgb, face))
    return unbent(add_splats(avatar, mesh, joined_splats(parts)), len(avatar.splats))
