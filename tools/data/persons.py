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

from apps.avatar.writing import progress_bar
from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_face import matched, with_expressions, with_mouth
from glsplat.extras.authoring.faces.blinks import BLINKS, blink_that_shuts, with_blink
from glsplat.extras.authoring.faces.eyeballs import eyeballs, with_eyeballs
from glsplat.extras.authoring.faces.lashes_and_hair import with_brow_hairs, with_lashes, with_strands
from glsplat.extras.authoring.faces.openings import openings
from glsplat.extras.authoring.finish.cones import with_cones, worth_cones
from glsplat.extras.authoring.finish.levels import with_levels
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.light.surfaces import with_surface
from glsplat.extras.authoring.optimize.mesh_fit import fitted_to_mesh
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.surface import make_avatar
from glsplat.extras.formats.person import read_person
from glsplat.formats.gltf.morphs import SHORT
from glsplat.formats.registry import save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.splats import normalised
from tools.data.around import fitted_around
from tools.data.brows import raised_brows
from tools.data.lids import even_lids
from tools.data.touched import calmer, darker_palms, fair_ends, plain_sleeves, toned, without_dots

Touch = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]
SAMPLER = SamplerConfig(hand_share=0.097, head_share=0.32, face_boost=3.5, eye_boost=12.0, probe=400)
"""Faces are what one looks at: a third of the splats instead of a fifth."""
AT_REST = {"mouthClose": 0.035}
"""What closes lips that MakeHuman leaves a little open."""
LEVEL_STEPS = 150
LASHES, BROWS, STRANDS = 342, 360, 2_000
"""Splats of those, of the 40,000; strands take what the others leave."""
RESTING = "still face"
"""Of a file's notes: the expression of MakeHuman's face that it has at rest."""
BLINK = "blink"
"""Of a file's notes: the share of the open body's blink that closes its lids."""
EYES_OF = "eyes"
"""Of a file's notes: how bright their whites are, and the colour of their irises."""
_BENT = 0.2  # of an axis; what a shape bends less stays straight in the file
LICENCE = "CC0-1.0; teeth of ICT-FaceKit: MIT, Copyright (c) 2020 USC Institute for Creative Technologies"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How a person is made."""

    archive: str  # of the reference data, which glsplat does not have
    iris: str
    source: str  # official MakeHuman names
    touches: tuple[tuple[str, Touch], ...] = ()  # end of a part's name, and what is done to its texture
    left_out: tuple[str, ...] = ("eyelashes",)  # parts by the end of their names; lashes are splats of their own
    rest: tuple[tuple[str, float], ...] = ()  # the face at rest, both sides by a name that has sides
    brows: tuple[float, float] = (0.0, 0.0)  # metres by which their inner and outer ends are raised
    lashes: float = 1.0  # how long
    white: float = 1.0  # of eyes, how bright: beside a dark face the white of a fair one shines
    lids: float = 0.85  # how far their colours become those of the skin around
    fair: float = 0.7  # of the skin around, by its light: what is less fair is taken for shade

    def resting(self) -> dict[str, float]:
        """The expression that is baked into the mesh: MakeHuman's faces look stern."""
        sides = {name + side: weight for name, weight in self.rest for side in ("", "Left", "Right")}
        return AT_REST | {name: weight for name, weight in sides.items() if name in ARKIT}

    def touched(self, part: MeshPart) -> MeshPart:
        """The part with what is done to its texture."""
        for end, touch in self.touches:
            part = replace(part, texture=touch(part.texture)) if part.name.endswith(end) else part
        return part


