"""Shapes and surfaces in glTF: kept to the bit, plain to other readers, and hostile ones refused in a line."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats import load, save
from glsplat.formats.gltf.morphs import SHORT, shape_names
from glsplat.formats.gltf.splats import save_gltf
from glsplat.light.surface import Surface
from glsplat.skinning.shapes import Shapes
from glsplat.splats import Level, normalised
from tests.formats.scenes import assert_equal, edit_glb, glb_parts, random_avatar, random_splats, write_glb
from tests.light.lit import surfaced
from tests.skinning.faces import NAMES, expressive, random_shapes

FIELDS = ("starts", "targets", "moves", "bends", "sizes", "limits")
Document = dict[str, Any]


def assert_same_shapes(found: Avatar, wanted: Avatar) -> None:
    one, other = found.shapes, wanted.shapes
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        assert one.names == other.names
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name, strict=True)


def loaded(path: Path) -> Avatar:
    found = load(path, strict=True)
    assert isinstance(found, Avatar)
    return found


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_round_trip_is_exact(tmp_path: Path, suffix: str) -> None:
    avatar = expressive(300)
    assert avatar.shapes is not None
    limits = np.array([[-1, 1], [0, 1], [0, 2], [0, 1]])
    for shapes in (avatar.shapes, replace(avatar.shapes, limits=limits)):
        path, again = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
        save(replace(avatar, shapes=shapes), path)
        found = loaded(path)
        assert_same_shapes(found, replace(avatar, shapes=shapes))
        assert_equal(found.splats, avatar.splats)
        save(found, again)
        assert path.read_bytes() == again.read_bytes()


def test_levels_keep_theirs_or_have_none(tmp_path: Path) -> None:
    avatar = expressive(300)
    coarse, still = expressive(100), expressive(40)
    coarse = replace(coarse, skeleton=avatar.skeleton)
    still = replace(still, skeleton=avatar.skeleton, shapes=None)
    whole = replace(avatar, levels=(Level(coarse, 100.0), Level(still, 10.0)))
    save(whole, tmp_path / "a.glb")
    found = loaded(tmp_path / "a.glb")
    assert len(found.levels) == 2
    for one, other in zip(found.levels, whole.levels, strict=True):
        assert_same_shapes(one.content, other.content)


def accessor(document: Document, blob: bytes, index: int) -> np.ndarray:
    """As any viewer of morph targets reads an accessor of floats: [count, 3]."""
    found = document["accessors"][index]
    out = np.zeros((found["count"], 3))
    views = document["bufferViews"]
    if "bufferView" in found:
        start = views[found["bufferView"]].get("byteOffset", 0)
        out[:] = np.frombuffer(blob, "<f4", found["count"] * 3, start).reshape(-1, 3)
    if "sparse" in found:
        sparse = found["sparse"]
        at, values = (views[sparse[key]["bufferView"]].get("byteOffset", 0) for key in ("indices", "values"))
        code = {5123: "<u2", 5125: "<u4"}[sparse["indices"]["componentType"]]
        rows = np.frombuffer(blob, code, sparse["count"], at)
        assert (np.diff(rows.astype(np.int64)) > 0).all()  # as the specification wants them
        out[rows] = np.frombuffer(blob, "<f4", sparse["count"] * 3, values).reshape(-1, 3)
    return out


def test_viewers_of_morph_targets_show_the_same_places(tmp_path: Path) -> None:
    avatar = expressive(300)
    save(avatar, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    mesh = document["meshes"][0]
    primitive = mesh["primitives"][0]
    assert mesh["extras"]["targetNames"] == list(NAMES)
    weights = np.array([0.3, 1.0, 0.7, 0.05])
    places = accessor(document, blob, primitive["attributes"]["POSITION"])
    for weight, target in zip(weights, primitive["targets"], strict=True):
        moved = accessor(document, blob, target["POSITION"])
        places = places + weight * moved
        said = document["accessors"][target["POSITION"]]
        assert said["min"] == moved.min(axis=0).tolist() and said["max"] == moved.max(axis=0).tolist()
        assert {document["accessors"][index]["count"] for index in target.values()} == {300}
    assert avatar.shapes is not None
    assert np.abs(places - reference.expressed(avatar.splats, avatar.shapes, weights).means).max() < 1e-6


def foreign(path: Path, change: Callable[[Document, bytearray], None]) -> Path:
    """The file of an expressive avatar as another program might have changed it."""
    avatar = replace(expressive(40), shapes=random_shapes(40, seed=7))
    save(avatar, path)
    document, blob = glb_parts(path.read_bytes())
    more = bytearray(blob)
    change(document, more)
    document["buffers"][0]["byteLength"] = len(more)
    write_glb(path, document, bytes(more))
    return path


def targets_of(document: Document) -> list[dict[str, int]]:
    targets: list[dict[str, int]] = document["meshes"][0]["primitives"][0]["targets"]
    return targets


def test_plain_dense_targets_are_read(tmp_path: Path) -> None:
    """No notes of ours, no axes, dense floats: the splats move and keep their shapes."""
    wanted = np.random.default_rng(1).normal(0, 0.01, (40, 3)).astype(np.float32)

    def change(document: Document, blob: bytearray) -> None:
        view = {"buffer": 0, "byteOffset": len(blob), "byteLength": wanted.nbytes}
        blob += wanted.tobytes()
        document["bufferViews"].append(view)
        document["accessors"].append(
            {"bufferView": len(document["bufferViews"]) - 1, "componentType": 5126, "count": 40, "type": "VEC3"}
        )
        primitive = document["meshes"][0]["primitives"][0]
        primitive["targets"] = [{"POSITION": len(document["accessors"]) - 1}]
        del primitive["extras"]
        document["meshes"][0]["extras"] = {"targetNames": ["EyeBlink_L"]}

    shapes = loaded(foreign(tmp_path / "a.glb", change)).shapes
    assert shapes is not None and shapes.names == ("eyeBlinkLeft",) and not shapes.bends.any()
    assert len(shapes.targets) == 40 and shapes.metres == pytest.approx(wanted, abs=float(shapes.sizes[0]))


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("jaw_open", "Fcl_ALL_Joy"), ["jawOpen", "Fcl_ALL_Joy"]),
        (("JawOpen", "jawOpen"), ["JawOpen", "jawOpen"]),  # who has ARKit's own name keeps it
        (("JawOpen", "jaw_open"), ["jawOpen", "jaw_open"]),
        (("a", "a", ""), ["a", "a_1", "target_2"]),
        (("x" * 80, "x" * 80), ["x" * 64, "x" * 56 + "_1"]),
    ],
)
def test_names_are_arkit_s_where_they_are_known(names: tuple[str, ...], found: list[str]) -> None:
    assert shape_names(names) == found


def position(document: Document, target: int = 0) -> Document:
    """The accessor of a target's offsets."""
    return document["accessors"][targets_of(document)[target]["POSITION"]]


