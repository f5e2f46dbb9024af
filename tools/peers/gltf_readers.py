"""Holds glTF files as glsplat writes them against the Khronos validator and three.js, both in node.

    npm install gltf-validator three        (in a folder of its own, FOLDER)
    python -m tools.peers.gltf_readers FOLDER [FILE.glb ...]

A static scene, an avatar, an avatar with cones and the embedded one, and a textured skinned mesh, as .glb and .gltf;
the files of the embedded people as they are, and further ones that are named.
The validator may say only that it does not know KHR_gaussian_splatting and its attributes. three.js has to find the
same counts, positions, colours, joints and weights, and for the mesh the same places by its own skinning, also where
the nodes stand in another pose than the one of binding.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.avatar import Avatar, splats_of
from glsplat.data import PEOPLE, default_avatar, embedded_file
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import load, save
from glsplat.formats.gltf.splats import EXTENSION
from glsplat.skinning.pose import Pose
from tests.extras.rigs.meshes import chain
from tests.formats.scenes import edit_glb, random_avatar, random_splats

BENT, BEND = 3, [0.5, 0.5, 0.5, 0.5]  # a joint, and xyzw of its node: a third of a turn about (1, 1, 1)


def written(folder: Path) -> list[Path]:
    """The files."""
    avatar = random_avatar(200, degree=1)
    cones = np.random.default_rng(1).integers(-128, 128, (200, 4)).astype(np.int8)
    scenes = {"static": random_splats(100, 3), "avatar": avatar, "default": default_avatar()}
    scenes["cones"] = replace(avatar, splats=replace(avatar.splats, cones=cones, antialias=True))
    paths = []
    for suffix in (".glb", ".gltf"):
        for name, scene in scenes.items():
            paths.append(folder / f"{name}{suffix}")
            save(scene, paths[-1])
        paths.append(folder / f"mesh{suffix}")
        save_gltf_mesh(chain(), paths[-1])
    paths.append(folder / "bent.glb")
    save_gltf_mesh(chain(), paths[-1])
    edit_glb(paths[-1], lambda document: document["nodes"][1 + BENT].update(rotation=BEND))
    return [*paths, *map(embedded_file, PEOPLE)]


def complaint(issue: dict[str, Any]) -> str | None:
    """What is wrong, None for what is to be expected."""
    if issue["code"] == "UNSUPPORTED_EXTENSION" and EXTENSION in issue["message"]:
        return None
    if issue["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE" and f"/{EXTENSION}:" in issue["pointer"]:
        return None
    return f"{issue['code']} {issue.get('pointer')}"


def values(shown: dict[str, Any], name: str) -> np.ndarray:
    found = shown["attributes"][name]
    return np.array(found["values"]).reshape(found["count"], found["width"])


def check_splats(path: Path, objects: list[dict[str, Any]]) -> str:
    (shown,) = objects
    scene = load(path)
    splats = splats_of(scene)
    assert shown["kind"] == "Points" and shown["vertexColors"]
    assert np.array_equal(values(shown, "position"), splats.means)
    turns = values(shown, f"{EXTENSION}:rotation".lower())
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)  # of 16 bits a number
    away = np.abs(turns - splats.quats[:, [1, 2, 3, 0]]).max()
    assert away < 1e-6, f"three.js turns splats otherwise by {away}"
    colour = values(shown, "color")
    display = np.where(colour <= 0.0031308, colour * 12.92, 1.055 * colour ** (1 / 2.4) - 0.055)[:, :3]
    levels = np.abs(display - np.clip(splats.sh[:, 0] * 0.28209479 + 0.5, 0, 1)).max() * 255
    assert levels < 0.1 and np.abs(colour[:, 3] - splats.opacities).max() < 1e-5
    if isinstance(scene, Avatar):
        joints, weights = values(shown, "skinIndex").astype(int), values(shown, "skinWeight")
        dense = np.zeros((len(splats), len(scene.skeleton)))
        np.add.at(dense, (np.arange(len(splats))[:, None], joints), weights)
        assert np.abs(dense - scene.skin.dense(len(scene.skeleton))).max() < 1e-6
    moved = "" if getattr(scene, "shapes", None) is None else check_shapes(scene, shown)
    return f"{len(splats)} splats, colours within {levels:.3f} levels{moved}"


def check_shapes(avatar: Avatar, shown: dict[str, Any]) -> str:
    """All targets at once, with the weights that the script gives them."""
    shapes = avatar.shapes
    assert shapes is not None and tuple(shown["targets"]) == shapes.names
    weights = np.array([(target * 37) % 11 / 10 for target in range(len(shapes))])
    expected = avatar.splats.means.astype(np.float64)
    np.add.at(expected, shapes.rows, shapes.metres.astype(np.float64) * weights[shapes.targets, None])
    away = np.abs(np.array(shown["morphed"]) - expected).max()
    assert away < 1e-5, f"three.js moves splats {away} m away"
    return f", {len(shapes)} targets within {away:.1e} m"


def check_mesh(path: Path, objects: list[dict[str, Any]]) -> str:
    mesh = chain()
    assert all(shown["kind"] == "SkinnedMesh" and shown["map"] for shown in objects)
    names = [name.replace(" ", "_") for name in mesh.skeleton.names]  # as three.js spells them
    assert all(shown["bones"] == names for shown in objects)
    inverse = np.array(objects[0]["inverse"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    assert np.abs(inverse - mesh.skeleton.inverse_bind).max() < 1e-6
    turns = np.zeros((len(mesh.skeleton), 3))
    if path.stem == "bent":
        turns[BENT] = 2 * np.pi / 3 / np.sqrt(3)
    expected = mesh.posed(Pose(turns))[mesh.faces].reshape(-1, 3)
    found = np.concatenate([shown["skinned"] for shown in objects])
    away = np.abs(found - expected).max()
    assert away < 1e-6, f"{path}: three.js skins {away} m away"
    return f"{len(found)} corners, skinned within {away:.1e} m"


def main() -> int:
    """0 where all agree."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        paths = [*written(Path(folder)), *(Path(name).resolve() for name in sys.argv[2:])]
        script = Path(__file__).with_suffix(".mjs")
        done = subprocess.run(["node", script, *paths], cwd=sys.argv[1], capture_output=True, check=True)
        for path, said in ((Path(name), said) for name, said in json.loads(done.stdout).items()):
            bad = [text for issue in said["issues"] if (text := complaint(issue))]
            wrong += len(bad)
            check = check_mesh if path.stem in ("mesh", "bent") else check_splats
            print(f"{path.name}: {check(path, said['objects'])}; the validator: {', '.join(bad) or 'nothing else'}")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
