"""A person from any program moves exactly as glTF says: the file's nodes turned, against our 55 joints turned alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.formats.gltf.meshes.reader import read_gltf_person
from glsplat.meshes import RiggedMesh
from glsplat.rotations import matrix_quaternions, quaternion_vectors, rotation_matrices
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from tests.authoring.gltf.built import FAMILIES, build
from tests.authoring.gltf.independent import File

# files of several skins hold a joint's bind once a skin, in float32: that is how far apart these are
REAL = {
    **dict.fromkeys(("cesium_man.glb", "cool_loops.vrm", "godette.vrm"), 1e-6),
    **{"mannequiny_gdquest.glb": 3e-6, "rpm_template_xr.glb": 3e-6, "babylon_25skins.glb": 3e-5},
}


def turned(file: File, mesh: RiggedMesh, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """World transforms [N, 4, 4] of the file's nodes with every joint of the map turned at random from where it was
    bound, and the same of the nodes as bound."""
    names = [node.name for node in file.gltf.nodes]
    bound, rest = file.skin_joints(), file.world({})
    rng = np.random.default_rng(seed)
    joint_of = {names.index(name): joint for joint, name in mesh.meta["rig"].items()}
    frames = {node: bound[node] for node in joint_of}
    posed: dict[int, np.ndarray] = {}

    def above(node: int) -> int | None:
        at = file.parents.get(node)
        while at is not None and at not in joint_of:
            at = file.parents.get(at)
        return at

    def pose(node: int) -> np.ndarray:
        if node not in posed:
            own = np.eye(4)
            own[:3, :3] = rotation_matrices(rng.normal(0, 0.5, 3))
            parent = above(node)
            start = frames[node] if parent is None else pose(parent) @ np.linalg.solve(frames[parent], frames[node])
            posed[node] = start @ own
        return posed[node]

    for node in sorted(joint_of):
        pose(node)
    # helpers stay as they were bound under the joint that they hang from; all of it in the space of the skin
    world, unturned = np.empty_like(rest), np.empty_like(rest)
    for node in range(len(names)):
        anchor = node if node in joint_of else above(node)
        if anchor is None:  # a helper above all joints goes with the first of the map that hangs from it
            anchor = next((j for j in sorted(joint_of) if node in chain(file, j)), min(joint_of))
        known = node in bound
        local = np.linalg.solve(frames[anchor], bound[node]) if known else np.linalg.solve(rest[anchor], rest[node])
        world[node], unturned[node] = posed[anchor] @ local, frames[anchor] @ local
    return world, unturned


def chain(file: File, node: int) -> list[int]:
    out = []
    while node in file.parents:
        node = file.parents[node]
        out.append(node)
    return out


def our_pose(file: File, mesh: RiggedMesh, world: np.ndarray, bound: np.ndarray) -> tuple[Pose, float]:
    """The pose in which our joints are turned as the file's are, and the unit of the skin's space in metres."""
    names = [node.name for node in file.gltf.nodes]
    node = {joint: names.index(name) for joint, name in mesh.meta["rig"].items()}
    skeleton = mesh.skeleton
    binds = np.linalg.inv(skeleton.inverse_bind)  # [55, 4, 4] our joints as bound
    # the similarity from the skin's space to ours, from where the joints are
    ours = np.array([binds[JOINT_NAMES.index(joint), :3, 3] for joint in node])
    theirs = np.array([bound[n][:3, 3] for n in node.values()])
    a, b = theirs - theirs.mean(0), ours - ours.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    flip = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    turn, unit = u @ flip @ vt, float((s * np.diag(flip)).sum() / (a**2).sum())
    local = np.zeros((55, 3))
    frames = np.empty((55, 3, 3))
    for index, joint in enumerate(JOINT_NAMES):
        parent = int(PARENTS[index])
        above = frames[parent] if parent >= 0 else np.eye(3)
        if joint in node:
            moved = rotation(world[node[joint]]) @ rotation(bound[node[joint]]).T
            frames[index] = turn @ moved @ turn.T @ binds[index, :3, :3]
        else:
            frames[index] = above
        local[index] = quaternion_vectors(matrix_quaternions(above.T @ frames[index]))
    at = unit * turn @ (world[node["pelvis"]][:3, 3] - theirs.mean(0)) + ours.mean(0)
    return Pose(local, at - skeleton.rest[0, :3, 3]), unit


def rotation(frame: np.ndarray) -> np.ndarray:
    return frame[:3, :3] / np.cbrt(np.linalg.det(frame[:3, :3]))


def compare(file: File, mesh: RiggedMesh, seed: int) -> float:
    """The largest distance in units of the person's height, after the best similarity."""
    world, bound = turned(file, mesh, seed)
    pose, unit = our_pose(file, mesh, world, bound)
    ours = mesh.posed(pose)
    theirs = file.vertices(world)
    assert len(ours) >= len(theirs)
    ours = ours[: len(theirs)]
    a, b = theirs - theirs.mean(0), ours - ours.mean(0)
    u, _, vt = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.abs(unit * a @ turn.T - b).max() / np.ptp(ours, axis=0).max())


@pytest.mark.parametrize("name", [n for n in FAMILIES if n != "a toy of nine joints"])
def test_built_people(tmp_path: Path, name: str) -> None:
    path = tmp_path / "person.glb"
    path.write_bytes(build(FAMILIES[name]).data)
    file, mesh = File(path), read_gltf_person(path)
    for seed in range(2):
        assert compare(file, mesh, seed) < 1e-6


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize("name", REAL)
def test_real_people(shared_data: Path, name: str) -> None:
    path = shared_data / "real" / "models" / name
    file, mesh = File(path), read_gltf_person(path)
    assert compare(file, mesh, 0) < REAL[name]
