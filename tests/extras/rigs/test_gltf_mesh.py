"""Textured meshes as glTF: what is written is read back, and other programs' rules give the same person."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pygltflib
import pytest
import trimesh

from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import participants_folder
from glsplat.errors import FormatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.formats.person import read_person
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import load
from glsplat.meshes import Morphs, RiggedMesh
from glsplat.skinning.pose import Pose
from tests.extras.rigs.meshes import bends, chain, coloured, corners


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("influences", [1, 4, 7])
def test_what_is_written_is_read_back(tmp_path: Path, suffix: str, influences: int) -> None:
    mesh = chain(influences)
    path = tmp_path / f"m{suffix}"
    save_gltf_mesh(mesh, path)
    again = read_gltf_person(path)
    assert again.skeleton.names == mesh.skeleton.names and np.array_equal(again.skeleton.parents, mesh.skeleton.parents)
    assert again.meta == {"source": path.name} | mesh.meta
    pose = bends(mesh)
    assert np.abs(corners(again, pose) - corners(mesh, pose)).max() < 1e-6
    for old, new in zip(mesh.parts, again.parts, strict=True):
        assert new.name == old.name and new.cutout == old.cutout
        assert np.array_equal(new.texture, old.texture) and np.abs(new.uv - old.uv).max() < 1e-6
    assert isinstance(load(path), RiggedMesh)
    first = path.read_bytes()
    save_gltf_mesh(mesh, path)
    assert path.read_bytes() == first


def test_of_ten_influences_eight_are_kept(tmp_path: Path) -> None:
    mesh = chain(10)
    save_gltf_mesh(mesh, tmp_path / "m.glb")
    again = read_gltf_person(tmp_path / "m.glb")
    least = np.sort(mesh.weights / mesh.weights.sum(axis=1, keepdims=True), axis=1)[:, :2].sum(axis=1).max()
    assert np.abs(corners(again, Pose.zero(10)) - corners(mesh, Pose.zero(10))).max() < 1e-6
    assert np.abs(again.weights.sum(axis=1) - 1).max() < 1e-6 and least < 0.15


def skinned_by_the_specification(path: Path, pose: Pose) -> np.ndarray:
    """[corners, 3] of all primitives: global joint transforms times inverse bind matrices, read by another reader."""
    file = pygltflib.GLTF2().load(str(path))
    blob = file.binary_blob()

    def array(index: int) -> np.ndarray:
        accessor = file.accessors[index]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
        kind = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}[accessor.componentType]
        start = file.bufferViews[accessor.bufferView].byteOffset
        return np.frombuffer(blob, kind, accessor.count * width, start).reshape(-1, width)

    skin = file.skins[0]
    parent = {child: index for index, node in enumerate(file.nodes) for child in node.children or []}
    world: dict[int, np.ndarray] = {}
    for number, node in enumerate(skin.joints):
        local = np.eye(4)
        local[:3, 3] = file.nodes[node].translation
        local[:3, :3] = cv2.Rodrigues(np.asarray(pose.rotations[number], float))[0]
        world[node] = world.get(parent.get(node, -1), np.eye(4)) @ local
    inverse = array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    bones = np.stack([world[node] for node in skin.joints]) @ inverse
    shown = []
    for primitive in file.meshes[0].primitives:
        attributes = primitive.attributes
        weights, joints = array(attributes.WEIGHTS_0), array(attributes.JOINTS_0)
        blended = np.einsum("vk,vkij->vij", weights.astype(float), bones[joints])
        points = np.pad(array(attributes.POSITION).astype(float), ((0, 0), (0, 1)), constant_values=1)
        shown.append(np.einsum("vij,vj->vi", blended, points)[array(primitive.indices)[:, 0], :3])
    return np.concatenate(shown)


def test_other_readers_see_the_same_person(tmp_path: Path) -> None:
    mesh, path = chain(), tmp_path / "m.glb"
    save_gltf_mesh(mesh, path)
    pose = Pose(bends(mesh).rotations)
    away = skinned_by_the_specification(path, pose) - corners(mesh, pose).reshape(-1, 3)
    assert np.abs(away).max() < 1e-6
    file = pygltflib.GLTF2().load(str(path))
    assert [file.nodes[node].name for node in file.skins[0].joints] == list(mesh.skeleton.names)
    assert [material.alphaMode or "OPAQUE" for material in file.materials] == ["OPAQUE", "MASK"]
    assert all("KHR_materials_unlit" in material.extensions for material in file.materials)
    assert file.extensionsUsed == ["KHR_materials_unlit"]
    assert file.asset.extras == {"glsplat": {"version": 1, "consent": "nobody real", "number": 7}}
    shown = trimesh.load(path)
    assert sum(len(part.faces) for part in shown.geometry.values()) == 80
    assert {part.visual.material.baseColorTexture.size for part in shown.geometry.values()} == {(64, 64), (32, 16)}


def test_large_textures_are_jpeg_and_lose_little(tmp_path: Path) -> None:
    mesh = chain()
    large = coloured(2048, 1024)
    save_gltf_mesh(replace(mesh, parts=(replace(mesh.parts[0], texture=large), mesh.parts[1])), tmp_path / "m.glb")
    images = pygltflib.GLTF2().load(str(tmp_path / "m.glb")).images
    assert [image.mimeType for image in images] == ["image/jpeg", "image/png"]
    again = read_gltf_person(tmp_path / "m.glb").parts[0].texture
    assert np.abs(again.astype(int) - large).mean() < 1.5


def test_nothing_is_left_half_written(tmp_path: Path) -> None:
    mesh, path = chain(), tmp_path / "m.glb"
    save_gltf_mesh(mesh, path)
    before = path.read_bytes()
    with pytest.raises(FormatError, match="JSON") as caught:
        save_gltf_mesh(replace(mesh, meta={"it": object()}), path)
    assert str(caught.value).startswith(str(path)) and path.read_bytes() == before
    with pytest.raises(FormatError, match=r"absent"):
        save_gltf_mesh(mesh, tmp_path / "absent" / "m.glb")
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.glb"]


@pytest.mark.parametrize("material", [3, -1, "x"])
def test_a_material_that_is_not_there(tmp_path: Path, material: object) -> None:
    path = tmp_path / "m.gltf"
    save_gltf_mesh(chain(), path)
    document = json.loads(path.read_text())
    document["meshes"][0]["primitives"][0]["material"] = material
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match="material"):
        read_gltf_person(path)


@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
def test_expressions_are_morph_targets(tmp_path: Path, name: str) -> None:
    mesh = chain()
    rows = np.array([3, 7, 20])
    offsets = np.random.default_rng(4).normal(0, 0.02, (3, 3))
    mesh = replace(mesh, morphs=Morphs.of({"eyeBlinkLeft": [(rows[:1], offsets[:1])], "jawOpen": [(rows, offsets)]}))
    save_gltf_mesh(mesh, tmp_path / name)
    found = read_gltf_person(tmp_path / name)
    assert found.morphs is not None and found.morphs.names == ("eyeBlinkLeft", "jawOpen")
    for face in ({"eyeBlinkLeft": 1.0}, {"jawOpen": 0.5}, {}):
        pose = Pose(bends(mesh).rotations, expression=face)
        assert corners(found, pose) == pytest.approx(corners(mesh, pose), abs=1e-6)


@pytest.mark.gl
def test_participants_look_the_same(tmp_path: Path) -> None:
    person = read_person(participants_folder() / "p01.npz")
    save_gltf_mesh(person, tmp_path / "p.glb")
    again = read_gltf_person(tmp_path / "p.glb")
    camera = Camera(look_at((0, 0.9, 2.6), (0, 0.9, 0)), pinhole(256, 256, fov=45), 256, 256)
    pictures = []
    for mesh in (person, again):
        with MeshTruth(mesh, size=(256, 256)) as renderer:
            pictures.append(renderer.render([camera], Pose.zero())[0].astype(int))
    assert pictures[0][..., 3].max() == 255 and np.abs(pictures[0] - pictures[1]).max() <= 2
