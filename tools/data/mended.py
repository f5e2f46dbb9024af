"""Gives an avatar that is fitted already what its recipe (persons.py) has learned since: without a first fit.

python -m tools.data.mended AVATAR.glb PERSON.npz NAME OUT.glb [--touched top ...] [--levels 14000 7000 4500]

- Colours of mended textures (touched.py) of the parts that are named, once: of splats that lie at such a part and
  have its colours; one that lies behind them, as hair under a collar, has others.
- Irises and whites as those of eyeballs.py, the skin of lids as lids.py has it.
- What the face at rest lacks of the recipe's, and blinks that end where lids meet: by the splats' own shapes.
- Brows of hairs, lashes, veils and lights of lashes_and_hair.py, instead of those that it has.
- Corners of the mouth and teeth without dots of other colours (their splats are hardly seen by a fit).
- The body fitted from above and below, too (around.py), so that nothing shows through; the surface, and cones.

Levels are made anew, of as many splats as those that it has or as are asked for: so what is mended is in them, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from apps.avatar.writing import progress_bar
from glsplat.avatar import Avatar
from glsplat.extras.authoring.faces.blinks import BACK, BLINKS
from glsplat.extras.authoring.faces.eyeballs import eye_texture
from glsplat.extras.authoring.faces.lashes_and_hair import GLINT, LASH, STRAND, VEIL, with_strands
from glsplat.extras.authoring.finish.cones import with_cones, worth_cones
from glsplat.extras.authoring.finish.levels import with_levels
from glsplat.extras.authoring.geometry.attribute_transfer import carried
from glsplat.extras.authoring.geometry.nearest import nearest_on
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.light.surfaces import with_surface
from glsplat.extras.formats.person import read_person
from glsplat.formats.registry import load_splats, save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import SH_C0
from tools.data.around import fitted_around
from tools.data.lids import lid_corners
from tools.data.persons import (
    AT_REST,
    BLINK,
    EYES_OF,
    LEVEL_STEPS,
    PEOPLE,
    RESTING,
    Recipe,
    about,
    furnished,
    measures,
    part_of,
    small,
    trimmed,
)

_AROUND, _REACH = 0.012, 0.08  # metres from the part, and from the middle of one of its triangles
_EYE = 0.035  # metres from the middle of an eye, as far as lashes reach
_BALL = 1.1  # radii
_EXACT = 0.002  # of 1: the colours of what lashes_and_hair.py adds, which no fit has changed
_LIKE, _ALIKE = 0.14, 0.4  # of 1, from the line between the dark and the bright colours of the part, which is nearest
_DIM = 0.03  # of 1; of darker colours no ratio is taken
_BROW, _DARK, _NEEDLE = 0.005, 0.6, 5.0  # metres about brows; of the skin's light; how much longer than wide
CORNERS = ("mouthDimpleLeft", "mouthDimpleRight")
_CORNER, _NEIGHBOURS = 0.015, 7  # metres about what these move most; splats whose middle colour is taken
_LIP, _ENAMEL, _TOOTH = 0.48, 1.06, 0.001  # of red: green or blue of a lip at least, green of a tooth at most; metres
_SKIN, _OFF = 0.004, 0.3  # metres from a lid, and of 1 from its colour: what is farther is a brow or lies behind


def mended(avatar: Avatar, mesh: RiggedMesh, recipe: Recipe, touched: Sequence[str]) -> tuple[Avatar, RiggedMesh]:
    """The avatar, made of ``mesh``, without levels, with new colours at the ``touched`` parts of the recipe; the mesh
    that the recipe makes now."""
    for end, _ in recipe.touches:
        for part in mesh.parts:
            if end in touched and part.name.endswith(end):
                avatar = _recoloured(avatar, mesh, part, recipe.touched(part))
    made, blink = furnished(mesh, recipe)
    count, noted = len(avatar.splats), about(recipe, blink)
    avatar = _without(avatar, LASH, VEIL, GLINT)
    avatar = _rested(avatar, _missing(avatar.meta.get(RESTING, ""), recipe.resting()))
    avatar = _blinking(avatar, blink / float(avatar.meta.get(BLINK, "1")))
    avatar = _with_eyes(avatar, made, avatar.meta.get(EYES_OF, f"1 {recipe.iris.split()[-1]}"))
    if recipe.lids:
        avatar = _with_lids(avatar, made)
    avatar = _with_mouth(trimmed(_without_brows(avatar, made), made, recipe), made)
    return replace(_as_many(avatar, count, made), meta=dict(avatar.meta) | noted), made


def _as_many(avatar: Avatar, count: int, mesh: RiggedMesh) -> Avatar:
    """The avatar with ``count`` splats: strands of hair come or go."""
    more = len(avatar.splats) - count
    scales = np.sort(avatar.splats.scales, axis=1)
    strands = np.flatnonzero(np.isclose(scales[:, 2] / scales[:, 1], STRAND[0] / STRAND[1], rtol=1e-3))
    if more > 0:
        gone = np.random.default_rng(0).choice(strands, more, replace=False)
        return _kept(avatar, ~np.isin(np.arange(len(avatar.splats)), gone))
    return with_strands(avatar, mesh, part_of(mesh, "hair").name, -more, seed=1) if more else avatar


def _kept(avatar: Avatar, kept: NDArray[np.bool_]) -> Avatar:
    """Some of the avatar's splats, without levels, cones and surface."""
    splats = replace(avatar.splats, cones=None, surface=None).take(kept)
    shapes = None if avatar.shapes is None else avatar.shapes.take(kept)
    return replace(avatar, splats=splats, skin=avatar.skin.take(kept), shapes=shapes, levels=())


