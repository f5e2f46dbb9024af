"""Gives splats of an avatar the colours of its mended textures: no stripe that looks torn, no pale palms.

python -m tools.data.mended AVATAR.glb PERSON.npz NAME OUT.glb

NAME is a recipe of persons.py. Splats stay where they are, levels and cones as well; those whose place no touch
changed keep their colour.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.authoring.importers import nearest_on
from glsplat.avatar import Avatar
from glsplat.formats.person import read_person
from glsplat.formats.registry import load_splats, save
from glsplat.meshes import RiggedMesh
from glsplat.splats import SH_C0
from tools.data.persons import PEOPLE, Recipe

Colours = Callable[[NDArray[np.intp], NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]

_CHANGED = 0.04  # of 1; a smaller difference was no touch
_AROUND = 0.012  # metres from a touched place within which splats took part of its colour


def mended(avatar: Avatar, mesh: RiggedMesh, recipe: Recipe) -> Avatar:
    """The avatar, made of ``mesh``, and its levels."""
    parts = []
    for one in mesh.parts:
        for end, touch in recipe.touches:
            if one.name.endswith(end):
                parts.append((one, replace(one, texture=touch(one.texture))))
    faces = np.concatenate([one.faces for one, _ in parts])
    uv = np.concatenate([one.uv for one, _ in parts])
    first = np.cumsum([0] + [len(one.faces) for one, _ in parts])

    def colours(which: NDArray[np.intp], bary: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        before, after = np.zeros((len(which), 3)), np.zeros((len(which), 3))
        at = np.einsum("nk,nkc->nc", bary, uv[which])
        for number, (old, new) in enumerate(parts):
            mine = (which >= first[number]) & (which < first[number + 1])
            before[mine], after[mine] = old.sample(at[mine])[:, :3], new.sample(at[mine])[:, :3]
        return before, after

    rng = np.random.default_rng(0)
    which = rng.integers(0, len(faces), 200_000)
    bary = rng.dirichlet((1, 1, 1), len(which))
    before, after = colours(which, bary)
    places = np.einsum("nk,nkc->nc", bary, mesh.vertices[faces[which]])
    places = places[np.abs(after - before).max(axis=1) > _CHANGED]
    return _coloured(avatar, mesh, faces, cKDTree(places), colours)


def _coloured(
    avatar: Avatar, mesh: RiggedMesh, faces: NDArray[np.integer], places: cKDTree, colours: Colours
) -> Avatar:
    splats = avatar.splats
    near = np.flatnonzero(np.isfinite(places.query(splats.means, distance_upper_bound=_AROUND)[0]))
    _, distance, which, bary = nearest_on(mesh.vertices, faces.astype(np.int32), splats.means[near].astype(np.float64))
    near, which, bary = near[distance < _AROUND], which[distance < _AROUND], bary[distance < _AROUND]
    _, after = colours(which, bary)
    sh = np.array(splats.sh)
    sh[near, 0] = (after - 0.5) / SH_C0
    levels = tuple(replace(one, content=_coloured(one.content, mesh, faces, places, colours)) for one in avatar.levels)
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
