"""What is no part of a person is left out by name and count: props, lines and points, other scenes, animations."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.formats import load
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.rigs.gltf.built import FAMILIES, Family, build
from tests.formats.scenes import glb_parts, write_glb

PERSON = replace(FAMILIES["VRM 0.x"], backwards=False, vrm=None, more={})


def triangle(document: dict[str, Any], blob: bytearray, points: np.ndarray, **primitive: Any) -> int:
    """A mesh of its own; returns its index."""
    raw = points.astype("<f4").tobytes()
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(raw)})
    blob += raw
    view = len(document["bufferViews"]) - 1
    document["accessors"].append({"bufferView": view, "componentType": 5126, "count": len(points), "type": "VEC3"})
    attributes = {"POSITION": len(document["accessors"]) - 1}
    document["meshes"].append({"primitives": [{"attributes": attributes, **primitive}]})
    return len(document["meshes"]) - 1


def shown(document: dict[str, Any], mesh: int, name: str, parent: str | None = None, scene: bool = True) -> None:
    document["nodes"].append({"mesh": mesh, "name": name})
    node = len(document["nodes"]) - 1
    if parent is not None:
        above = next(n for n in document["nodes"] if n.get("name") == parent)
        above.setdefault("children", []).append(node)
    elif scene:
        document["scenes"][0]["nodes"].append(node)


FLOOR = np.array([[-9, 0, -9], [9, 0, 9], [9, 0, -9]], float)
CUBE = np.array([[3, 0, 0], [3, 1, 0], [3, 0, 1]], float)
GLASSES = np.array([[-0.1, 1.5, 0.1], [0.1, 1.5, 0.1], [0, 1.6, 0.1]])
SWORD = np.array([[0, 0, 0], [2, 0, 0], [0, 0.1, 0]], float)


def read(
    tmp_path: Path, change: Callable[[dict[str, Any], bytearray], None], how: Any = read_gltf_person,
    family: Family = PERSON,
) -> RiggedMesh:  # fmt: skip
    """The built person with another JSON, and more bytes behind its own."""
    path = tmp_path / "person.glb"
    document, packed = glb_parts(build(family).data)
    blob = bytearray(packed)
    change(document, blob)
    blob += bytes(-len(blob) % 4)
    document["buffers"][0]["byteLength"] = len(blob)
    write_glb(path, document, bytes(blob))
    return how(path)


def test_props_of_the_scene_stay_out_and_what_a_joint_carries_stays(tmp_path: Path) -> None:
    def props(document: dict[str, Any], blob: bytearray) -> None:
        shown(document, triangle(document, blob, FLOOR), "Floor")
        shown(document, triangle(document, blob, CUBE), "Cube")
        shown(document, triangle(document, blob, GLASSES), "Glasses", "Armature")
        shown(document, triangle(document, blob, SWORD), "Sword", "J_Bip_R_Hand")

    mesh, alone = read(tmp_path, props), read(tmp_path, lambda document, blob: None)
    assert mesh.meta["left_out"] == ["2 meshes beside the person are left out (Floor, Cube)"]
    assert "left_out" not in alone.meta
    assert len(mesh.parts) == len(alone.parts) + 2  # glasses lie on the body, the sword hangs from a hand
    size = [np.ptp(m.posed(Pose.zero())[:, 1]) for m in (mesh, alone)]
    assert size[0] == pytest.approx(size[1])
    assert mesh.posed(Pose.zero())[:, 1].min() == pytest.approx(0, abs=1e-9)
    on = {JOINT_NAMES[int(mesh.joints[part.faces[0, 0], 0])] for part in mesh.parts if len(part.faces) == 1}
    assert on == {"head", "right_wrist"}


def test_a_thing_keeps_all_that_stands_beside_it(tmp_path: Path) -> None:
    def nobody(document: dict[str, Any], blob: bytearray) -> None:
        for number, node in enumerate(document["nodes"]):
            node["name"] = f"n{number}"
        shown(document, triangle(document, blob, FLOOR), "Floor")

    lame = replace(PERSON, names={joint: name for joint, name in PERSON.names.items() if joint != "left_knee"})
    assert len(read(tmp_path, nobody, family=lame).parts) == 2


def test_lines_points_scenes_and_animations(tmp_path: Path) -> None:
    def more(document: dict[str, Any], blob: bytearray) -> None:
        for mode, name in ((0, "Dots"), (1, "Wire"), (3, "Strip")):
            shown(document, triangle(document, blob, GLASSES, mode=mode), name, "Armature")
        shown(document, triangle(document, blob, GLASSES), "Spare", scene=False)
        document["animations"] = [{"name": name, "channels": [], "samplers": []} for name in ("Walk", "Run", "Sit")]
        document["animations"].append({"channels": [], "samplers": []})

    assert read(tmp_path, more).meta["left_out"] == [
        "1 primitives of points are left out (Dots)",
        "2 primitives of lines are left out (Wire, Strip)",
        "1 meshes that are not in the default scene are left out (Spare)",
        "4 animations are no part of an avatar; --motion FILE#NAME plays one (Walk, Run, Sit, ...)",
    ]


def test_packed_geometry_is_refused_before_all_else(tmp_path: Path) -> None:
    def draco(document: dict[str, Any], blob: bytearray) -> None:
        document["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
        for accessor in document["accessors"][:4]:
            del accessor["bufferView"]

    for how in (read_gltf_person, load):
        with pytest.raises(FormatError, match=r"KHR_draco_mesh_compression.*gltf-transform"):
            read(tmp_path, draco, how)


def test_a_doll_of_parts(tmp_path: Path) -> None:
    """No skin: each node carries a cube. It moves as the person does whose joints are there."""

    def parts(document: dict[str, Any], blob: bytearray) -> None:
        skin, body = document["skins"].pop(), document["nodes"].pop()
        document["nodes"][-1]["children"].remove(len(document["nodes"]))
        mesh = triangle(document, blob, np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]]))
        for node in skin["joints"]:
            document["nodes"][node]["mesh"] = mesh
        assert body["skin"] == 0

    doll, person = read(tmp_path, parts), read(tmp_path, lambda document, blob: None)
    assert doll.meta["rig"] == person.meta["rig"] and "left_out" not in doll.meta
    pose = Pose(np.random.default_rng(2).normal(0, 0.4, (55, 3)))
    at = doll.posed(pose)[::3] - doll.posed(pose)[0]
    names = [name for name in JOINT_NAMES if name in PERSON.names]
    frames = person.skeleton.forward(pose.rotations, pose.trans)[[JOINT_NAMES.index(n) for n in names], :3, 3]
    wanted = frames - frames[0]
    order = [int(np.abs(at - row).sum(axis=1).argmin()) for row in wanted]
    assert at[order] == pytest.approx(wanted, abs=1e-5) and len(set(order)) == len(names)


def test_parts_that_are_no_body_are_refused(tmp_path: Path) -> None:
    def boxes(document: dict[str, Any], blob: bytearray) -> None:
        for number, node in enumerate(document["nodes"]):
            node["name"] = f"box {number}"
            node.pop("skin", None)

    with pytest.raises(FormatError, match="needs triangles with a skin"):
        read(tmp_path, boxes)
    assert len(read(tmp_path, boxes, load).skeleton) == 1


@pytest.mark.parametrize("away", [2.5, 0.0])
def test_of_two_people_one_is_taken_whole(tmp_path: Path, away: float) -> None:
    """A second one beside the first is left out; clothes on a skeleton of their own in the same place stay."""

    def twins(document: dict[str, Any], blob: bytearray) -> None:
        count = len(document["nodes"])
        copies = json.loads(json.dumps(document["nodes"]))
        for node in copies:
            node["children"] = [child + count for child in node.get("children", [])]
        copies[-1] |= {"skin": 1, "name": "Twin"}
        document["nodes"] += copies
        document["nodes"].append({"children": [2 * count - 2], "translation": [away, 0, 0]})
        joints = [joint + count for joint in document["skins"][0]["joints"]]
        document["skins"].append(document["skins"][0] | {"joints": joints})
        document["scenes"][0]["nodes"].append(2 * count)

    mesh, alone = read(tmp_path, twins), read(tmp_path, lambda document, blob: None)
    assert mesh.meta["rig"] == alone.meta["rig"]
    pose = Pose(np.random.default_rng(3).normal(0, 0.3, (55, 3)))
    if away:
        assert mesh.meta["left_out"] == ["1 meshes of another skeleton are left out (Twin)"]
        assert mesh.posed(pose) == pytest.approx(alone.posed(pose), abs=1e-9)
    else:
        assert "left_out" not in mesh.meta and len(mesh.vertices) == 2 * len(alone.vertices)
        assert mesh.posed(pose) == pytest.approx(np.vstack([alone.posed(pose)] * 2), abs=1e-4)
