"""Make the embedded people from MakeHuman's: add expressions, eyes, teeth and lashes, mend the skin, fit splats.

python -m tools.data.persons anna PERSON.npz -o glsplat/data/people/anna.glb

``PEOPLE`` names the archive of each; docs/faces.md describes the steps.
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
from glsplat.extras.authoring.body.open_face import match_open_body, with_expressions, with_mouth
from glsplat.extras.authoring.faces.blinks import BLINK_SHAPES, closing_weight, with_blink
from glsplat.extras.authoring.faces.eyeballs import fit_eyeballs, with_eyeballs
from glsplat.extras.authoring.faces.lashes_and_hair import with_brow_hairs, with_lashes, with_strands
from glsplat.extras.authoring.faces.openings import find_openings
from glsplat.extras.authoring.finish.cones import with_cones, without_useless_cones
from glsplat.extras.authoring.finish.levels import with_levels
from glsplat.extras.authoring.geometry.nearest import nearest_on
from glsplat.extras.authoring.geometry.visibility import EYES, HEAD
from glsplat.extras.authoring.light.surfaces import with_surface
from glsplat.extras.authoring.optimize.mesh_fit import fitted_to_mesh
from glsplat.extras.authoring.optimize.splat_fit import FitConfig, fitted
from glsplat.extras.authoring.optimize.target_pictures import ViewConfig, pictures_of
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.surface import make_avatar
from glsplat.extras.formats.person import read_person
from glsplat.formats.gltf.morphs import SHORT
from glsplat.formats.registry import save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import normalised
from tools.data.lids import even_lids
from tools.data.touched import calmer, darker_palms, fair_ends, plain_sleeves, toned, without_dots

Touch = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]
SAMPLER = SamplerConfig(hand_share=0.097, head_share=0.32, face_boost=3.5, eye_boost=12.0, probe=400)
"""A third of the splats for the face, instead of a fifth: viewers look at faces."""
AT_REST = {"mouthClose": 0.035}
"""Expression that closes MakeHuman's slightly open lips."""
LEVEL_STEPS = 150
LASHES, BROWS, STRANDS = 342, 360, 2_000
"""Splats of each kind, of the 40,000; strands take what the others leave."""
AROUND_VIEWS = ViewConfig(body=30, poses=60, each=2, elevations=(-75, -40, 0, 40, 75), elevation_spread=45.0)
AROUND_STEPS, AROUND_RATE = 300, 0.6  # rate: share of a first fit's rates, as most of the body is right by then
_BENT = 0.2  # share of an axis; smaller bends of a shape are stored as none
LICENCE = "CC0-1.0; teeth of ICT-FaceKit: MIT, Copyright (c) 2020 USC Institute for Creative Technologies"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Archive and settings of one person."""

    archive: str  # file of the reference data, which is not in the repository
    iris: str
    source: str  # official MakeHuman names
    touches: tuple[tuple[str, Touch], ...] = ()  # end of a part's name, edit of its texture
    left_out: tuple[str, ...] = ("eyelashes",)  # ends of names of dropped parts
    rest: tuple[tuple[str, float], ...] = ()  # resting face; a name without a side sets both sides
    brows: tuple[float, float] = (0.0, 0.0)  # metres to raise their inner and outer ends
    lashes: float = 1.0  # length, as a factor
    white: float = 1.0  # brightness of the eyes' white, as a factor: full white glows in a dark face
    lids: float = 0.85  # weight of the surrounding skin's colour
    fair: float = 0.7  # quantile of the surrounding skin's brightness below which it counts as shade

    def resting(self) -> dict[str, float]:
        """Return the expression to bake into the mesh: MakeHuman's own faces look stern."""
        sides = {name + side: weight for name, weight in self.rest for side in ("", "Left", "Right")}
        return AT_REST | {name: weight for name, weight in sides.items() if name in ARKIT}

    def touched(self, part: MeshPart) -> MeshPart:
        """Return the part with its texture edited."""
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
    """Return the person with a moving face, and the share of the open body's blink that closes its eyes."""
    parts = [recipe.touched(part) for part in mesh.parts if not part.name.endswith(recipe.left_out)]
    mesh = replace(mesh, parts=tuple(parts))
    same, count = match_open_body(mesh), len(mesh.vertices)
    moving = with_expressions(mesh, same)
    assert moving.morphs is not None
    still = Pose(np.zeros((len(mesh.skeleton), 3)), expression=recipe.resting())
    mesh = replace(mesh, vertices=mesh.vertices + moving.morphs.moved(still, count))
    mesh = raised_brows(mesh, part_of(mesh, "eyebrow"), *recipe.brows)
    eyes = next(part.name for part in mesh.parts if "eyes" in part.name.split("/"))
    mesh = with_eyeballs(mesh, eyes, recipe.iris, white=recipe.white)
    same = np.concatenate([same, np.full(len(mesh.vertices) - count, -1)])
    mesh = with_mouth(with_expressions(mesh, same), same)
    blink = float(np.mean([closing_weight(mesh, eye) for eye in find_openings(mesh, fit_eyeballs(mesh, *EYES))]))
    return even_lids(with_blink(mesh, dict.fromkeys(BLINK_SHAPES, blink)), recipe.lids, fair=recipe.fair), blink