def _without(avatar: Avatar, *colours: NDArray[np.float64]) -> Avatar:
    """The avatar without the splats at its eyes that have exactly one of the ``colours``, without levels and cones."""
    rgb = avatar.splats.sh[:, 0] * SH_C0 + 0.5
    eyes = avatar.skeleton.joints[[avatar.skeleton.names.index(name) for name in EYES]]
    near = np.linalg.norm(avatar.splats.means[:, None] - eyes, axis=2).min(axis=1) < _EYE
    kept = ~(near & np.any([np.abs(rgb - colour).max(axis=1) < _EXACT for colour in colours], axis=0))
    return _kept(avatar, kept)


def _without_brows(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """The avatar without brows: without what is much darker than the skin there, and hairs."""
    brow, body = part_of(mesh, "eyebrow"), part_of(mesh, "body")
    near = np.flatnonzero(cKDTree(mesh.vertices[brow.faces].mean(axis=1)).query(avatar.splats.means)[0] < 4 * _BROW)
    means, scales = avatar.splats.means[near].astype(np.float64), np.sort(avatar.splats.scales[near], axis=1)
    distance = nearest_on(mesh.vertices, brow.faces, means)[1]
    _, _, face, weights = nearest_on(mesh.vertices, body.faces, means)
    light, skin = (one.mean(axis=1) * SH_C0 + 0.5 for one in (avatar.splats.sh[near, 0], _sampled(body, face, weights)))
    hair = (light < _DARK * skin) | (scales[:, 2] > _NEEDLE * scales[:, 1])
    gone = near[(distance < _BROW) & hair]
    return _kept(avatar, ~np.isin(np.arange(len(avatar.splats)), gone))


def _with_eyes(avatar: Avatar, mesh: RiggedMesh, before: str) -> Avatar:
    """Eyeballs with the colours of the mesh's: what a fit to those ``before`` has made of them, by both textures."""
    splats = avatar.splats
    white, iris = before.split(" ", 1)
    sh = np.array(splats.sh)
    for number, part in enumerate(one for one in mesh.parts if one.name in EYES):
        joint = avatar.skeleton.names.index(part.name)
        near = np.flatnonzero(_on_ball(avatar, part.name))
        _, _, face, weights = nearest_on(mesh.vertices, part.faces, splats.means[near].astype(np.float64))
        radius = float(np.linalg.norm(mesh.vertices[part.faces[0, 0]] - mesh.skeleton.joints[joint]))
        old = replace(part, texture=eye_texture(iris, radius, number, float(white)))
        share = [np.maximum(_sampled(one, face, weights) * SH_C0 + 0.5, _DIM) for one in (part, old)]
        sh[near, 0] = ((sh[near, 0] * SH_C0 + 0.5) * share[0] / share[1] - 0.5) / SH_C0
    return replace(avatar, splats=replace(splats, sh=sh))


def _with_lids(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """Lids whose splats have the colours of the mesh's."""
    body = part_of(mesh, "body")
    lids = body.faces[lid_corners(mesh)[body.faces].all(axis=1)]
    own = np.flatnonzero(lid_corners(mesh)[body.faces].all(axis=1))
    near = np.flatnonzero(cKDTree(mesh.vertices[lids].mean(axis=1)).query(avatar.splats.means)[0] < 4 * _SKIN)
    _, distance, face, weights = nearest_on(mesh.vertices, lids, avatar.splats.means[near].astype(np.float64))
    colours, sh = _sampled(body, own[face], weights), np.array(avatar.splats.sh)
    alike = np.abs(colours - sh[near, 0]).max(axis=1) * SH_C0 < _OFF
    ball = np.any([_on_ball(avatar, eye) for eye in EYES], axis=0)
    mine = (distance < _SKIN) & alike & ~ball[near]
    sh[near[mine], 0] = colours[mine]
    return replace(avatar, splats=replace(avatar.splats, sh=sh))


def _with_mouth(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """Corners of the mouth and teeth in their own colours: what a fit hardly sees, is bright red there or green."""
    assert mesh.morphs is not None
    means, sh, teeth = avatar.splats.means.astype(np.float64), np.array(avatar.splats.sh), part_of(mesh, "teeth")
    red, green, blue = (sh[:, 0] * SH_C0 + 0.5).T
    dots = np.maximum(green, blue) < _LIP * red
    for name in CORNERS:
        corner = mesh.vertices[np.linalg.norm(mesh.morphs.dense(name, len(mesh.vertices)), axis=1).argmax()]
        near = np.linalg.norm(means - corner, axis=1) < _CORNER
        mine, lip = np.flatnonzero(near & dots), np.flatnonzero(near & ~dots)
        sh[mine] = np.median(sh[lip[cKDTree(means[lip]).query(means[mine], k=_NEIGHBOURS)[1]]], axis=1)
    near = np.flatnonzero(cKDTree(mesh.vertices[teeth.faces].mean(axis=1)).query(means)[0] < _SKIN)
    _, distance, face, weights = nearest_on(mesh.vertices, teeth.faces, means[near])
    odd = (distance < _TOOTH) & (green > _ENAMEL * red)[near]
    sh[near[odd], 0] = _sampled(teeth, face, weights)[odd]
    return replace(avatar, splats=replace(avatar.splats, sh=sh))


def _sampled(part: MeshPart, face: NDArray[np.intp], weights: NDArray[np.float64]) -> NDArray[np.float32]:
    """[N, 3] coefficients of the part's colours at such places of its triangles."""
    colours = part.sample(np.einsum("nk,nkc->nc", weights, part.uv[face]))[:, :3]
    return np.asarray((colours - 0.5) / SH_C0, np.float32)


def _missing(note: str, wanted: Mapping[str, float]) -> dict[str, float]:
    """What a face lacks that has the expression of the ``note``, or, without one, that of all fits."""
    has = {name: float(weight) for name, weight in (one.split() for one in note.split(", ") if one)} or AT_REST
    return {name: wanted.get(name, 0.0) - has.get(name, 0.0) for name in wanted.keys() | has.keys()}


def _rested(avatar: Avatar, expression: Mapping[str, float]) -> Avatar:
    """The avatar with the expression as its still face."""
    assert avatar.shapes is not None
    limits = np.tile((-1.0, 1.0), (len(avatar.shapes), 1)).astype(np.float32)
    free = replace(avatar, shapes=replace(avatar.shapes, limits=limits))  # a face may be at rest with less of a smile
    posed = posed_splats(free, Pose(np.zeros((len(avatar.skeleton), 3)), expression=expression))
    splats = replace(avatar.splats, means=posed.means, quats=posed.quats, scales=posed.scales)
    return replace(avatar, splats=splats, shapes=carried(avatar.shapes, avatar.splats, splats))


def _blinking(avatar: Avatar, share: float) -> Avatar:
    """The avatar whose lids close by that share of what they do, and whose eyeballs give way to them."""
    shapes = avatar.shapes
    assert shapes is not None
    each = np.where([name in BLINKS for name in shapes.names], share, 1.0)[shapes.targets]
    balls = [np.flatnonzero(_on_ball(avatar, eye)) for eye in EYES]
    lids = ~np.isin(shapes.rows, np.concatenate(balls))
    rows, targets = [shapes.rows[lids]], [shapes.targets[lids].astype(np.int64)]
    for ball, name in zip(balls, BLINKS, strict=True):
        rows.append(ball)
        targets.append(np.full(len(ball), shapes.names.index(name)))
    first = sum(map(len, balls))
    moves = np.concatenate([(shapes.metres * each[:, None])[lids], np.tile(BACK, (first, 1))])
    bends = np.concatenate([(shapes.bends * BEND * each[:, None, None])[lids], np.zeros((first, 2, 3))])
    new = Shapes.create(
        shapes.names,
        shapes.splats,
        splats=np.concatenate(rows),
        targets=np.concatenate(targets),
        moves=moves,
        bends=bends,
        limits=shapes.limits,
    )
    return replace(avatar, shapes=new)


def _on_ball(avatar: Avatar, eye: str) -> NDArray[np.bool_]:
    """[N] which splats are of that eyeball."""
    joint = avatar.skeleton.names.index(eye)
    mine = strongest_joint(avatar.skin.joints, avatar.skin.weights) == joint
    away = np.linalg.norm(avatar.splats.means - avatar.skeleton.joints[joint], axis=1)
    return np.asarray(mine & (away < _BALL * np.median(away[mine])))


def _recoloured(avatar: Avatar, mesh: RiggedMesh, old: MeshPart, new: MeshPart) -> Avatar:
    splats = avatar.splats
    shown = old.sample(old.uv.mean(axis=1))[:, :3]
    bright = shown.sum(axis=1)
    low, high = (shown[one].mean(axis=0) for one in (bright < bright.mean(), bright >= bright.mean()))
    line = (high - low) / np.linalg.norm(high - low)
    off = splats.sh[:, 0] * SH_C0 + 0.5 - low
    off -= (off @ line)[:, None] * line  # a fit makes what is dark darker and what is bright brighter
    off = np.linalg.norm(off, axis=1)
    near = cKDTree(mesh.vertices[old.faces].mean(axis=1)).query(splats.means, distance_upper_bound=_REACH)[0]
    near = np.flatnonzero(np.isfinite(near) & (off < _ALIKE))
    means = splats.means[near].astype(np.float64)
    _, nearest, _, _ = nearest_on(mesh.vertices, mesh.faces.astype(np.int32), means)
    _, distance, face, weights = nearest_on(mesh.vertices, old.faces.astype(np.int32), means)
    mine = (distance < _AROUND) & ((off[near] < _LIKE) | (distance <= nearest))
    near, face, weights = near[mine], face[mine], weights[mine]
    sh = np.array(splats.sh)
    sh[near, 0] = _sampled(new, face, weights)
    return replace(avatar, splats=replace(splats, sh=sh.astype(np.float32)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("person", type=Path)
    parser.add_argument("name", choices=PEOPLE)
    parser.add_argument("out", type=Path)
    parser.add_argument("--touched", nargs="*", default=[])
    parser.add_argument("--levels", type=int, nargs="*", help="splats of each; default: those of the file's")
    options = parser.parse_args()
    found = load_splats(options.avatar)
    assert isinstance(found, Avatar)
    levels = [len(one.content.splats) for one in found.levels] if options.levels is None else options.levels
    avatar, mesh = mended(found, read_person(options.person), PEOPLE[options.name], options.touched)
    with progress_bar() as show:
        avatar = fitted_around(avatar, mesh, show)
        if levels:
            avatar = with_levels(avatar, levels, steps=LEVEL_STEPS, progress=show)
        avatar = with_surface(worth_cones(with_cones(avatar, progress=show)), mesh)
    save(small(avatar), options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB, levels", *measures(avatar), sep="\n")


if __name__ == "__main__":
    main()
