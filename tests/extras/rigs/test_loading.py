"""Whatever a file is, one call reads it: meshes as rigged and standing glTF, OBJ with materials, person archives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import FormatError
from glsplat.formats import load, load_splats, save
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.skeleton import Skeleton
from glsplat.views import viewing_point
from tests.scenes import cloud


def corners(mesh: RiggedMesh) -> np.ndarray:
    """All triangles' corners, in an order that does not depend on the file's."""
    points = mesh.vertices[mesh.faces].reshape(-1, 3)
    return points[np.lexsort(points.round(4).T)]


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_a_standing_gltf_is_where_its_nodes_put_it(tmp_path: Path, ending: str) -> None:
    """Written by trimesh, read back by trimesh: two boxes in two places, one tinted."""
    world = trimesh.Scene()
    box = trimesh.creation.box((1, 2, 3))
    box.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=(255, 0, 0, 255))
    )
    for x in (0.0, 4.0):
        place = trimesh.transformations.euler_matrix(0.3, 0.2, x)
        place[:3, 3] = x, 1, 2
        world.add_geometry(box, transform=place)
    file = tmp_path / f"boxes.{ending}"
    if ending == "glb":
        file.write_bytes(world.export(file_type="glb"))
    else:
        for name, data in world.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(data)
        (tmp_path / "model.gltf").rename(file)
    mesh = load(file)
    assert isinstance(mesh, RiggedMesh) and len(mesh.skeleton) == 1 and len(mesh.faces) == 24
    expected = trimesh.load(file, force="scene").to_geometry().triangles.reshape(-1, 3)
    assert np.allclose(corners(mesh), expected[np.lexsort(expected.round(4).T)], atol=1e-5)
    assert mesh.parts[0].texture[0, 0].tolist() == [255, 0, 0, 255]


OBJ = """mtllib room.mtl
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl red\nf 1 2 3
usemtl tiles\nf -4/1 -2/3 -1/4\nusemtl unknown\nf 1//1 3//1 4//1\n"""


def test_obj_with_materials(tmp_path: Path) -> None:
    import cv2

    (tmp_path / "room.obj").write_text(OBJ)
    (tmp_path / "room.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl tiles\nKd 0 0 0\nmap_Kd tiles.png\nKd 0 0 1\n")
    cv2.imwrite(str(tmp_path / "tiles.png"), np.full((8, 8, 3), (0, 255, 0), np.uint8))
    mesh = load(tmp_path / "room.obj")
    assert isinstance(mesh, RiggedMesh) and [p.name for p in mesh.parts] == ["red", "tiles", "unknown"]
    assert [p.texture[0, 0].tolist()[:3] for p in mesh.parts] == [[255, 0, 0], [0, 255, 0], [200, 200, 200]]
    assert mesh.parts[1].faces.tolist() == [[0, 2, 3]] and mesh.parts[1].uv[0].tolist() == [[0, 0], [1, 1], [0, 1]]
    (tmp_path / "room.mtl").write_text("newmtl tiles\nmap_Kd ../tiles.png\n")
    with pytest.raises(FormatError, match="not beside it"):
        load(tmp_path / "room.obj")


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.obj", b"f 1 2 3\n", "not a usable OBJ"),
        ("a.obj", b"", "at least one triangle"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite vertices"),
        ("a.glb", b"glTF", "a.glb: "),
        ("a.gltf", b'{"asset": {"version": "2.0"}}', "needs triangles"),
        ("a.npz", b"nothing", "npz archive"),
        ("a.txt", b"nothing", "none of them"),
    ],
)
def test_no_items(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match=message) as caught:
        load(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name)) and "\n" not in str(caught.value)


@pytest.mark.shared
@pytest.mark.gl
@pytest.mark.parametrize(
    ("path", "joints"),
    [
        ("people/char_c_registry.npz", 55),
        ("people/open_body55.npz", 55),
        ("real/models/cesium_man.glb", 55),
        ("real/models/fox.glb", 24),
        ("real/models/kaykit_mage.glb", None),
        ("real/models/quaternius_knight.glb", None),
    ],
)
def test_real_meshes_in_a_scene(shared_data: Path, renderer_of, path: str, joints: int | None) -> None:
    mesh = load(shared_data / path)
    assert isinstance(mesh, RiggedMesh) and len(mesh.skeleton) == (joints or len(mesh.skeleton)) > 1
    scene = Scene([Item(mesh, transform=similarity((0, 1, 0), scale=0.01)), Item(cloud(50))])
    eye, target = viewing_point(mesh, 40)
    view = Camera(look_at(eye, target), pinhole(64, 64, 40), 64, 64)
    alone = renderer_of(mesh).render([view])[0]
    least = 0.02 if path.endswith("fox.glb") else 0.08  # twice as long as it is high, and seen from the front
    assert least < (alone[..., 3] > 0.5).mean() < 0.9 and alone[..., :3].max() > 0.1  # all of it, and no speck
    assert renderer_of(scene).render([view])[0].shape == (64, 64, 4)


def test_every_kind_is_what_it_is(tmp_path: Path) -> None:
    """Also without a name that says so, and from an open file."""
    (tmp_path / "one").write_text(OBJ.replace("mtllib room.mtl", "# nothing beside it"))
    (tmp_path / "s.txt").write_text('{"version": 1, "items": [{"path": "one", "scale": 2}]}')
    person = RiggedMesh(
        np.eye(3), Skeleton.from_joints(["a", "b"], [-1, 0], np.eye(3)[:2]), np.zeros((3, 1), int), np.ones((3, 1)),
        (MeshPart("a", np.array([[0, 1, 2]], np.int32), np.zeros((1, 3, 2)), np.full((4, 4, 4), 255, np.uint8)),),
    )  # fmt: skip
    save(person, tmp_path / "person.glb")
    assert isinstance(load(tmp_path / "one"), RiggedMesh)
    scene = load(tmp_path / "s.txt")
    assert isinstance(scene, Scene) and scene.items[0].transform[0, 0] == 2
    with open(tmp_path / "person.glb", "rb") as file:
        again = load(file)
    assert isinstance(again, RiggedMesh) and again.skeleton.names == ("a", "b")
    with open(tmp_path / "s.txt", "rb") as file, pytest.raises(FormatError, match="give its path"):
        load(file)
    with pytest.raises(FormatError, match=r"a\.ply: a mesh is written as \.glb or \.gltf; change the name"):
        save(person, tmp_path / "a.ply")
    with pytest.raises(FormatError, match=r"person\.glb: expected splats or an avatar, found a mesh"):
        load_splats(tmp_path / "person.glb")
