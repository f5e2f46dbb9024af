"""glTF: avatars and static scenes round trip bit for bit; node transforms, drafts, and broken files."""

from __future__ import annotations

import base64
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load_gltf, load_ply, save_gltf
from glsplat.reference import evaluate_sh, quaternion_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from glsplat.splats import SH_C0, Splats
from tests.formats.scenes import (
    assert_equal,
    awkward_splats,
    edit_glb,
    glb_parts,
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
    assert isinstance(again, Avatar)
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
    assert isinstance(again, Avatar)
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


def test_file_of_an_avatar_is_what_the_conventions_say(tmp_path: Path) -> None:
    avatar = random_avatar(influences=8, degree=1)
    save_gltf(avatar, tmp_path / "a.glb")
    document, _ = glb_parts((tmp_path / "a.glb").read_bytes())
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert primitive["extensions"][KHR] == {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    assert document["extensionsUsed"] == [KHR]
    assert set(primitive["attributes"]) == {
        *("POSITION", f"{KHR}:ROTATION", f"{KHR}:SCALE", f"{KHR}:OPACITY", f"{KHR}:SH_DEGREE_0_COEF_0"),
        *(f"{KHR}:SH_DEGREE_1_COEF_{n}" for n in range(3)),
        *("JOINTS_0", "WEIGHTS_0", "JOINTS_1", "WEIGHTS_1"),
    }
    assert document["asset"]["extras"]["glsplat"]["licence"] == "CC0"
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_array_equal(position["min"], avatar.splats.means.min(axis=0))
    roots = document["scenes"][0]["nodes"][1:]
    assert [document["nodes"][i]["name"] for i in roots] == ["rig"]  # the joints' common root
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"] if "byteOffset" in view)


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
    cones = np.random.default_rng(1).integers(-128, 128, (40, 4)).astype(np.int8)
    save_gltf(replace(avatar, splats=replace(avatar.splats, cones=cones)), tmp_path / "a.glb")
    other = pygltflib.GLTF2.load(str(tmp_path / "a.glb"))
    index = other.meshes[0].primitives[0].attributes._VISIBILITY_CONE
    np.testing.assert_array_equal(column(index, "i1").reshape(-1, 4), cones)
    accessor = other.accessors[index]
    assert (accessor.componentType, accessor.type, accessor.normalized) == (pygltflib.BYTE, "VEC4", True)
    assert all((view.byteOffset or 0) % 4 == 0 for view in other.bufferViews)


def test_skinning_of_a_loaded_avatar_moves_the_splats_alike(tmp_path: Path) -> None:
    avatar = random_avatar()
    save_gltf(avatar, tmp_path / "a.glb")
    again = load_gltf(tmp_path / "a.glb")
    assert isinstance(again, Avatar)
    turns = np.random.default_rng(5).normal(size=(5, 3))
    np.testing.assert_allclose(again.skeleton.bone_matrices(turns), avatar.skeleton.bone_matrices(turns), atol=1e-6)


# --- node transforms ------------------------------------------------------------------------------------------------


def placed(tmp_path: Path, splats: Splats, **node: Any) -> Splats:
    save_gltf(splats, tmp_path / "n.glb")
    edit_glb(tmp_path / "n.glb", lambda d: d["nodes"][0].update(node))
    out = load_gltf(tmp_path / "n.glb")
    assert isinstance(out, Splats)
    return out


def covariance(splats: Splats) -> np.ndarray:
    shapes = quaternion_matrices(splats.quats) * splats.scales[:, None, :].astype(float)
    return shapes @ shapes.transpose(0, 2, 1)


TURN = np.array(quaternion_matrices(np.array([[0.5, 0.1, -0.7, 0.3]]))[0])
MATRICES = {
    "turned, scaled, moved": 2.5 * TURN,
    "stretched": TURN @ np.diag([3.0, 0.5, 1.0]),
    "sheared": np.array([[1.0, 0.8, 0.0], [0.0, 1.0, 0.3], [0.2, 0.0, 1.0]]),
    "mirrored": np.diag([-1.0, 1.0, 1.0]) @ TURN,
}


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize("degree", [0, 3])
def test_node_matrix(tmp_path: Path, name: str, degree: int) -> None:
    splats, linear = random_splats(40, degree), MATRICES[name]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, (1, -2, 3)
    out = placed(tmp_path, splats, matrix=matrix.T.reshape(-1).tolist())
    np.testing.assert_allclose(out.means, splats.means @ linear.T + (1, -2, 3), atol=2e-6)
    expected = linear @ covariance(splats) @ linear.T
    np.testing.assert_allclose(covariance(out), expected, atol=3e-6 * np.abs(expected).max())
    np.testing.assert_allclose(np.linalg.norm(out.quats, axis=1), 1, atol=1e-6)
    # what was seen along d in the node's frame is seen along the turned d in the world
    left, _, right = np.linalg.svd(linear)
    d = np.random.default_rng(1).normal(size=(40, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    colours = evaluate_sh(splats.sh.astype(float), d, degree)
    np.testing.assert_allclose(evaluate_sh(out.sh.astype(float), d @ (left @ right).T, degree), colours, atol=1e-5)


def test_hierarchy_of_trs_nodes_and_two_instances(tmp_path: Path) -> None:
    splats = random_splats(20)
    save_gltf(splats, tmp_path / "a.glb")

    def nest(document: dict[str, Any]) -> None:
        document["nodes"] = [
            {"mesh": 0, "translation": [1, 0, 0]},
            {"children": [0, 2], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 2, 2]},
            {"mesh": 0},
            {"mesh": 0, "name": "not in the scene"},
        ]
        document["scenes"] = [{"nodes": [1]}]

    edit_glb(tmp_path / "a.glb", nest)
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats) and len(out) == 40
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(out.means[:20], 2 * (splats.means + np.array([1, 0, 0])) @ quarter.T, atol=2e-6)
    np.testing.assert_allclose(out.means[20:], 2 * splats.means @ quarter.T, atol=2e-6)
    np.testing.assert_allclose(out.scales[:20], 2 * splats.scales, rtol=1e-6)


def test_awkward_values_under_a_node_do_not_spread(tmp_path: Path) -> None:
    for linear in (2 * TURN, MATRICES["sheared"]):
        matrix = np.eye(4)
        matrix[:3, :3] = linear
        out = placed(tmp_path, awkward_splats(), matrix=matrix.T.reshape(-1).tolist())
        np.testing.assert_array_equal(np.isfinite(out.means).all(axis=1), [0, 0, *[1] * 8])
        shaped = np.isfinite(out.quats).all(axis=1) & np.isfinite(out.scales).all(axis=1)
        np.testing.assert_array_equal(shaped, [1, 1, 1, 0, 1, 1, 0, 1, 1, 1])


def test_singular_node_is_refused(tmp_path: Path) -> None:
    for node in ({"scale": [1, 0, 1]}, {"scale": [1e308, 1e308, 1e308], "translation": [1e308, 0, 0]}):
        if node["scale"][1]:
            placed(tmp_path, random_splats(3), **node)  # absurd, but invertible
            continue
        with pytest.raises(FormatError, match="can be inverted"):
            placed(tmp_path, random_splats(3), **node)


# --- other writers --------------------------------------------------------------------------------------------------


def raw_file(
    path: Path, attributes: dict[str, tuple[np.ndarray, int, bool]], extension: dict[str, Any] | None = None
) -> None:
    """A GLB as another program would write it: interleaved nothing, one view an attribute."""
    blob, views, accessors, names = b"", [], [], {}
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    for name, (array, component, normalized) in attributes.items():
        data = np.ascontiguousarray(array).tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        names[name] = len(accessors)
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array),
                          "type": kinds[array.shape[1]], "normalized": normalized})  # fmt: skip
        blob += data + bytes(-len(data) % 4)
    primitive = {"mode": 0, "attributes": names, "extensions": {KHR: extension or {}}}
    document = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(blob)}], "bufferViews": views,
                "accessors": accessors, "meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0}],
                "scenes": [{"nodes": [0]}]}  # fmt: skip
    write_glb(path, document, blob)


