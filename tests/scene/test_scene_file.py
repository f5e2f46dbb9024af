"""Scene files: what they hold, and what each mistake in one says."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.errors import FormatError
from glsplat.formats import all_formats, load_content, load_scene, recognise, save
from glsplat.formats.format import Opened, opened
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.formats.registry import recognised
from glsplat.formats.scene_file import MAX_ITEMS, upright
from glsplat.scene import similarity
from tests.scenes import cloud, limb
from tests.skinning.avatars import part

Writer = Callable[..., Path]


@pytest.fixture
def scene(tmp_path: Path) -> Writer:
    """Writes a scene file of these items into a folder with cloud.ply, limb.glb and body.glb."""
    folder = tmp_path / "world"
    folder.mkdir()
    save(cloud(20), folder / "cloud.ply")
    save(limb(30), folder / "limb.glb")
    save(cloud(3), tmp_path / "outside.ply")

    def write(*items: dict[str, Any], name: str = "scene.json", **more: Any) -> Path:
        file = folder / name
        file.write_text(json.dumps({"version": 1, "items": items, **more}))
        return file

    return write


def test_items(scene: Writer) -> None:
    pose = {"joints": {limb(1).skeleton.names[1]: [0, 0, 0.5]}, "trans": [0, 1, 0]}
    (scene().parent / "pose.json").write_text(json.dumps(pose))
    file = scene(
        {"path": "limb.glb", "pose": pose, "name": "arm", "translation": [1, 2, 3], "scale": 2},
        {"path": "limb.glb", "pose": "pose.json", "visible": False},
        {"path": "cloud.ply", "rotation": [0, 0, 1, 1]},
        background=[0.1, 0.2, 0.3],
    )
    read = load_scene(file)
    first, second, third = read.scene
    assert read.background == (0.1, 0.2, 0.3) and not read.motions and read.duration == 0
    assert first.content is second.content and first.name == "arm" and second.name == "limb"
    assert first.visible and not second.visible and read.avatar is first
    for item in (first, second):
        assert item.pose is not None and item.pose.rotations[1, 2] == 0.5 and item.pose.trans[1] == 1
    assert np.allclose(first.transform, similarity((1, 2, 3), scale=2))
    assert np.allclose(third.transform[:3, :3] @ (1, 0, 0), (0, 1, 0)) and third.pose is None


def test_up_and_nested_files(scene: Writer) -> None:
    scene({"path": "cloud.ply", "translation": [0, 0, 1]}, name="inner.json", up="z", background=[1, 1, 1])
    read = load_scene(scene({"path": "inner.json", "translation": [5, 0, 0], "scale": 2}, {"path": "cloud.ply"}))
    # one metre up in the inner file, which has z up
    assert np.allclose(read.scene.items[0].transform @ (0, 0, 0, 1), (5, 2, 0, 1))
    assert read.background == (0, 0, 0) and read.scene.items[0].content is read.scene.items[1].content
    for up, axis in {"y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}.items():
        assert np.array_equal(upright(up)[:3, :3] @ axis, (0, 1, 0)) and np.linalg.det(upright(up)) > 0.999


def test_motions(scene: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = scene()
    save(part(default_avatar(), np.arange(50)), file.parent / "body.glb")
    (tmp_path / "walk").write_text("no motion: what lies where the program runs is not the scene's")
    monkeypatch.chdir(tmp_path)
    walking = {"path": "body.glb", "motion": "walk"}
    read = load_scene(scene(walking, walking))
    item, motion = read.motions["0"]
    assert item is read.scene.items[0] and motion is read.motions["1"][1] and read.duration == motion.duration
    expected = load_embedded_motion("walk", item.content.skeleton).at(0.5)  # type: ignore[union-attr]
    read.pose_at(0.5)
    assert item.pose is not None and np.array_equal(item.pose.rotations, expected.rotations)
    assert read.avatar is None  # two of them


def test_many_items_of_one_file_read_it_once(scene: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []

    def count(start: Opened) -> Any:
        read.append(start.name)
        return cloud(3)

    monkeypatch.setitem(all_formats(), "ply", replace(all_formats()["ply"], load=count))
    file = scene(*[{"path": "cloud.ply", "translation": [i, 0, 0]} for i in range(MAX_ITEMS)])
    assert len(load_scene(file).scene) == MAX_ITEMS and len(read) == 1
    with pytest.raises(FormatError, match=f"at most {MAX_ITEMS} items"):
        load_scene(scene(*[{"path": "cloud.ply"}] * 10_000))
    assert len(read) == 1  # refused before anything is read


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ({"path": "gone.ply"}, "item 0: 'gone.ply': no such file"),
        ({"path": "gone.ply", "name": "Bo"}, r"item 0 \('Bo'\): 'gone.ply'"),
        ({"path": "/etc/hostname"}, "relative to the scene file"),
        ({"path": "C:\\x.ply"}, "relative to the scene file"),
        ({"path": ""}, "relative to the scene file"),
        ({"path": "../outside.ply"}, "leads out"),
        ({"path": "link.ply"}, "leads out"),
        ({"path": "ring.ply"}, "is not the path"),
        ({"path": "x" * 5000}, "is not the path"),
        ({"path": "."}, "a directory"),
        ({"path": "pipe.json"}, "not a regular file"),
        ({"path": "cloud.ply", "scale": 0}, "scale above"),
        ({"path": "cloud.ply", "scale": -1}, "no reflection"),
        ({"path": "cloud.ply", "scale": 1e9}, "metres and a scale below"),
        ({"path": "cloud.ply", "rotation": [0, 0, 0, 0]}, "quaternion"),
        ({"path": "cloud.ply", "translation": [0, 0, float("nan")]}, "JSON is malformed"),
        ({"path": "cloud.ply", "translation": [0, 0]}, "length 3"),
        ({"path": "cloud.ply", "colour": 1}, "unknown field `colour`"),
        ({"path": "cloud.ply", "motion": "walk"}, "no pose and no motion"),
        ({"path": "limb.glb", "pose": {"joints": {}}, "motion": "walk"}, "not both"),
        ({"path": "limb.glb", "pose": {"joints": {"tail": [0, 0, 0]}}}, 'no joint "tail"'),
        ({"path": "limb.glb", "pose": "../pose.json"}, "leads out"),
        ({"path": "limb.glb", "motion": "../walk.bvh"}, "leads out"),
        ({"path": "limb.glb", "motion": "../all.glb#Run"}, "leads out"),
        ({"path": "limb.glb", "motion": "moonwalk"}, "'moonwalk': no such file"),
        ({"path": "inner.json", "pose": {}}, "takes a place and nothing else"),
    ],
)
def test_mistakes(scene: Writer, tmp_path: Path, item: dict[str, Any], message: str) -> None:
    scene(name="inner.json")
    folder = tmp_path / "world"
    (folder / "link.ply").symlink_to(tmp_path / "outside.ply")
    (folder / "ring.ply").symlink_to("ring.ply")
    os.mkfifo(folder / "pipe.json")
    with pytest.raises(FormatError, match=message) as caught:
        load_scene(scene(item))
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(folder / "scene.json"))


@pytest.mark.parametrize(
    ("more", "message"),
    [({"version": 2}, "version 1, found 2"), ({"up": "x"}, "up is one of"), ({"sky": 1}, "unknown field")],
)
def test_other_files(scene: Writer, more: dict[str, Any], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        load_scene(scene(**more))


def test_circles_and_bombs(scene: Writer) -> None:
    scene({"path": "scene.json"}, name="b.json")
    with pytest.raises(FormatError, match=r"b\.json: item 0: scene\.json is being read already"):
        load_scene(scene({"path": "b.json"}))
    for level in range(12):
        scene({"path": f"deep{level + 1}.json"}, name=f"deep{level}.json")
    scene(name="deep12.json")
    with pytest.raises(FormatError, match="nested more than 8 deep"):
        load_scene(scene({"path": "deep0.json"}))
    scene(name="empty.json")
    for level in range(3):  # 1000 files of 1000 files of nothing
        inside = "empty.json" if level == 0 else f"wide{level - 1}.json"
        scene(*[{"path": inside}] * MAX_ITEMS, name=f"wide{level}.json")
    with pytest.raises(FormatError, match=f"at most {MAX_ITEMS} items"):
        load_scene(scene({"path": "wide2.json"}))


def test_what_is_a_scene_file(scene: Writer) -> None:
    for whole, text in (
        (True, b'\xef\xbb\xbf {"version": 1, "items" : [{"path": "x", "name": "asset"}]}'),
        (False, b'{"asset": {"version": "2.0"}, "items": []}'),
    ):
        with opened(io.BytesIO(text)) as start:
            assert (recognised(start).name == "scene") is whole
    assert recognise(scene()) == "scene"
    with pytest.raises(FormatError, match="found a scene file"):
        load_content(scene())


def test_a_scene_of_one(tmp_path: Path) -> None:
    save(cloud(5), tmp_path / "a.ply")
    read = load_scene(tmp_path / "a.ply")
    assert len(read.scene) == 1 and read.avatar is None and not read.motions
