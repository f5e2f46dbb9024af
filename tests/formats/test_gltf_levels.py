"""Levels of detail in glTF (MSFT_lod): kept to the bit, out of sight of plain viewers, and broken ones are said."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load, save
from glsplat.formats.gltf.levels import MAX_LEVELS
from glsplat.formats.transform import transformed
from glsplat.splats import Level, Splats
from tests.formats.scenes import (
    assert_equal,
    avatar_with_levels,
    edit_glb,
    glb_parts,
    load_gltf,
    random_splats,
    splats_with_levels,
)

Document = dict[str, Any]


def assert_same_levels(found: Splats | Avatar, scene: Splats | Avatar) -> None:
    assert len(found.levels) == len(scene.levels)
    one: Level[Any]
    other: Level[Any]
    for one, other in zip(found.levels, scene.levels, strict=True):
        assert (one.density, one.psnr) == (other.density, other.psnr)
        mine, theirs = one.content, other.content
        if isinstance(mine, Avatar):
            np.testing.assert_array_equal(mine.skin.joints, theirs.skin.joints)
            np.testing.assert_array_equal(mine.skin.weights, theirs.skin.weights)
            assert (mine.skin.lost, mine.skin.repaired) == (theirs.skin.lost, theirs.skin.repaired)
            mine, theirs = mine.splats, theirs.splats
        assert_equal(mine, theirs)
        assert (mine.antialias, mine.cones_psnr) == (theirs.antialias, theirs.cones_psnr)
        np.testing.assert_array_equal(
            *(np.zeros(0) if s.cones is None else s.cones for s in (mine, theirs)), strict=True
        )


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("make", [avatar_with_levels, splats_with_levels])
def test_round_trip_is_exact(tmp_path: Path, make: Callable[[], Splats | Avatar], suffix: str) -> None:
    scene = make()
    save(scene, tmp_path / f"a{suffix}")
    found = load(tmp_path / f"a{suffix}", strict=True)
    assert len(scene.levels) == 3
    assert_same_levels(found, scene)
    save(scene if isinstance(scene, Avatar) else found, tmp_path / f"b{suffix}")  # a rig is solved for its joints
    assert (tmp_path / f"b{suffix}").read_bytes() == (tmp_path / f"a{suffix}").read_bytes()


def test_what_cones_keep_is_kept(tmp_path: Path) -> None:
    base = replace(random_splats(8), cones=np.full((8, 4), 5, np.int8))
    for name, psnr in (("known", 46.25), ("unknown", None)):
        path = tmp_path / f"{name}.glb"
        save(replace(base, cones_psnr=psnr), path)
        found = load(path)
        assert isinstance(found, Splats) and found.cones_psnr == psnr
        primitive = glb_parts(path.read_bytes())[0]["meshes"][0]["primitives"][0]
        assert ("extras" in primitive) is (psnr is not None)  # a file that says nothing is one of before


def test_plain_viewers_see_the_finest_alone(tmp_path: Path) -> None:
    """By the specification: the scene's nodes lead to one mesh; levels are nodes that nothing leads to."""
    scene = avatar_with_levels()
    save(scene, tmp_path / "a.glb")
    save(replace(scene, levels=()), tmp_path / "plain.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    plain, start = glb_parts((tmp_path / "plain.glb").read_bytes())
    assert blob.startswith(start) and document["scenes"] == plain["scenes"]
    assert document["nodes"][1 : len(plain["nodes"])] == plain["nodes"][1:]
    assert document["nodes"][0] == plain["nodes"][0] | {
        key: document["nodes"][0][key] for key in ("extensions", "extras")
    }
    ids = document["nodes"][0]["extensions"]["MSFT_lod"]["ids"]
    reached, waiting = set(), list(document["scenes"][0]["nodes"])
    while waiting:
        index = waiting.pop()
        reached.add(index)
        waiting += document["nodes"][index].get("children", [])
    assert ids == [len(plain["nodes"]), len(plain["nodes"]) + 1, len(plain["nodes"]) + 2] and not reached & set(ids)
    assert document["extensionsUsed"] == [*plain["extensionsUsed"], "MSFT_lod"]
    assert "extensionsRequired" not in document
    for index in ids:
        node = document["nodes"][index]
        assert node["skin"] == document["nodes"][0]["skin"] == 0
        primitive = document["meshes"][node["mesh"]]["primitives"][0]
        assert {"POSITION", "COLOR_0", "JOINTS_0", "WEIGHTS_0"} <= primitive["attributes"].keys()


def test_screen_coverage_is_of_the_sphere_around_it(tmp_path: Path) -> None:
    means = [[x, y, 0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    base = Splats.create(means, [[1, 0, 0, 0]] * 4, [[0.1] * 3] * 4, [1] * 4, rgb=[[1, 1, 1]] * 4)
    few, one = base.take([0, 1]), base.take([0])
    save(replace(base, levels=[Level(few, 900.0), Level(one, 100.0)]), tmp_path / "a.glb")
    node = glb_parts((tmp_path / "a.glb").read_bytes())[0]["nodes"][0]
    expected = np.pi * (100 * 2**0.5 / 1024) ** 2
    first, second, last = node["extras"]["MSFT_screencoverage"]
    assert first == 1 and last == 0 and second == pytest.approx(expected, rel=1e-5)


def left_out(path: Path, caplog: pytest.LogCaptureFixture) -> tuple[list[int], list[str]]:
    """Splats of the levels that are left, and what was said; strict refuses the file with the first of it."""
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        found = load(path)
    finest = found.splats if isinstance(found, Avatar) else found
    assert len(finest) == 40
    said = [record.getMessage() for record in caplog.records]
    for text in said:
        assert text.startswith(f"{path}: ") and "\n" not in text
    if said:
        with pytest.raises(FormatError) as caught:
            load_gltf(path, strict=True)
        assert str(caught.value).startswith(said[0])
    else:
        load_gltf(path, strict=True)
    sizes = [len(one.content.splats if isinstance(one.content, Avatar) else one.content) for one in found.levels]
    return sizes, [text.removeprefix(f"{path}: ") for text in said]


def level(document: Document, number: int) -> Document:
    """The node of a coarser level."""
    node: Document = document["nodes"][document["nodes"][0]["extensions"]["MSFT_lod"]["ids"][number - 1]]
    return node


def primitive(document: Document, number: int) -> Document:
    found: Document = document["meshes"][level(document, number)["mesh"]]["primitives"][0]
    return found


def attribute(document: Document, number: int, name: str) -> Document:
    found: Document = document["accessors"][primitive(document, number)["attributes"][name]]
    return found


def _ids(change: Callable[[list[Any]], Any]) -> Callable[[Document], None]:
    def edit(document: Document) -> None:
        lod = document["nodes"][0]["extensions"]["MSFT_lod"]
        lod["ids"] = change(lod["ids"])

    return edit


BROKEN: dict[str, tuple[Callable[[Document], Any], list[int], str]] = {
    "truncated": (
        lambda d: attribute(d, 2, "POSITION").update(count=15, byteOffset=10**6),
        [20, 5],
        "level of detail 2 is left out: truncated:",
    ),
    "an accessor that is not there": (
        lambda d: primitive(d, 1)["attributes"].update(POSITION=999),
        [10, 5],
        "level of detail 1 is left out: the file refers to accessor of POSITION 999",
    ),
    "no attribute": (
        lambda d: primitive(d, 3)["attributes"].pop("KHR_gaussian_splatting:SCALE"),
        [20, 10],
        "splats need the attributes SCALE",
    ),
    "a bufferView that is not there": (
        lambda d: attribute(d, 1, "KHR_gaussian_splatting:SCALE").update(bufferView=999),
        [10, 5],
        "level of detail 1 is left out: the file refers to bufferView",
    ),
    "counts differ": (
        lambda d: attribute(d, 1, "KHR_gaussian_splatting:OPACITY").update(count=19),
        [10, 5],
        "need one count, found 19, 20",
    ),
    "out of range": (
        _ids(lambda ids: [*ids, 999]),
        [20, 10, 5],
        "level of detail 4 is left out: the file refers to node",
    ),
    "negative": (_ids(lambda ids: [-1, *ids]), [20, 10, 5], "level of detail 1 is left out: there is no node -1"),
    "itself": (_ids(lambda ids: [ids[0], 0, ids[1]]), [20, 10], "level of detail 2 is left out: node 0 is the finest"),
    "twice": (_ids(lambda ids: [ids[0], ids[0], ids[1]]), [20, 10], "is another level already"),
    "a joint": (_ids(lambda ids: [1, *ids]), [20, 10, 5], "node 1 needs a mesh with one primitive of splats"),
    "no list": (_ids(lambda ids: "12"), [], "MSFT_lod needs ids"),
    "not numbers": (_ids(lambda ids: [ids[0], "x", 1.5, True]), [], "MSFT_lod needs ids"),
    "no object": (lambda d: d["nodes"][0]["extensions"].update(MSFT_lod=[7]), [], "MSFT_lod needs ids"),
    "too many": (
        _ids(lambda ids: ids + ids[:1] * 20),
        [20, 10, 5],
        f"23 levels of detail, the first {MAX_LEVELS} are read",
    ),
    "wrong order": (_ids(lambda ids: ids[::-1]), [20, 10, 5], "levels of detail are not in order"),
    "no density": (lambda d: level(d, 2).pop("extras"), [20, 5], "level of detail 2 is left out: it has no density"),
    "density of nothing": (
        lambda d: level(d, 1)["extras"]["glsplat"].update(density=0),
        [10, 5],
        "level of detail 1 is left out: it has no density",
    ),
    "density in words": (lambda d: level(d, 1)["extras"]["glsplat"].update(density="50"), [10, 5], "no density"),
    "density that rises": (
        lambda d: level(d, 3)["extras"]["glsplat"].update(density=1000),
        [20, 10],
        "level of detail 3 is left out: its density of 1000 is not below the 100",
    ),
    "more than the finest": (
        lambda d: level(d, 1).update(mesh=0),
        [10, 5],
        "level of detail 1 is left out: 40 splats, the finest has 40",
    ),
    "as many as the finer one": (
        lambda d: level(d, 2).update(mesh=level(d, 1)["mesh"]),
        [20, 5],
        "level of detail 2 is left out: 20 splats are not fewer than 20",
    ),
    "none at all": (lambda d: attribute(d, 3, "POSITION").update(count=0), [20, 10], "0 splats, the finest has 40"),
    "billions": (lambda d: attribute(d, 3, "POSITION").update(count=2**53), [20, 10], "splats, the finest has 40"),
    "no skin": (lambda d: level(d, 1).pop("skin"), [10, 5], "it has no skin, the finest has one"),
    "no mesh": (lambda d: level(d, 1).pop("mesh"), [10, 5], "needs a mesh with one primitive of splats"),
    "a mesh that is not there": (lambda d: level(d, 1).update(mesh=77), [10, 5], "the file refers to mesh 77"),
    "levels of its own": (lambda d: level(d, 1).update(extensions={"MSFT_lod": {"ids": [0]}}), [20, 10, 5], ""),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_left_out_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str) -> None:
    change, left, said = BROKEN[name]
    path = tmp_path / "a.glb"
    save(avatar_with_levels(), path)
    assert left_out(path, caplog) == ([20, 10, 5], [])
    edit_glb(path, change)
    sizes, texts = left_out(path, caplog)
    assert sizes == left
    assert any(said in text for text in texts) if said else not texts


def test_another_skeleton(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A second skin of the same joints is the same skeleton; one of others is not."""
    path = tmp_path / "a.glb"
    save(avatar_with_levels(), path)

    def copy_skin(document: Document) -> None:
        document["skins"].append(dict(document["skins"][0]))
        level(document, 1)["skin"] = 1

    edit_glb(path, copy_skin)
    assert left_out(path, caplog) == ([20, 10, 5], [])

    def fewer_joints(document: Document) -> None:
        document["skins"][1]["joints"] = document["skins"][1]["joints"][::-1]

    edit_glb(path, fewer_joints)
    sizes, (said,) = left_out(path, caplog)
    assert sizes == [10, 5] and said == "level of detail 1 is left out: it is bound to another skeleton than the finest"


def test_levels_of_others_do_not_break(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Without densities; with the coarser nodes in the scene; naming each other; of several nodes."""
    path = tmp_path / "a.glb"
    save(splats_with_levels(), path)

    def no_extras(document: Document) -> None:
        for node in document["nodes"]:
            node.pop("extras", None)
        document["scenes"][0]["nodes"] = [3, 2, 1, 0]

    edit_glb(path, no_extras)
    sizes, said = left_out(path, caplog)
    assert sizes == [] and len(said) == 3 and all("has no density" in text for text in said)

    def circle(document: Document) -> None:
        for index, node in enumerate(document["nodes"]):
            node["extensions"] = {"MSFT_lod": {"ids": [other for other in range(4) if other != index]}}
        document["scenes"][0]["nodes"] = [0, 1, 2, 3]

    edit_glb(path, circle)
    assert left_out(path, caplog)[0] == []

    def several(document: Document) -> None:
        for node in document["nodes"][1:]:
            del node["extensions"]
        document["nodes"][0]["extensions"]["MSFT_lod"]["ids"] = [3]
        document["nodes"].append({"mesh": 0})
        document["scenes"][0]["nodes"] = [0, 4]

    edit_glb(path, several)
    with caplog.at_level(logging.WARNING):
        caplog.clear()
        found = load(path)
    assert isinstance(found, Splats) and len(found) == 80 and not found.levels
    assert "the file shows 2" in caplog.text


def test_a_file_without_a_scene_shows_the_finest(tmp_path: Path) -> None:
    scene = splats_with_levels()
    path = tmp_path / "a.glb"
    save(scene, path)

    def no_scene(document: Document) -> None:
        del document["scene"], document["scenes"]

    edit_glb(path, no_scene)
    found = load(path)
    assert_equal(found if isinstance(found, Splats) else found.splats, scene)
    assert_same_levels(found, scene)


def test_levels_stand_where_the_finest_stands(tmp_path: Path) -> None:
    """A node that moves the finest moves them; of what is twice as large a metre has half the pixels."""
    scene = splats_with_levels()
    path = tmp_path / "a.glb"
    save(scene, path)

    def placed(document: Document) -> None:
        place = {"rotation": [0, 1, 0, 0], "scale": [2, 2, 2]}
        document["nodes"].append({"children": [0], "translation": [1, 2, 3]})
        document["nodes"][0] |= place
        for node in document["nodes"][1:-1]:
            node |= place
        document["scenes"][0]["nodes"] = [len(document["nodes"]) - 1]

    edit_glb(path, placed)
    found = load(path)
    matrix = np.diag([-2.0, 2, -2, 1])
    matrix[:3, 3] = 1, 2, 3
    for one, other in zip(found.levels, scene.levels, strict=True):
        assert one.density == other.density / 2
        expected = transformed(other.content, matrix)
        np.testing.assert_allclose(one.content.means, expected.means, atol=1e-5)
        np.testing.assert_allclose(one.content.scales, expected.scales, rtol=1e-5)
    edit_glb(path, lambda document: document["nodes"][1].pop("scale"))
    found = load(path)
    np.testing.assert_allclose(np.abs(found.levels[0].content.scales), scene.levels[0].content.scales, rtol=1e-5)


@pytest.mark.parametrize("value", ["45", True, 10**400, [], None])
def test_cones_psnr_that_is_no_number(tmp_path: Path, value: object) -> None:
    path = tmp_path / "a.glb"
    save(replace(random_splats(8), cones=np.full((8, 4), 5, np.int8), cones_psnr=40.0), path)

    def change(document: Document) -> None:
        document["meshes"][0]["primitives"][0]["extras"]["glsplat"]["cones_psnr"] = value

    edit_glb(path, change)
    found = load(path)
    assert isinstance(found, Splats) and found.cones_psnr is None and found.cones is not None