def test_first_drafts_with_underscores_and_colour(tmp_path: Path) -> None:
    splats = random_splats(20)
    rgba = np.clip(np.c_[splats.sh[:, 0] * SH_C0 + 0.5, splats.opacities] * 255, 0, 255).round().astype(np.uint8)
    raw_file(tmp_path / "a.glb", {
        "POSITION": (splats.means, 5126, False),
        "_ROTATION": (splats.quats[:, [1, 2, 3, 0]], 5126, False),
        "_SCALE": (splats.scales, 5126, False),
        "COLOR_0": (rgba, 5121, True),
    })  # fmt: skip
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats)
    np.testing.assert_array_equal(out.quats, splats.quats)
    np.testing.assert_array_equal(out.scales, splats.scales)
    np.testing.assert_allclose(out.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(out.sh[:, 0] * SH_C0 + 0.5, rgba[:, :3] / 255, atol=1e-6)


def test_quantised_attributes(tmp_path: Path) -> None:
    splats = random_splats(20)
    quats = np.round(splats.quats[:, [1, 2, 3, 0]] * 32767).astype("<i2")
    raw_file(tmp_path / "a.glb", {
        "POSITION": (np.arange(60).reshape(20, 3).astype("<i2"), 5122, False),
        f"{KHR}:ROTATION": (quats, 5122, True),
        f"{KHR}:SCALE": (np.full((20, 3), 7, "<u2"), 5123, False),
        f"{KHR}:OPACITY": (np.arange(0, 240, 12)[:, None].astype("u1"), 5121, True),
        f"{KHR}:SH_DEGREE_0_COEF_0": (splats.sh[:, 0], 5126, False),
    }, {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"})  # fmt: skip
    # one byte an opacity is legal in a buffer of its own
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats)
    assert out.means[3].tolist() == [9, 10, 11] and (out.scales == 7).all()
    np.testing.assert_allclose(out.opacities, np.arange(0, 240, 12) / 255, atol=1e-7)
    np.testing.assert_allclose(out.quats, splats.quats, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(out.quats, axis=1), 1, atol=1e-6)


def test_review_draft_with_logarithmic_scales(tmp_path: Path) -> None:
    splats = random_splats(20)
    attributes = {
        "POSITION": (splats.means, 5126, False),
        f"{KHR}:ROTATION": (splats.quats[:, [1, 2, 3, 0]], 5126, False),
        f"{KHR}:SCALE": (np.log(splats.scales), 5126, False),
        f"{KHR}:OPACITY": (splats.opacities[:, None], 5126, False),
        f"{KHR}:SH_DEGREE_0_COEF_0": (splats.sh[:, 0], 5126, False),
    }
    raw_file(tmp_path / "a.glb", attributes)
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats)
    np.testing.assert_allclose(out.scales, splats.scales, rtol=1e-6)


def test_interleaved_buffer_view(tmp_path: Path) -> None:
    splats = random_splats(20)
    table = np.hstack(
        [splats.means, splats.scales, splats.quats[:, [1, 2, 3, 0]], splats.opacities[:, None], splats.sh[:, 0]]
    )
    offsets = {"POSITION": (0, "VEC3"), f"{KHR}:SCALE": (12, "VEC3"), f"{KHR}:ROTATION": (24, "VEC4"),
               f"{KHR}:OPACITY": (40, "SCALAR"), f"{KHR}:SH_DEGREE_0_COEF_0": (44, "VEC3")}  # fmt: skip
    blob = table.astype("<f4").tobytes()
    primitive = {"mode": 0, "attributes": {n: i for i, n in enumerate(offsets)}, "extensions": {KHR: {}}}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(blob), "byteStride": 56}],
        "accessors": [{"bufferView": 0, "byteOffset": at, "componentType": 5126, "count": 20, "type": kind}
                      for at, kind in offsets.values()],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
    }  # fmt: skip
    write_glb(tmp_path / "a.glb", document, blob)
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats)
    assert_equal(out, splats)


