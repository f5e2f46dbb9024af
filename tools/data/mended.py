"""Gives an avatar that is fitted already what its recipe (persons.py) has learned since: without another fit.

python -m tools.data.mended AVATAR.glb PERSON.npz NAME OUT.glb [--touched top ...] [--levels 14000 7000 4500]

- Colours of mended textures (touched.py) of the parts that are named, once: of splats that lie at such a part and
  have its colours; one that lies behind them, as hair under a collar, has others.
- Whites of eyes as those of eyeballs.py, lashes and veils as those of trimmings.py.
- The face at rest, if the file does not have one: by the splats' own shapes, which then start from there.
- The surface, for light.

Levels and cones stay, unless levels are asked for.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from apps.avatar.writing import progress_bar
from glsplat.authoring.cones import with_cones
from glsplat.authoring.detail.make import with_levels
from glsplat.authoring.faces.carry import carried
from glsplat.authoring.faces.trimmings import LASH, VEIL
from glsplat.authoring.importers import nearest_on
from glsplat.authoring.light.surfaces import with_surface
from glsplat.authoring.posed import posed_splats
from glsplat.authoring.visibility import EYES
from glsplat.avatar import Avatar
from glsplat.formats.person import read_person
from glsplat.formats.registry import load_splats, save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0
from tools.data.persons import AT_REST, LEVEL_STEPS, PEOPLE, RESTING, Recipe, about, furnished, small

_AROUND, _REACH = 0.012, 0.08  # metres from the part, and from the middle of one of its triangles
_WHITE = 0.45  # of 1, from which an eye's splat is of its white
_EXACT = 0.002  # of 1: the colours of what trimmings.py adds, which no fit has changed
_LIKE, _ALIKE = 0.14, 0.4  # of 1, from the line between the dark and the bright colours of the part, which is nearest


def mended(avatar: Avatar, mesh: RiggedMesh, recipe: Recipe, touched: Sequence[str]) -> tuple[Avatar, RiggedMesh]:
    """The avatar, made of ``mesh``, and its levels, with new colours at the ``touched`` parts of the recipe; the mesh
    that the recipe makes now."""
    for end, _ in recipe.touches:
        for part in mesh.parts:
            if end in touched and part.name.endswith(end):
                avatar = _recoloured(avatar, mesh, part, recipe.touched(part))
    made = furnished(mesh, recipe)
    avatar = _with_whites(avatar, made)
    if avatar.meta.get(RESTING) != (note := about(recipe)[RESTING]):  # else it was mended before
        avatar = _rested(_with_lashes(avatar, recipe.lashes), recipe.resting())
        avatar = replace(avatar, meta=dict(avatar.meta) | {RESTING: note})
    return avatar, made


def _with_whites(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """Eyeballs whose bright splats have the colours of the mesh's: a fit makes them brighter."""
    splats, skin, names = avatar.splats, avatar.skin, avatar.skeleton.names
    strongest = np.take_along_axis(skin.joints, skin.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    sh = np.array(splats.sh)
    for part in mesh.parts:
        if part.name not in EYES:
            continue
        white = (strongest == names.index(part.name)) & ((sh[:, 0] * SH_C0 + 0.5).mean(axis=1) > _WHITE)
        near = np.flatnonzero(white)
        _, _, face, weights = nearest_on(mesh.vertices, part.faces, splats.means[near].astype(np.float64))
        sh[near, 0] = (part.sample(np.einsum("nk,nkc->nc", weights, part.uv[face]))[:, :3] - 0.5) / SH_C0
    levels = tuple(replace(one, content=_with_whites(one.content, mesh)) for one in avatar.levels)
    return replace(avatar, splats=replace(splats, sh=sh.astype(np.float32)), levels=levels)


def _with_lashes(avatar: Avatar, share: float) -> Avatar:
    """Lashes that are as much fainter and shorter, and veils under lids that do not stretch with them."""
    splats, shapes = avatar.splats, avatar.shapes
    assert shapes is not None
    rgb = splats.sh[:, 0] * SH_C0 + 0.5
    dark, veils = (np.abs(rgb - colour).max(axis=1) < _EXACT for colour in (LASH, VEIL))
    scales, opacities = np.array(splats.scales), np.array(splats.opacities)
    scales[dark] *= np.where(scales[dark] == scales[dark].max(axis=1, keepdims=True), share, 1)
    opacities[dark] *= share
    shapes = replace(shapes, bends=np.where(veils[shapes.rows][:, None, None], 0, shapes.bends))
    new = replace(splats, scales=scales, opacities=opacities)
    return replace(avatar, splats=new, shapes=shapes, levels=tuple(avatar.levels))


def _rested(avatar: Avatar, expression: Mapping[str, float]) -> Avatar:
    """The avatar with the expression as its still face; cones stay, which such moves of millimetres leave true."""
    assert avatar.shapes is not None
    expression = {
        name: weight for name, weight in expression.items() if name not in AT_REST
    }  # it was fitted with those
    posed = posed_splats(avatar, Pose(np.zeros((len(avatar.skeleton), 3)), expression=expression))
    splats = replace(avatar.splats, means=posed.means, quats=posed.quats, scales=posed.scales)
    levels = tuple(replace(one, content=_rested(one.content, expression)) for one in avatar.levels)
    return replace(avatar, splats=splats, shapes=carried(avatar.shapes, avatar.splats, splats), levels=levels)


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
    sh[near, 0] = (new.sample(np.einsum("nk,nkc->nc", weights, old.uv[face]))[:, :3] - 0.5) / SH_C0
    levels = tuple(replace(one, content=_recoloured(one.content, mesh, old, new)) for one in avatar.levels)
    return replace(avatar, splats=replace(splats, sh=sh.astype(np.float32)), levels=levels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("person", type=Path)
    parser.add_argument("name", choices=PEOPLE)
    parser.add_argument("out", type=Path)
    parser.add_argument("--touched", nargs="*", default=[])
    parser.add_argument("--levels", type=int, nargs="*", default=[], help="made anew; else those that it has stay")
    options = parser.parse_args()
    avatar = load_splats(options.avatar)
    assert isinstance(avatar, Avatar)
    avatar, mesh = mended(avatar, read_person(options.person), PEOPLE[options.name], options.touched)
    if options.levels:
        with progress_bar() as show:
            bare = replace(avatar, splats=replace(avatar.splats, surface=None), levels=())
            avatar = with_cones(with_levels(bare, options.levels, steps=LEVEL_STEPS, progress=show), progress=show)
    save(small(with_surface(avatar, mesh)), options.out)


if __name__ == "__main__":
    main()