def raised_brows(mesh: RiggedMesh, part: MeshPart, inner: float, outer: float = 0.0) -> RiggedMesh:
    """Return the mesh with the ends of ``part`` raised by metres, at its old distance from the skin.

    Brows that slope down to the nose look angry.
    """
    skin = next(one for one in mesh.parts if one.name == "body").faces
    own = np.unique(part.faces)
    points = mesh.vertices[own]
    aside = np.abs(points[:, 0])
    share = ((aside - aside.min()) / np.ptp(aside))[:, None]
    lifted = points + (inner * (1 - share) ** 1.5 + outer * share) * np.array([0, 1.0, 0])
    before, after = (nearest_on(mesh.vertices, skin, at)[0] for at in (points, lifted))
    vertices = mesh.vertices.copy()
    vertices[own] = after + (points - before)
    return replace(mesh, vertices=vertices)


def about(recipe: Recipe, blink: float) -> dict[str, str]:
    """Return the file's notes."""
    return {
        "source": f"MakeHuman system assets: {recipe.source}",
        "body_model": "SMPL-X joints (55)",
        "consent": "synthetic person, no real likeness",
        "licence": LICENCE,
        "still face": ", ".join(f"{name} {weight:g}" for name, weight in recipe.resting().items()),
        "eyes": f"{recipe.white:g} {recipe.iris}",
        "blink": f"{blink:.4f}",
    }


def small(avatar: Avatar, density: float | None = None) -> Avatar:
    """Return the avatar quantised for a small file: weights in 255ths, rotations and moves in 32767ths.

    Drops moves of shapes below six tenths of the splat's size, or below a millimetre if that is less. In a level, drops
    moves below seven tenths of a pixel at ``density`` pixels a metre.
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
    for _ in range(4):  # rounding and normalising settle after a few turns
        quats = normalised(np.rint(quats * np.float32(32767)) / np.float32(32767))
    splats = replace(splats, quats=quats)
    return replace(avatar, splats=splats, skin=replace(skin, weights=weights), shapes=shapes, levels=levels)


def made(mesh: RiggedMesh, splats: int, steps: int, recipe: Recipe, show: Callable[[str, float], None]) -> Avatar:
    """Return an avatar of ``splats`` splats fitted to the furnished person, with lashes and strands of hair."""
    avatar = make_avatar(mesh, splats - STRANDS - BROWS - LASHES, config=SAMPLER, progress=show)
    avatar = trimmed(fitted_to_mesh(avatar, mesh, steps=steps, progress=show), mesh, recipe)
    return with_strands(avatar, mesh, part_of(mesh, "hair").name, splats - len(avatar.splats))


def fitted_around(avatar: Avatar, mesh: RiggedMesh, progress: Callable[[str, float], None]) -> Avatar:
    """Return the avatar with its body fitted once more, from above and below too, without levels and cones.

    A first fit hardly sees the upper and lower sides of stretched arms, or the crotch, so gaps in the clothes remain
    there. The head's splats stay. Deterministic.
    """
    bare = replace(avatar, levels=(), splats=replace(avatar.splats, cones=None, cones_psnr=None, surface=None))
    still = [one for one in pictures_of(mesh, 1, AROUND_VIEWS, progress) if one.pose is None or not one.pose.expression]
    usual = FitConfig()
    rates = {
        name: AROUND_RATE * getattr(usual, name) for name in ("mean_rate", "scale_rate", "turn_rate", "opacity_rate")
    }
    fit = FitConfig(
        steps=AROUND_STEPS, recycled_fraction=0.0, scale_decay=0.0, colour_rate=AROUND_RATE * usual.colour_rate, **rates
    )
    made = fitted(bare, still, 1, fit, progress)
    head = np.array([name.startswith(HEAD) for name in avatar.skeleton.names])
    kept = head[strongest_joint(avatar.skin.joints, avatar.skin.weights)]

    def mixed(new: NDArray[np.float32], old: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(kept.reshape(-1, *[1] * (new.ndim - 1)), old, new)

    new, old = made.splats, bare.splats
    splats = replace(
        old,
        means=mixed(new.means, old.means),
        quats=mixed(new.quats, old.quats),
        scales=mixed(new.scales, old.scales),
        opacities=mixed(new.opacities, old.opacities),
        sh=mixed(new.sh, old.sh),
    )
    return replace(bare, splats=splats)


def trimmed(avatar: Avatar, mesh: RiggedMesh, recipe: Recipe) -> Avatar:
    """Return the avatar with hairs on its brows, lashes, shadows under lids and catch lights."""
    avatar = with_brow_hairs(avatar, mesh, part_of(mesh, "eyebrow").name, BROWS)
    return with_lashes(avatar, mesh, find_openings(mesh, fit_eyeballs(mesh, *EYES)), length=recipe.lashes)


def part_of(mesh: RiggedMesh, word: str) -> MeshPart:
    """Return the part whose name, or a folder of it, starts with ``word``."""
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
        avatar = with_surface(without_useless_cones(with_cones(avatar, progress=show)), mesh)
    save(small(replace(avatar, meta=about(recipe, blink))), options.out)
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
