"""Makes the embedded people: MakeHuman's, with the open body's expressions, new eyes, teeth, lashes and a mended skin.

python -m tools.data.persons anna PERSON.npz -o glsplat/data/people/anna.glb

PEOPLE says from which archive each is made.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.cones import with_cones
from glsplat.authoring.detail.make import with_levels
from glsplat.authoring.faces.eyeballs import eyeballs, with_eyeballs
from glsplat.authoring.faces.open_face import matched, with_expressions, with_mouth
from glsplat.authoring.optimize.mesh import fitted_to_mesh
from glsplat.authoring.surface import make_avatar
from glsplat.avatar import Avatar
from glsplat.formats.person import read_person
from glsplat.formats.registry import save
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tools.data.touched import darker_palms, plain_sleeves

Touch = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]
SAMPLER = SamplerConfig(head_share=0.32, face_boost=3.5, eye_boost=12.0, probe=400)
"""Faces are what one looks at: a third of the splats instead of a fifth."""
CLOSED = {"mouthClose": 0.035}
"""What closes lips that MakeHuman leaves a little open."""
LICENCE = "CC0-1.0; teeth of ICT-FaceKit: MIT, Copyright (c) 2020 USC Institute for Creative Technologies"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How a person is made."""

    archive: str  # of the reference data, which glsplat does not have
    iris: str
    source: str  # official MakeHuman names
    touches: tuple[tuple[str, Touch], ...] = ()  # end of a part's name, and what is done to its texture
    left_out: tuple[str, ...] = ("eyelashes",)  # parts by the end of their names; lashes are splats of their own


PEOPLE = {
    "ben": Recipe(
        archive="char_c_registry.npz",
        iris="brown",
        source="hm08 body, male_casualsuit02, shoes01, short01, eyebrow001, young_darkskinned_male",
        touches=(("body", darker_palms), ("male_casualsuit02", plain_sleeves)),
    ),
    "anna": Recipe(archive="p15.npz", iris="grey", source=""),
    "chloe": Recipe(archive="p19.npz", iris="green", source=""),
}


def furnished(mesh: RiggedMesh, recipe: Recipe) -> RiggedMesh:
    """The person with all that a face needs."""
    parts = [part for part in mesh.parts if not part.name.endswith(recipe.left_out)]
    for end, touch in recipe.touches:
        parts = [replace(p, texture=touch(p.texture)) if p.name.endswith(end) else p for p in parts]
    mesh = replace(mesh, parts=tuple(parts))
    same, count = matched(mesh), len(mesh.vertices)
    closed = with_expressions(mesh, same)
    assert closed.morphs is not None
    still = Pose(np.zeros((len(mesh.skeleton), 3)), expression=CLOSED)
    mesh = replace(mesh, vertices=mesh.vertices + closed.morphs.moved(still, count))
    eyes = next(part.name for part in mesh.parts if "eyes" in part.name.split("/"))
    mesh = with_eyeballs(mesh, eyes, recipe.iris)
    same = np.concatenate([same, np.full(len(mesh.vertices) - count, -1)])
    return with_mouth(with_expressions(mesh, same), same)


def small(avatar: Avatar) -> Avatar:
    """The avatar in numbers that a file holds in 16 bits: weights in 65535ths, rotations in 32767ths."""
    skin, splats = avatar.skin, avatar.splats
    parts = skin.weights.astype(np.float64) / skin.weights.sum(axis=1, keepdims=True, dtype=np.float64) * 65535
    whole = np.floor(parts)
    rest = np.argsort(np.argsort(whole - parts, axis=1, kind="stable"), axis=1)  # largest remainders first
    whole += rest < np.rint(65535 - whole.sum(axis=1, keepdims=True))
    weights = whole.astype(np.float32) / np.float32(65535)
    quats = np.rint(splats.quats * np.float32(32767)) / np.float32(32767)
    made = replace(avatar, splats=replace(splats, quats=quats.astype(np.float32)), skin=replace(skin, weights=weights))
    return replace(made, levels=tuple(replace(one, content=small(one.content)) for one in avatar.levels))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=PEOPLE)
    parser.add_argument("person", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--splats", type=int, default=36_000)
    parser.add_argument("--steps", type=int, default=900)
    parser.add_argument("--levels", type=int, nargs="*", default=[13_000, 7_500, 4_200])
    options = parser.parse_args()
    recipe = PEOPLE[options.name]
    mesh = furnished(read_person(options.person), recipe)

    def show(stage: str, done: float) -> None:
        print(f"\r{stage[:60]:60} {done:4.0%}", end="", flush=True)

    avatar = make_avatar(mesh, options.splats, config=SAMPLER, progress=show)
    avatar = fitted_to_mesh(avatar, mesh, steps=options.steps, progress=show)
    if options.levels:
        avatar = with_levels(avatar, options.levels, progress=show)
        avatar = with_cones(avatar, progress=show)
    save(avatar, options.out)
    print(f"\n{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
