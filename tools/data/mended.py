"""Gives splats of an avatar that is fitted already the colours of its mended textures (touched.py).

python -m tools.data.mended AVATAR.glb PERSON.npz NAME OUT.glb

NAME is a recipe of persons.py. Splats stay where they are, levels and cones as well. Those are recoloured that lie at
a part whose texture is mended, and have its colours: one that lies behind them, as hair under a collar, has others.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from glsplat.authoring.importers import nearest_on
from glsplat.avatar import Avatar
from glsplat.formats.person import read_person
from glsplat.formats.registry import load_splats, save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.splats import SH_C0
from tools.data.persons import PEOPLE, Recipe

_AROUND, _REACH = 0.012, 0.08  # metres from the part, and from the middle of one of its triangles
_LIKE, _ALIKE = 0.14, 0.4  # of 1, from the line between the dark and the bright colours of the part, which is nearest


def mended(avatar: Avatar, mesh: RiggedMesh, recipe: Recipe) -> Avatar:
    """The avatar, made of ``mesh``, and its levels."""
    for end, _ in recipe.touches:
        for part in mesh.parts:
            if part.name.endswith(end):
                avatar = _recoloured(avatar, mesh, part, recipe.touched(part))
    return avatar


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
    options = parser.parse_args()
    avatar = load_splats(options.avatar)
    assert isinstance(avatar, Avatar)
    save(mended(avatar, read_person(options.person), PEOPLE[options.name]), options.out)


if __name__ == "__main__":
    main()