def offset(document: Document, part: str) -> int:
    """Where the values or indices of the second target begin."""
    view = position(document, 1)["sparse"][part]["bufferView"]
    return document["bufferViews"][view].get("byteOffset", 0)


def both_lie(document: Document, blob: bytearray) -> None:
    for accessor in document["accessors"]:
        if accessor["count"] == 40:
            accessor["count"] = 10**9
        if "sparse" in accessor:
            accessor["sparse"]["count"] = 10**9


def number(part: str, form: str, value: float) -> Callable[[Document, bytearray], None]:
    return lambda document, blob: struct.pack_into(form, blob, offset(document, part), value)


def a_splat_twice(document: Document, blob: bytearray) -> None:
    at = offset(document, "indices")
    blob[at : at + 4] = blob[at + 4 : at + 8]


def many_targets(document: Document, blob: bytearray) -> None:
    primitive = document["meshes"][0]["primitives"][0]
    primitive["targets"] = primitive["targets"] * 100


HOSTILE: dict[str, Callable[[Document, bytearray], Any]] = {
    "lying count": lambda document, _: position(document).update(count=10**9),
    "lying entries": lambda document, _: position(document)["sparse"].update(count=10**9),
    "both lie": both_lie,
    "nan": number("values", "<f", float("nan")),
    "far": number("values", "<f", 1e30),
    "no such splat": number("indices", "<I", 40),
    "a splat twice": a_splat_twice,
    "one axis": lambda document, _: targets_of(document)[0].pop("_AXIS_1"),
    "axes of floats": lambda document, _: targets_of(document)[0].update(
        dict.fromkeys(("_AXIS_0", "_AXIS_1"), targets_of(document)[0]["POSITION"])
    ),
    "many targets": many_targets,
    "unsigned": lambda document, _: position(document).update(componentType=5123),
    "no accessor": lambda document, _: targets_of(document)[0].update(POSITION=9999),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_shapes_are_refused_in_a_line(tmp_path: Path, name: str) -> None:
    path = foreign(tmp_path / "a.glb", HOSTILE[name])
    with pytest.raises(FormatError) as caught:
        load(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value) and len(str(caught.value)) < 300


@pytest.mark.parametrize("notes", [{"shape_sizes": [1, 2]}, {"shape_sizes": [1e-9] * 4}, {"shape_limits": "all"}, 7])
def test_notes_that_are_none_do_not_matter(tmp_path: Path, notes: Any) -> None:
    path = tmp_path / "a.glb"
    avatar = expressive(40)
    save(avatar, path)
    edit_glb(path, lambda document: document["meshes"][0]["primitives"][0].update(extras={"glsplat": notes}))
    shapes = loaded(path).shapes
    assert shapes.metres == pytest.approx(avatar.shapes.metres, abs=1e-7)


def test_weights_take_a_byte_each_only_where_that_loses_nothing(tmp_path: Path) -> None:
    raw = expressive(300)
    whole = np.zeros(raw.skin.weights.shape)
    whole[:, 0] = np.rint(np.linspace(130, 255, 300))
    whole[:, 1] = 255 - whole[:, 0]
    weights = whole.astype(np.float32) / np.float32(255)
    even = replace(raw, skin=replace(raw.skin, weights=weights))
    for one, code in ((even, 5121), (raw, 5126)):
        save(one, tmp_path / "a.glb")
        document, _ = glb_parts((tmp_path / "a.glb").read_bytes())
        attributes = document["meshes"][0]["primitives"][0]["attributes"]
        assert document["accessors"][attributes["WEIGHTS_0"]]["componentType"] == code
        joints = len(one.skeleton)
        assert np.array_equal(loaded(tmp_path / "a.glb").skin.dense(joints), one.skin.dense(joints))


def test_rotations_take_two_bytes_each_only_where_reading_makes_the_same_of_them(tmp_path: Path) -> None:
    raw = random_splats(500, 3)
    quats = raw.quats
    for _ in range(4):
        quats = normalised(np.rint(quats * np.float32(32767)) / np.float32(32767))
    one_off = quats.copy()
    one_off[77] = raw.quats[77]
    unknown = quats.copy()
    unknown[5], unknown[6] = np.nan, 0
    zero = quats.copy()
    zero[6] = 0
    for given, code in ((quats, 5122), (zero, 5122), (raw.quats, 5126), (one_off, 5126), (unknown, 5126)):
        splats = replace(raw, quats=given)
        save(splats, tmp_path / "a.glb")
        document, _ = glb_parts((tmp_path / "a.glb").read_bytes())
        place = document["meshes"][0]["primitives"][0]["attributes"]["KHR_gaussian_splatting:ROTATION"]
        accessor = document["accessors"][place]
        assert accessor["componentType"] == code and accessor.get("normalized", False) == (code == 5122)
        found = load(tmp_path / "a.glb")
        np.testing.assert_array_equal(found.quats, splats.quats)


def test_targets_of_others_may_be_in_any_order(tmp_path: Path) -> None:
    avatar = expressive(120)
    save(avatar, tmp_path / "a.glb")
    document, packed = glb_parts((tmp_path / "a.glb").read_bytes())
    blob = bytearray(packed)
    for target in document["meshes"][0]["primitives"][0]["targets"]:
        sparse = document["accessors"][target["POSITION"]]["sparse"]
        count = sparse["count"]
        for key, size in (("indices", 2), ("values", 12)):  # the axes keep their own order, or turn with those indices
            start = document["bufferViews"][sparse[key]["bufferView"]].get("byteOffset", 0)
            each = np.frombuffer(bytes(blob[start : start + count * size]), np.uint8).reshape(count, size)
            blob[start : start + count * size] = each[::-1].tobytes()
        own = {document["accessors"][target[name]]["sparse"]["indices"]["bufferView"] for name in target}
        if len(own) == 1:
            for name in set(target) - {"POSITION"}:
                view = document["accessors"][target[name]]["sparse"]["values"]["bufferView"]
                start = document["bufferViews"][view]["byteOffset"]
                each = np.frombuffer(bytes(blob[start : start + count * 4]), np.uint8).reshape(count, 4)
                blob[start : start + count * 4] = each[::-1].tobytes()
    write_glb(tmp_path / "b.glb", document, bytes(blob))
    assert_same_shapes(loaded(tmp_path / "b.glb"), avatar)


def test_moves_take_two_bytes_each_where_all_are_in_the_steps_of_a_short(tmp_path: Path) -> None:
    avatar = expressive(300)
    assert avatar.shapes is not None
    coarse = replace(avatar.shapes, sizes=np.full(len(avatar.shapes), SHORT))
    level = Level(replace(avatar, splats=avatar.splats.take(np.arange(90)), skin=avatar.skin.take(np.arange(90)),
                          shapes=coarse.take(np.arange(90))), 100.0)  # fmt: skip
    avatar = replace(avatar, shapes=coarse, levels=(level,))
    save(avatar, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    assert document["extensionsRequired"] == ["KHR_mesh_quantization"]
    assert document["extensionsUsed"].count("KHR_mesh_quantization") == 1
    for target in targets_of(document):
        accessor = document["accessors"][target["POSITION"]]
        assert (accessor["componentType"], accessor["type"], accessor["normalized"]) == (5122, "VEC3", True)
        view = document["bufferViews"][accessor["sparse"]["values"]["bufferView"]]
        assert view["byteLength"] == 6 * accessor["sparse"]["count"]
        values = np.frombuffer(blob, "<i2", view["byteLength"] // 2, view["byteOffset"]).reshape(-1, 3)
        assert accessor["min"] == np.minimum(values.min(axis=0), 0).tolist()  # as stored, and of zeros, too
    found = loaded(tmp_path / "a.glb")
    assert_same_shapes(found, avatar)
    assert_same_shapes(found.levels[0].content, avatar.levels[0].content)
    save(found, tmp_path / "b.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_a_shape_that_moves_nothing_leaves_no_empty_buffer_view(tmp_path: Path) -> None:
    """glTF 2.0, 5.11.2: a bufferView has at least one byte."""
    shapes = Shapes.create(("still", "mine"), 30, splats=[1], targets=[1], moves=np.ones((1, 3)))
    avatar = replace(expressive(30), shapes=shapes)
    save(avatar, tmp_path / "a.glb")
    document, _ = glb_parts((tmp_path / "a.glb").read_bytes())
    assert all(view["byteLength"] > 0 for view in document["bufferViews"])
    assert_same_shapes(loaded(tmp_path / "a.glb"), avatar)


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