PEOPLE = {
    "ben": Recipe(
        archive="char_c_registry.npz",
        iris="dark brown",
        source="hm08 body, male_casualsuit02, shoes01, short01, eyebrow001, young_darkskinned_male",
        touches=(("body", darker_palms), ("male_casualsuit02", plain_sleeves)),
        rest=(("mouthSmile", 0.52), ("browInnerUp", 0.8), ("browOuterUp", 0.2), ("cheekSquint", 0.15)),
        brows=(0.003, 0.002),
        lashes=0.75,
        white=0.64,
    ),
    "anna": Recipe(
        archive="p13.npz",
        iris="blue",
        source="hm08 body, female_casualsuit01, male_casualsuit04, shoes05, long01, eyebrow002, "
        "young_lightskinned_female_diffuse",
        touches=(("top", without_dots), ("hair", fair_ends), ("eyebrows", toned((134, 106, 72), 0.8))),
        rest=(("mouthSmile", 0.45), ("browInnerUp", 0.95), ("cheekSquint", 0.15)),
        brows=(0.0055, 0.0),
        lashes=0.9,
        lids=0.0,
    ),
    "mei": Recipe(
        archive="p15.npz",
        iris="brown",
        source="hm08 body, female_casualsuit01, male_casualsuit02, shoes01, short02, eyebrow006, "
        "old_lightskinned_female_diffuse2",
        touches=(("top", calmer), ("eyebrows", toned((128, 120, 112), 1.3))),
        rest=(("mouthSmile", 0.25), ("browInnerUp", 0.2), ("cheekSquint", 0.1), ("eyeWide", 0.25)),
        lashes=0.55,
        lids=1.0,
        fair=0.85,
    ),
}


def furnished(mesh: RiggedMesh, recipe: Recipe) -> tuple[RiggedMesh, float]:
    """The person with all that a face needs; what share of the open body's blink closes its eyes."""
    parts = [recipe.touched(part) for part in mesh.parts if not part.name.endswith(recipe.left_out)]
    mesh = replace(mesh, parts=tuple(parts))
    same, count = matched(mesh), len(mesh.vertices)
    moving = with_expressions(mesh, same)
    assert moving.morphs is not None
    still = Pose(np.zeros((len(mesh.skeleton), 3)), expression=recipe.resting())
    mesh = replace(mesh, vertices=mesh.vertices + moving.morphs.moved(still, count))
    mesh = raised_brows(mesh, part_of(mesh, "eyebrow"), *recipe.brows)
    eyes = next(part.name for part in mesh.parts if "eyes" in part.name.split("/"))
    mesh = with_eyeballs(mesh, eyes, recipe.iris, white=recipe.white)
    same = np.concatenate([same, np.full(len(mesh.vertices) - count, -1)])
    mesh = with_mouth(with_expressions(mesh, same), same)
    blink = float(np.mean([blink_that_shuts(mesh, eye) for eye in openings(mesh, eyeballs(mesh, *EYES))]))
    return even_lids(with_blink(mesh, dict.fromkeys(BLINKS, blink)), recipe.lids, fair=recipe.fair), blink


def about(recipe: Recipe, blink: float) -> dict[str, str]:
    """What the file says of itself."""
    return {
        "source": f"MakeHuman system assets: {recipe.source}",
        "body_model": "SMPL-X joints (55)",
        "consent": "synthetic person, no real likeness",
        "licence": LICENCE,
        RESTING: ", ".join(f"{name} {weight:g}" for name, weight in recipe.resting().items()),
        EYES_OF: f"{recipe.white:g} {recipe.iris}",
        BLINK: f"{blink:.4f}",
    }