def test_external_buffer_beside_the_file(tmp_path: Path) -> None:
    splats = random_splats()
    save_gltf(splats, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    (tmp_path / "sub dir").mkdir()
    (tmp_path / "sub dir" / "data.bin").write_bytes(blob)
    document["buffers"][0]["uri"] = "sub%20dir/data.bin"
    write_glb(tmp_path / "b.glb", document, b"")
    out = load_gltf(tmp_path / "b.glb")
    assert isinstance(out, Splats)
    assert_equal(out, splats)


@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "%2e%2e/secret.bin", "/etc/passwd", "file:///etc/passwd", "link.bin", "..\\secret.bin",
     "sub/../../secret.bin", "http://example.org/x.bin"],
)  # fmt: skip
def test_no_buffer_outside_the_folder(tmp_path: Path, uri: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    save_gltf(random_splats(), inner / "a.glb")
    document, blob = glb_parts((inner / "a.glb").read_bytes())
    (tmp_path / "secret.bin").write_bytes(blob)
    (inner / "link.bin").symlink_to(tmp_path / "secret.bin")
    document["buffers"][0]["uri"] = uri
    write_glb(inner / "a.glb", document, b"")
    with pytest.raises(FormatError, match="outside the file's own folder"):
        load_gltf(inner / "a.glb")


# --- broken files ---------------------------------------------------------------------------------------------------


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
    "no colour": (drop(f"{KHR}:SH_DEGREE_0_COEF_0"), "SH_DEGREE_0_COEF_0"),
    "half a degree": (drop(f"{KHR}:SH_DEGREE_1_COEF_1"), "incomplete spherical harmonics, SH_DEGREE_1_COEF_1"),
    "no weights": (drop("WEIGHTS_0"), "WEIGHTS_0"),
    "triangles": (put("meshes", 0, "primitives", 0, "mode", value=4), "POINTS primitive"),
    "no extension": (put("meshes", 0, "primitives", 0, "extensions", value={}), "none of its meshes has splats"),
    "linear colours": (
        put("meshes", 0, "primitives", 0, "extensions", KHR, "colorSpace", value="lin_rec709_display"),
        "srgb_rec709_display, not 'lin_rec709_display'",
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


def test_truncated_anywhere(tmp_path: Path) -> None:
    save_gltf(random_avatar(), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    for length in range(0, len(data), 97):
        (tmp_path / "b.glb").write_bytes(data[:length])
        with pytest.raises(FormatError):
            load_gltf(tmp_path / "b.glb")


def test_broken_data_uri(tmp_path: Path) -> None:
    save_gltf(random_splats(3), tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    for uri in (
        "data:,abc",
        "data:x;base64",
        "data:x;base64,@@@@",
        "data:x;base64," + base64.b64encode(blob[:40]).decode(),
    ):
        document["buffers"][0]["uri"] = uri
        write_glb(tmp_path / "b.glb", document, b"")
        with pytest.raises(FormatError, match=r"base64|truncated"):
            load_gltf(tmp_path / "b.glb")


def test_a_small_file_cannot_become_a_huge_scene(tmp_path: Path) -> None:
    save_gltf(random_splats(2000), tmp_path / "a.glb")

    def multiply(document: dict[str, Any]) -> None:
        document["nodes"] = [{"mesh": 0}] * 100_000
        document["scenes"][0]["nodes"] = list(range(100_000))

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
    assert isinstance(again, Avatar)
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
    assert isinstance(again, Avatar)
    assert len(set(again.skeleton.names)) == 5 and again.skeleton.names[0] == "hip"


def test_nodes_between_joints_and_missing_inverse_bind(tmp_path: Path) -> None:
    save_gltf(random_avatar(), tmp_path / "a.glb")

    def change(document: dict[str, Any]) -> None:
        document["nodes"][1]["children"] = [len(document["nodes"])]
        document["nodes"].append({"children": [2], "translation": [0, 5, 0]})
        del document["skins"][0]["inverseBindMatrices"]

    edit_glb(tmp_path / "a.glb", change)
    again = load_gltf(tmp_path / "a.glb")
    assert isinstance(again, Avatar)
    assert again.skeleton.parents.tolist() == [-1, 0, 1, 1, -1]
    assert (again.skeleton.inverse_bind == np.eye(4)).all()


def test_metadata_that_is_not_json(tmp_path: Path) -> None:
    avatar = random_avatar()
    broken = Avatar(avatar.splats, avatar.skeleton, avatar.skin, {"source": object()})
    with pytest.raises(FormatError, match="metadata"):
        save_gltf(broken, tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_an_avatar_of_40000_splats_is_small_and_quick(tmp_path: Path) -> None:
    count = 40_000
    rng = np.random.default_rng(0)
    skeleton = Skeleton.from_joints(JOINT_NAMES, PARENTS, rng.normal(size=(55, 3)))
    skin = Skin.create(rng.integers(0, 55, (count, 8)), rng.random((count, 8)), 55, 8)
    save_gltf(Avatar(random_splats(count), skeleton, skin), tmp_path / "a.glb")
    assert (tmp_path / "a.glb").stat().st_size <= 4_000_000
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        load_gltf(tmp_path / "a.glb")
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.3


@pytest.mark.shared
def test_real_scene_round_trip(shared_data: Path, tmp_path: Path) -> None:
    splats = load_ply(shared_data / "splats" / "playbot_lod6.ply")
    save_gltf(splats, tmp_path / "a.glb")
    again = load_gltf(tmp_path / "a.glb")
    assert isinstance(again, Splats)
    assert_equal(again, splats)
