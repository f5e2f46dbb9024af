"""Surfaces in glTF: what is written is read, what colours are is said, and what does not fit is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats import load, save, save_gltf
from glsplat.light.surface import Surface
from glsplat.splats import Level
from tests.formats.scenes import edit_glb, glb_parts, random_avatar, random_splats
from tests.light.lit import surfaced


def same(a: Surface | None, b: Surface | None) -> None:
    assert np.array_equal(a.normals, b.normals) and np.array_equal(a.occlusion, b.occlusion)
    assert (a.shade is None) == (b.shade is None) and np.array_equal(a.shades, b.shades)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("shaded", [True, False])
@pytest.mark.parametrize("rigged", [True, False])
def test_a_round_trip_keeps_every_byte(tmp_path: Path, suffix: str, shaded: bool, rigged: bool) -> None:
    thing = surfaced(random_avatar(40) if rigged else random_splats(40, 1), 3, shaded)
    save(thing, tmp_path / f"a{suffix}")
    found: Any = load(tmp_path / f"a{suffix}")
    same(splats_of(found).surface, splats_of(thing).surface)
    note = glb_parts((tmp_path / "a.glb").read_bytes())[0]["asset"]["extras"]["glsplat"] if suffix == ".glb" else None
    assert note is None or note["colour"] == ("shaded" if shaded else "albedo")
    assert not isinstance(found, Avatar) or "colour" not in found.meta


@pytest.mark.parametrize("shaded", [(True, True), (False, True), (True, False)])
def test_levels_have_their_own(tmp_path: Path, shaded: tuple[bool, bool]) -> None:
    fine = surfaced(random_avatar(40), 1, shaded[0])
    half = replace(fine, splats=fine.splats.take(range(20)), skin=fine.skin.take(range(20)))
    coarse = surfaced(half, 2, shaded[1])
    save(replace(fine, levels=(Level(coarse, 100.0),)), tmp_path / "a.glb")
    found: Any = load(tmp_path / "a.glb")
    same(found.splats.surface, fine.splats.surface)
    same(found.levels[0].content.splats.surface, coarse.splats.surface)


def test_a_level_may_be_all_that_has_one(tmp_path: Path) -> None:
    fine = random_avatar(40)
    coarse = surfaced(replace(fine, splats=fine.splats.take(range(20)), skin=fine.skin.take(range(20))), 2)
    save(replace(fine, levels=(Level(coarse, 100.0),)), tmp_path / "a.glb")
    found: Any = load(tmp_path / "a.glb")
    same(found.levels[0].content.splats.surface, coarse.splats.surface)
    assert found.splats.surface is None


@pytest.mark.parametrize("said", ["baked", None, 3])
def test_baked_colours_are_never_lit(tmp_path: Path, said: Any) -> None:
    save(surfaced(random_avatar(10)), tmp_path / "a.glb")

    def other(gltf: dict[str, Any]) -> None:
        gltf["asset"]["extras"]["glsplat"]["colour"] = said

    edit_glb(tmp_path / "a.glb", other)
    assert splats_of(load(tmp_path / "a.glb")).surface is None  # type: ignore[arg-type]


@pytest.mark.parametrize(("key", "kind"), [("_NORMAL", 5121), ("_OCCLUSION", 5120), ("_NORMAL", 5126)])
def test_what_does_not_fit_is_refused(tmp_path: Path, key: str, kind: int) -> None:
    save_gltf(surfaced(random_splats(12, 0)), tmp_path / "a.glb")

    def wrong(gltf: dict[str, Any]) -> None:
        index = gltf["meshes"][0]["primitives"][0]["attributes"][key]
        gltf["accessors"][index]["componentType"] = kind
        if kind == 5126:
            gltf["accessors"][index]["count"] = 3

    edit_glb(tmp_path / "a.glb", wrong)
    with pytest.raises(FormatError, match=f"{key} needs 12 elements of u?int8"):
        load(tmp_path / "a.glb")