def small(avatar: Avatar, density: float | None = None) -> Avatar:
    """The avatar in numbers that a file holds in few bits: weights in 255ths, rotations and moves in 32767ths.

    Of shapes goes what moves a splat by less than six tenths of its size, or one millimetre, whichever is less, and of
    levels what moves less than seven tenths of a pixel where they begin, at ``density`` pixels a metre.
    """
    skin, splats = avatar.skin, avatar.splats
    parts = skin.weights.astype(np.float64) / skin.weights.sum(axis=1, keepdims=True, dtype=np.float64) * 255
    whole = np.floor(parts)
    rest = np.argsort(np.argsort(whole - parts, axis=1, kind="stable"), axis=1)  # largest remainders first
    whole += rest < np.rint(255 - whole.sum(axis=1, keepdims=True))
    weights = whole.astype(np.float32) / np.float32(255)
    shapes = avatar.shapes
    if shapes is not None:
        size = np.sort(splats.scales, axis=1)[:, 1:].mean(axis=1)[shapes.rows]
        least = 0.7 / density if density else np.clip(0.6 * size, 0.0002, 0.001)
        bends = np.where((np.abs(shapes.bends).max(axis=(1, 2)) * BEND > _BENT)[:, None, None], shapes.bends, 0)
        kept = np.linalg.norm(shapes.metres, axis=1) > least
        rows, targets = shapes.rows[kept], shapes.targets[kept].astype(np.int64)
        moves, sizes = shapes.metres[kept], np.full(len(shapes), SHORT)
        axes = bends[kept] * BEND
        names, count = shapes.names, len(splats)
        shapes = Shapes.create(names, count, splats=rows, targets=targets, moves=moves, bends=axes, sizes=sizes)
    levels = tuple(replace(level, content=small(level.content, level.density)) for level in avatar.levels)
    quats = splats.quats
    for _ in range(4):  # what is rounded is no unit, and what is made one rounds to another in one of sixty
        quats = normalised(np.rint(quats * np.float32(32767)) / np.float32(32767))
    splats = replace(splats, quats=quats)
    return replace(avatar, splats=splats, skin=replace(skin, weights=weights), shapes=shapes, levels=levels)


def made(mesh: RiggedMesh, splats: int, steps: int, recipe: Recipe, show: Callable[[str, float], None]) -> Avatar:
    """``splats`` splats fitted to the furnished person, with lashes, and strands on its hair."""
    avatar = make_avatar(mesh, splats - STRANDS - BROWS - LASHES, config=SAMPLER, progress=show)
    avatar = trimmed(fitted_to_mesh(avatar, mesh, steps=steps, progress=show), mesh, recipe)
    return with_strands(avatar, mesh, part_of(mesh, "hair").name, splats - len(avatar.splats))


def trimmed(avatar: Avatar, mesh: RiggedMesh, recipe: Recipe) -> Avatar:
    """The avatar with hairs on its brows, lashes, shadows under lids and lights in the eyes."""
    avatar = with_brow_hairs(avatar, mesh, part_of(mesh, "eyebrow").name, BROWS)
    return with_lashes(avatar, mesh, openings(mesh, eyeballs(mesh, *EYES)), length=recipe.lashes)


def measures(avatar: Avatar) -> list[str]:
    """A line for the cones and for each level: what they keep."""
    kept = [(avatar.splats, "")] + [(one.content.splats, f", {one.psnr:.1f} dB up to {one.density:.0f} px/m")
                                    for one in avatar.levels]  # fmt: skip
    return [f"{len(splats)} splats{level}, {splats.cones_psnr} dB without what is hidden" for splats, level in kept]


def part_of(mesh: RiggedMesh, word: str) -> MeshPart:
    """The part whose name, or one of its path, begins so."""
    return next(part for part in mesh.parts if any(one.startswith(word) for one in part.name.split("/")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=PEOPLE)
    parser.add_argument("person", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--splats", type=int, default=40_000)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--levels", type=int, nargs="*", default=[14_000, 7_000, 4_500])
    parser.add_argument("--level-steps", type=int, default=LEVEL_STEPS)
    options = parser.parse_args()
    recipe = PEOPLE[options.name]
    mesh, blink = furnished(read_person(options.person), recipe)
    with progress_bar() as show:
        avatar = made(mesh, options.splats, options.steps, recipe, show)
        avatar = fitted_around(avatar, mesh, show)
        if options.levels:
            avatar = with_levels(avatar, options.levels, steps=options.level_steps, progress=show)
        avatar = with_surface(worth_cones(with_cones(avatar, progress=show)), mesh)
    save(small(replace(avatar, meta=about(recipe, blink))), options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
