"""glTF: avatars and static scenes round trip bit for bit; broken files."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.gltf.splats import save_gltf
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from tests.formats.scenes import (
    assert_equal,
    awkward_splats,
    edit_glb,
    glb_parts,
    load_gltf,
    random_avatar,
    random_splats,
    write_glb,
)

KHR = "KHR_gaussian_splatting"


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_splats_round_trip_bit_for_bit(tmp_path: Path, degree: int, suffix: str) -> None:
    splats = random_splats(50, degree)
    save_gltf(splats, tmp_path / f"a{suffix}")
    again = load_gltf(tmp_path / f"a{suffix}")
    assert isinstance(again, Splats)
    assert_equal(again, splats)


@pytest.mark.parametrize("influences", [1, 2, 4, 8])
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_avatar_round_trip(tmp_path: Path, influences: int, suffix: str) -> None:
    avatar = random_avatar(influences=influences, degree=1)
    save_gltf(avatar, tmp_path / f"a{suffix}")
    again = load_gltf(tmp_path / f"a{suffix}")
    assert_equal(again.splats, avatar.splats)
    assert again.skeleton.names == avatar.skeleton.names
    np.testing.assert_array_equal(again.skeleton.parents, avatar.skeleton.parents)
    np.testing.assert_allclose(again.skeleton.rest, avatar.skeleton.rest, atol=1e-14)
    np.testing.assert_array_equal(again.skeleton.inverse_bind, avatar.skeleton.inverse_bind.astype(np.float32))
    assert again.skin.influences == influences
    np.testing.assert_array_equal(again.skin.weights, avatar.skin.weights)
    np.testing.assert_array_equal(again.skin.joints, avatar.skin.joints)
    assert again.skin.lost == avatar.skin.lost
    assert again.meta == {"version": 1, **avatar.meta}


def test_avatar_of_more_than_256_joints_uses_16_bits(tmp_path: Path) -> None:
    joints = 300
    skeleton = Skeleton.from_joints(tuple(map(str, range(joints))), np.arange(-1, joints - 1), np.zeros((joints, 3)))
    skin = Skin.create([[0, 299, 255, 256]], [[0.1, 0.4, 0.3, 0.2]], joints)
    save_gltf(Avatar(random_splats(1), skeleton, skin), tmp_path / "a.glb")
    again = load_gltf(tmp_path / "a.glb")
    np.testing.assert_array_equal(again.skin.joints, skin.anchored(skeleton.parents).joints)
    np.testing.assert_array_equal(again.skeleton.parents, skeleton.parents)


def test_awkward_values_round_trip(tmp_path: Path) -> None:
    save_gltf(awkward_splats(), tmp_path / "a.glb")
    again = load_gltf(tmp_path / "a.glb")
    assert isinstance(again, Splats)
    assert_equal(again, awkward_splats())
    with pytest.raises(FormatError, match="5 of 10 splats hold NaN or infinity"):
        load_gltf(tmp_path / "a.glb", strict=True)


@pytest.mark.parametrize("count", [0, 1])
def test_none_and_one(tmp_path: Path, count: int) -> None:
    for scene in (random_splats(count, 1), random_avatar(count)):
        save_gltf(scene, tmp_path / "a.glb")
        again = load_gltf(tmp_path / "a.glb")
        assert type(again) is type(scene)
        assert len(again.splats if isinstance(again, Avatar) else again) == count


def test_viewers_without_splats_show_linear_colours(tmp_path: Path) -> None:
    """By hand: sRGB 1/2, 0 and 1 are linear 0.21404, 0 and 1; out of range is clamped, NaN is 0; alpha is opacity."""
    half, black, white = [0.5] * 3, [0.0] * 3, [1.0] * 3
    rgb = np.array([half, black, white, [-1, 2, np.nan], [0.04045, 0.25, 0.75]])
    opacities = np.array([0.25, 0, 1, 1.5, np.nan])
    quats = np.tile([1.0, 0, 0, 0], (5, 1))
    splats = Splats.create(np.zeros((5, 3)), quats, np.ones((5, 3)), opacities, rgb=rgb)
    save_gltf(splats, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    accessor = attribute(document, "COLOR_0")
    assert (accessor["componentType"], accessor["type"], accessor["normalized"]) == (5123, "VEC4", True)
    view = document["bufferViews"][accessor["bufferView"]]
    found = np.frombuffer(blob, "<u2", 20, view["byteOffset"]).reshape(5, 4)
    expected = [[14027, 14027, 14027, 16384], [0] * 4, [65535] * 4, [0, 65535, 0, 65535], [205, 3334, 34243, 0]]
    np.testing.assert_allclose(found.astype(int), expected, atol=1)


@pytest.mark.parametrize("kind", ["SCALE", "OPACITY", "SH_DEGREE_0_COEF_0"])
def test_colour_of_a_draft_is_read_and_ours_is_not(tmp_path: Path, kind: str) -> None:
    """Where opacity or colour are missing COLOR_0 stands in, as the first drafts had it; else it means nothing."""
    splats = random_splats(20)
    save_gltf(splats, tmp_path / "a.glb")

    def spoil(document: dict[str, Any]) -> None:
        attributes = document["meshes"][0]["primitives"][0]["attributes"]
        if kind == "SCALE":  # something else for COLOR_0: the positions
            attributes["COLOR_0"] = attributes["POSITION"]
        else:
            del attributes[f"{KHR}:{kind}"]

    edit_glb(tmp_path / "a.glb", spoil)
    again = load_gltf(tmp_path / "a.glb")
    for name in ("means", "scales", "quats", *(("sh",) if kind != "SH_DEGREE_0_COEF_0" else ())):
        np.testing.assert_array_equal(getattr(again, name), getattr(splats, name))
    np.testing.assert_allclose(again.opacities, splats.opacities, atol=1 / 65535 if kind == "OPACITY" else 0)


@pytest.mark.parametrize("space", ["BT.709", "BT.709-sRGB", "BT.709-srgb", None])
def test_display_colours_by_the_names_of_drafts(tmp_path: Path, space: str | None) -> None:
    save_gltf(random_splats(5), tmp_path / "a.glb")
    extension = {"kernel": "ellipse"} | ({"colorSpace": space} if space else {})
    edit_glb(tmp_path / "a.glb", put("meshes", 0, "primitives", 0, "extensions", KHR, value=extension))
    again = load_gltf(tmp_path / "a.glb")
    assert isinstance(again, Splats)
    assert_equal(again, random_splats(5))


def test_another_library_reads_the_same(tmp_path: Path) -> None:
    avatar = random_avatar()
    save_gltf(avatar, tmp_path / "a.glb")
    other = pygltflib.GLTF2.load(str(tmp_path / "a.glb"))
    attributes = other.meshes[0].primitives[0].attributes

    def column(index: int, dtype: str) -> np.ndarray:
        view = other.bufferViews[other.accessors[index].bufferView]
        at = view.byteOffset or 0
        return np.frombuffer(other.binary_blob()[at : at + view.byteLength], dtype)

    rotation = column(getattr(attributes, f"{KHR}:ROTATION"), "<f4").reshape(-1, 4)
    np.testing.assert_array_equal(rotation, avatar.splats.quats[:, [1, 2, 3, 0]])
    np.testing.assert_array_equal(column(attributes.JOINTS_0, "u1").reshape(-1, 4)[:, 0], avatar.skin.joints[:, 0])
    inverse = column(other.skins[0].inverseBindMatrices, "<f4").reshape(-1, 4, 4)  # column-major
    np.testing.assert_allclose(inverse.transpose(0, 2, 1), avatar.skeleton.inverse_bind, rtol=1e-6, atol=1e-6)
    assert [other.nodes[j].name for j in other.skins[0].joints] == list(avatar.skeleton.names)
    assert other.accessors[attributes.POSITION].min == avatar.splats.means.min(axis=0).tolist()
    assert other.extensionsUsed == [KHR, "KHR_materials_unlit"] and not other.extensionsRequired
    cones = np.random.default_rng(1).integers(-128, 128, (40, 4)).astype(np.int8)
    save_gltf(replace(avatar, splats=replace(avatar.splats, cones=cones)), tmp_path / "a.glb")
    other = pygltflib.GLTF2.load(str(tmp_path / "a.glb"))
    index = other.meshes[0].primitives[0].attributes._VISIBILITY_CONE
    np.testing.assert_array_equal(column(index, "i1").reshape(-1, 4), cones)
    accessor = other.accessors[index]
    assert (accessor.componentType, accessor.type, accessor.normalized) == (pygltflib.BYTE, "VEC4", True)
    assert all((view.byteOffset or 0) % 4 == 0 for view in other.bufferViews)


def attribute(document: dict[str, Any], name: str) -> dict[str, Any]:
    return document["accessors"][document["meshes"][0]["primitives"][0]["attributes"][name]]


def drop(name: str) -> Any:
    return lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop(name)


def put(*path: Any, value: Any) -> Any:
    def change(document: Any) -> None:
        for step in path[:-1]:
            document = document[step]
        document[path[-1]] = value

    return change


BREAKS = {
    "no position": (drop("POSITION"), "need the attributes POSITION"),
    "no scale": (drop(f"{KHR}:SCALE"), "need the attributes SCALE"),
    "no colour": (lambda d: (drop(f"{KHR}:SH_DEGREE_0_COEF_0")(d), drop("COLOR_0")(d)), "SH_DEGREE_0_COEF_0"),
    "half a degree": (drop(f"{KHR}:SH_DEGREE_1_COEF_1"), "incomplete spherical harmonics, SH_DEGREE_1_COEF_1"),
    "no weights": (drop("WEIGHTS_0"), "WEIGHTS_0"),
    "triangles": (put("meshes", 0, "primitives", 0, "mode", value=4), "POINTS primitive"),
    "no extension": (put("meshes", 0, "primitives", 0, "extensions", value={}), "none of its meshes has splats"),
    "linear colours": (
        put("meshes", 0, "primitives", 0, "extensions", KHR, "colorSpace", value="lin_rec709_display"),
        "srgb_rec709_display, not 'lin_rec709_display'",
    ),
    "linear colours of a draft": (
        put("meshes", 0, "primitives", 0, "extensions", KHR, "colorSpace", value="BT.709-linear"),
        "srgb_rec709_display, not 'BT.709-linear'",
    ),
    "compressed": (
        put("meshes", 0, "primitives", 0, "extensions", KHR, "extensions", value={f"{KHR}_compression_spz_2": {}}),
        "compressed",
    ),
    "required": (put("extensionsRequired", value=["EXT_meshopt_compression"]), "EXT_meshopt_compression"),
    "version 1": (put("asset", "version", value="1.0"), "glTF 2.0"),
    "count of text": (put("accessors", 0, "count", value="many"), r"accessors\[0\].count"),
    "count below zero": (put("accessors", 0, "count", value=-1), r"accessors\[0\].count"),
    "huge count": (put("accessors", 0, "count", value=2**50), "truncated: .*POSITION"),
    "one splat less": (put("accessors", 0, "count", value=39), "one count, found 39, 40"),
    "wrong type": (put("accessors", 0, "type", value="VEC2"), "needs type VEC3, not 'VEC2'"),
    "unknown component": (put("accessors", 0, "componentType", value=5130), "POSITION needs type"),
    "sparse": (put("accessors", 0, "sparse", value={"count": 1}), "sparse"),
    "no view": (put("accessors", 0, "bufferView", value=None), "no bufferView"),
    "view beyond": (put("accessors", 0, "bufferView", value=99), "bufferView of .* 99"),
    "offset beyond": (put("bufferViews", 0, "byteOffset", value=10**9), "truncated"),
    "accessor longer than its view": (put("bufferViews", 0, "byteLength", value=470), "its bufferView has 470"),
    "stride": (put("bufferViews", 0, "byteStride", value=4), "byteStride of 4"),
    "accessor beyond": (put("meshes", 0, "primitives", 0, "attributes", "POSITION", value=99), "accessor of .* 99"),
    "buffer beyond": (put("bufferViews", 0, "buffer", value=1), "buffer 1"),
    "buffer too long": (put("buffers", 0, "byteLength", value=10**12), "truncated: buffer 0"),
    "cycle": (put("nodes", 3, "children", value=[6]), "nodes form a cycle"),
    "own child": (put("nodes", 0, "children", value=[0]), "tree"),
    "two parents": (put("nodes", 5, "children", value=[2]), "more than one parent"),
    "child beyond": (put("nodes", 0, "children", value=[99]), "node 99"),
    "mesh beyond": (put("nodes", 0, "mesh", value=9), "mesh 9"),
    "skin beyond": (put("nodes", 0, "skin", value=9), "skin 9"),
    "scene beyond": (put("scene", value=9), "scene 9"),
    "joint beyond": (put("skins", 0, "joints", value=[1, 99]), "joint node 99"),
    "joint twice": (put("skins", 0, "joints", value=[1, 1]), "distinct"),
    "no joints": (put("skins", 0, "joints", value=[]), "distinct joint nodes"),
    "joint missing": (put("skins", 0, "joints", value=[1, 2]), "but the skeleton has 2"),
    "flat joint": (put("nodes", 1, "matrix", value=[0.0] * 16), "not a usable rig"),
    "matrix of 3": (put("nodes", 1, "matrix", value=[1, 2, 3]), r"nodes\[1\].matrix"),
}


@pytest.mark.parametrize("name", BREAKS)
def test_refuses(tmp_path: Path, name: str) -> None:
    change, message = BREAKS[name]
    path = tmp_path / "a.glb"
    save_gltf(random_avatar(degree=1), path)
    edit_glb(path, change)
    with pytest.raises(FormatError, match=message) as caught:
        load_gltf(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"glTF", "truncated"),
        (b"glTF" + bytes(16), "version 2"),
        (b"glTF\x02\0\0\0\xff\xff\xff\xffxxxxxxxxxxxx", "declares 4294967295 bytes"),
        (b"glTF\x02\0\0\0\x18\0\0\0\xff\xff\xff\x7fJSON{}  ", "JSON chunk declares"),
        (b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0XXXX{}  ", "first chunk"),
        (b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0JSON{]  ", "JSON is broken"),
        (b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0JSON{}  ", "asset.version"),
        (b"[" * 100_000, "JSON is broken"),
        (b'{"asset": {"version": "2.0", "extras": ' + b"[" * 100_000, "JSON is broken"),
        (b'{"asset": {"version": "2.0\xff"}}', "JSON is broken"),
        (b"", "JSON is broken"),
    ],
)
def test_refuses_broken_containers(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.glb").write_bytes(data)
    with pytest.raises(FormatError, match=message):
        load_gltf(tmp_path / "a.glb")


def test_broken_data_uri(tmp_path: Path) -> None:
    save_gltf(random_splats(3), tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    short = base64.b64encode(blob[:40]).decode()
    for uri in ("data:,abc", "data:x;base64", "data:x;base64,@@@@", f"data:x;base64,{short}"):
        document["buffers"][0]["uri"] = uri
        write_glb(tmp_path / "b.glb", document, b"")
        with pytest.raises(FormatError, match=r"base64|truncated"):
            load_gltf(tmp_path / "b.glb")


def test_a_small_file_cannot_become_a_huge_scene(tmp_path: Path) -> None:
    save_gltf(random_splats(2000), tmp_path / "a.glb")

    def multiply(document: dict[str, Any]) -> None:
        document["nodes"] = [{"mesh": 0}] * 10_000
        document["scenes"][0]["nodes"] = list(range(10_000))

    edit_glb(tmp_path / "a.glb", multiply)
    with pytest.raises(FormatError, match="more than 64 times"):
        load_gltf(tmp_path / "a.glb")


def test_weights_of_other_writers_are_repaired(tmp_path: Path) -> None:
    avatar = random_avatar()
    save_gltf(avatar, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    at = document["bufferViews"][attribute(document, "WEIGHTS_0")["bufferView"]]["byteOffset"]
    edited = bytearray(blob)
    edited[at : at + 32] = np.array([[1, 2, 1, 0], [np.nan, 0, 0, 0]], "<f4").tobytes()
    write_glb(tmp_path / "a.glb", document, bytes(edited))
    again = load_gltf(tmp_path / "a.glb")
    np.testing.assert_array_equal(again.skin.weights[0], [0.5, 0.25, 0.25, 0])
    assert again.skin.joints[0, 0] == avatar.skin.joints[0, 1]
    assert again.skin.repaired == 1
    np.testing.assert_allclose(again.skin.weights.sum(axis=1), 1, atol=1e-6)


def test_unnamed_and_equally_named_joints_get_names(tmp_path: Path) -> None:
    save_gltf(random_avatar(), tmp_path / "a.glb")

    def rename(document: dict[str, Any]) -> None:
        for i, name in enumerate(("hip", "hip", None, "joint_2", "hip")):
            document["nodes"][1 + i]["name"] = name

    edit_glb(tmp_path / "a.glb", rename)
    again = load_gltf(tmp_path / "a.glb")
    assert len(set(again.skeleton.names)) == 5 and again.skeleton.names[0] == "hip"


def test_nodes_between_joints_and_missing_inverse_bind(tmp_path: Path) -> None:
    save_gltf(random_avatar(), tmp_path / "a.glb")

    def change(document: dict[str, Any]) -> None:
        document["nodes"][1]["children"] = [len(document["nodes"])]
        document["nodes"].append({"children": [2], "translation": [0, 5, 0]})
        del document["skins"][0]["inverseBindMatrices"]

    edit_glb(tmp_path / "a.glb", change)
    again = load_gltf(tmp_path / "a.glb")
    assert again.skeleton.parents.tolist() == [-1, 0, 1, 1, -1]
    assert (again.skeleton.inverse_bind == np.eye(4)).all()


def test_metadata_that_is_not_json(tmp_path: Path) -> None:
    avatar = random_avatar()
    broken = Avatar(avatar.splats, avatar.skeleton, avatar.skin, {"source": object()})
    with pytest.raises(FormatError, match="metadata"):
        save_gltf(broken, tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())
