"""What somebody who knows the docs alone may write: each is right, or refused in one line."""

from __future__ import annotations

import copy
import json
import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Camera, GlsplatError, Item, Pose, Scene, Skeleton, Skin, Splats
from glsplat.meshes import RiggedMesh
from glsplat.net.client import Client
from glsplat.scenes.camera_file import camera_from_json, read_cameras
from glsplat.tracking import Tracker
from tests.scenes import cloud, limb

VIEW, K = glsplat.look_at((0, 0, 3), (0, 0, 0)), glsplat.pinhole(64, 64, 50)
SPLAT: dict[str, Any] = {
    "means": [[0, 0, 0]],
    "quats": [[1.0, 0, 0, 0]],
    "scales": [[0.1, 0.1, 0.1]],
    "opacities": [0.9],
    "rgb": [[1, 0, 0]],
}
NO_NUMBERS: list[Any] = ["2", b"2", True, np.True_, 1j, np.complex64(1), None, [1], np.array([1.0]), {}, object()]
NO_SWITCHES: list[Any] = ["no", "", 0, 1, 1.0, None, [], [False], np.array([True]), object()]
NO_SIZES: list[Any] = [
    64,
    64.0,
    "64",
    None,
    (64,),
    (64, 48, 3),
    (64.0, 48.0),
    (64, True),
    ("6", "4"),
    (0, 4),
    (-1, 4),
    {},
]


def masked(values: Any) -> Any:
    mask = np.zeros(np.shape(values), bool)
    mask.flat[0] = True
    return np.ma.masked_array(values, mask)


def refused(call: Callable[[], Any], *words: str) -> str:
    with pytest.raises(GlsplatError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text and 10 < len(text) < 300, text
    for word in words:
        assert word in text, f"{word!r} is not in {text!r}"
    return text


# ----------------------------------------------------------------------------------------------------------- cameras

UPS = [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 2, 3), (0, 1e-200, 0), (0, 1e200, 0), (1e-9, 0, 0)]


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("along", [1e-3, 3.0, -3.0, 1e6])
def test_look_at_along_up_is_a_rotation_that_looks_there(up: Any, along: float) -> None:
    scaled = np.array(up) / np.abs(up).max()
    for direction in (scaled, scaled + (1e-12, 0, 0), np.array([0.3, 0.2, 0.1])):
        eye = np.array([0.5, 1.0, -2.0])
        target = eye + along * direction
        camera = Camera(glsplat.look_at(eye, target, up), K, 64, 64)
        seen = camera.viewmat @ (*target, 1)
        assert np.abs(seen[:2]).max() < 1e-6 * max(1, abs(along)) and seen[2] > 0
        assert np.allclose(camera.position, eye, atol=1e-9)


@pytest.mark.parametrize(
    "arguments",
    [
        ((0, 0, 3), (0, 0, 0), (0, 0, 0)),
        ((0, 0, 3), (1e200, 0, 0)),
        ((0, 0, 3), (1e13, 0, 0)),
        ((1e160, 0, 3), (0, 0, 0)),
        ((0, 0, 3), (0, 0, 3)),
        ((1e6, 0, 0), (1e6, 0, 1e-12)),
        ((0, 0, 3), (0, 0, 1j)),
        ((0, 0, 3), masked([0.0, 0, 0])),
        ((0, 0, 3), [0, np.ma.masked, 0]),
    ],
)
def test_look_at_refuses_what_is_no_direction(arguments: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refused(lambda: glsplat.look_at(*arguments))


def test_a_camera_comes_back_from_json_as_it_was(tmp_path: Path) -> None:
    camera = Camera(VIEW, K, 64, 64, (0.1, 0.2, 0.3), 0.2, 50.0, 1, "left")
    (tmp_path / "a.json").write_text(json.dumps([camera.to_json(), Camera(VIEW, K, 64, 64).to_json()]))
    (again, plain), _ = read_cameras(tmp_path / "a.json")
    for name in camera.__dataclass_fields__:
        assert np.array_equal(getattr(again, name), getattr(camera, name)), name
    assert plain.far == 1e10 and plain.name == "" and "name" not in Camera(VIEW, K, 64, 64).to_json()
    refused(lambda: camera_from_json({**camera.to_json(), "name": 5}, "a.json"), "name is text")


@pytest.mark.parametrize("off", [1e-3, 5e-4, 1e-4, -1e-3])
def test_a_rotation_that_is_none_is_refused(off: float) -> None:
    for change in (np.full((3, 3), off / 2), np.eye(3) * off, np.outer([1, 0, 0], [0, off, 0])):
        view = VIEW.copy()
        view[:3, :3] += change
        refused(lambda view=view: Camera(view, K, 64, 64), "R R^T is off by")
    for digits in (5, 6, 7):
        turned = glsplat.look_at((0.3, 0.4, 3), (0.1, 0, 0)).round(digits)
        assert Camera(turned, K, 64, 64)
    assert Camera(glsplat.look_at((0.3, 0.4, 3), (0.1, 0, 0)).astype(np.float32), K, 64, 64)


@pytest.mark.parametrize("ipd", [63, 6.3, 2.1, -0.063, np.nan, np.inf, *NO_NUMBERS])
def test_an_ipd_is_metres(ipd: Any) -> None:
    refused(lambda: glsplat.stereo_cameras(np.eye(4), ipd=ipd), "ipd needs")


def test_eyes_may_be_in_one_place_and_a_giant_has_them_apart() -> None:
    left, right = glsplat.stereo_cameras(np.eye(4), ipd=0)
    assert np.array_equal(left.viewmat, right.viewmat)
    assert glsplat.stereo_cameras(np.eye(4), ipd=np.float32(0.9))[0].position[0] == pytest.approx(-0.45)


@pytest.mark.parametrize("size", NO_SIZES)
def test_a_size_is_two_whole_numbers(size: Any) -> None:
    refused(lambda: glsplat.stereo_cameras(np.eye(4), size=size), "size")


@pytest.mark.parametrize(
    "background",
    [(255, 0, 0), [0, 128, 0], (2, 0, 0), (3.0, 0, 0), (0, 0, -2), np.uint8([9, 9, 9]), "red", (1, 1), 1, 1j],
)
def test_a_background_is_0_to_1(background: Any, tmp_path: Path) -> None:
    image = np.zeros((2, 2, 4), np.uint8)
    calls: list[Callable[[], Any]] = [
        lambda: Camera(VIEW, K, 64, 64, background=background),
        lambda: replace(Camera(VIEW, K, 64, 64), background=background),
        lambda: glsplat.stereo_cameras(np.eye(4), background=background),
        lambda: glsplat.straight(image, background=background),
    ]
    for call in calls:
        refused(call, "background")


# ------------------------------------------------------------------------------------------------------------ values

ARRAYS: dict[str, Callable[[Any], Any]] = {
    **{
        name: (lambda value, name=name: Splats.create(**{**SPLAT, name: value}))
        for name in ("means", "quats", "scales", "opacities", "rgb")
    },
    "sh": lambda value: Splats.create(**{**SPLAT, "rgb": None, "sh": value}),
    "viewmat": lambda value: Camera(value, K, 64, 64),
    "K": lambda value: Camera(VIEW, value, 64, 64),
    "background": lambda value: Camera(VIEW, K, 64, 64, background=value),
    "eye": lambda value: glsplat.look_at(value, (0, 0, 0)),
    "head": lambda value: glsplat.stereo_cameras(value),
    "rotations": lambda value: Pose(value),
    "trans": lambda value: Pose([[0, 0, 0]], value),
    "smplx": lambda value: Pose.from_smplx({"body_pose": value}),
    "parents": lambda value: Skeleton(["a", "b"], value, np.tile(np.eye(4), (2, 1, 1))),
    "joints": lambda value: Skeleton.from_joints(["a", "b"], [-1, 0], value),
    "skin": lambda value: Skin(value, [[0.5, 0.5]]),
    "weights": lambda value: Skin([[0, 1]], value),
    "translation": lambda value: glsplat.similarity(value),
    "rotation": lambda value: glsplat.similarity(rotation=value),
    "transform": lambda value: Item(cloud(5), transform=value),
    "moved": lambda value: setattr(Item(cloud(5)), "transform", value),
}
GOOD: dict[str, Any] = {
    **SPLAT,
    "sh": np.zeros((1, 1, 3)),
    "viewmat": VIEW,
    "K": K,
    "background": [0.5, 0.5, 0.5],
    "eye": [0.0, 0.0, 3.0],
    "head": np.eye(4),
    "rotations": np.zeros((2, 3)),
    "trans": np.zeros(3),
    "smplx": np.zeros((21, 3)),
    "parents": [-1, 0],
    "joints": [[0.0, 0, 0], [0, 1, 0]],
    "skin": [[0, 1]],
    "weights": [[0.75, 0.25]],
    "translation": [1.0, 2, 3],
    "rotation": [0.0, 0, 0, 1],
    "transform": np.eye(4),
    "moved": np.eye(4),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_of_other_things_than_numbers_and_masked_ones_are_refused(name: str) -> None:
    call, good = ARRAYS[name], np.array(GOOD[name])
    call(good)
    call(np.ma.masked_array(good, np.zeros(good.shape, bool)))  # nothing is masked
    refused(lambda: call(masked(good)), "mask")
    if good.ndim > 1:
        refused(lambda: call([masked(row) for row in good]), "mask")
    nothing = [] if name == "transform" else [None]  # where it stands as it was loaded
    others = [good.astype(kind) for kind in (complex, bool, str, object)]
    for other in (*others, *nothing, "1", iter([1])):
        refused(lambda other=other: call(other))


@pytest.mark.parametrize("scale", [*NO_NUMBERS, np.nan, np.inf, 0, -1, 1e-7, 1e7])
def test_a_scale_is_a_number(scale: Any) -> None:
    refused(lambda: glsplat.similarity(scale=scale))


@pytest.mark.parametrize("kind", [np.uint8, np.int64, list])
def test_opacities_of_0_to_255_are_refused_as_colours_are(kind: Any) -> None:
    values = [255, 128]
    opacities = values if kind is list else np.array(values, kind)
    two = {**SPLAT, **{name: SPLAT[name] * 2 for name in SPLAT}}
    refused(lambda: Splats.create(**{**two, "opacities": opacities}), "opacities needs 0 to 1", "255")
    splats = Splats.create(**two)
    refused(lambda: replace(splats, opacities=opacities), "opacities needs 0 to 1", "255")
    assert replace(splats, opacities=[1, 0]).opacities.tolist() == [1, 0]
    assert replace(splats, opacities=[1.5, -1.0]).opacities.tolist() == [1.5, -1.0]  # a fate of their own


@pytest.mark.parametrize("switch", NO_SWITCHES)
def test_a_switch_is_true_or_false(switch: Any) -> None:
    item = Item(cloud(5))
    refused(lambda: Item(cloud(5), visible=switch), "visible")
    refused(lambda: setattr(item, "visible", switch), "visible")
    refused(lambda: Splats.create(**SPLAT, antialias=switch), "antialias")
    refused(lambda: Tracker(glsplat.default_avatar().skeleton, head_only=switch), "head_only")
    refused(lambda: Client("ws://localhost:1/ws", mirror=switch), "mirror")
    assert item.visible is True
    item.visible = np.False_  # type: ignore[assignment]
    assert item.visible is False


@pytest.mark.parametrize("angle", [180, 90.0, -90, 360])
def test_degrees_are_no_radians(angle: float) -> None:
    for rotations in (np.full((2, 3), angle), [[0, 0, 0], [0, angle, 0]]):
        refused(lambda rotations=rotations: Pose(rotations), "radians, not degrees")
    refused(lambda: Pose.from_smplx({"body_pose": np.full((21, 3), angle)}), "radians, not degrees")
    assert Pose([[0, 20 * np.pi, 0]])


def test_the_root_alone_is_a_pose() -> None:
    for key in ("trans", "transl"):
        pose = Pose.from_smplx({key: [1, 2, 3]})
        assert pose.trans.tolist() == [1, 2, 3] and not pose.rotations.any()
    refused(lambda: Pose.from_smplx({"betas": [1.0] * 10}), "trans; found betas")


def test_nobody_changes_what_an_avatar_says_of_itself() -> None:
    avatar = glsplat.default_avatar()
    before = copy.deepcopy(dict(avatar.meta))
    assert before
    mesh = RiggedMesh(np.eye(3), *_bound(), meta={"made": {"by": ["ann"]}})
    mine = replace(avatar, meta={"a": {"b": [1, {"c": 2}]}})
    for meta in (
        avatar.meta,
        mesh.meta,
        mine.meta,
        mine.meta["a"],
        mine.meta["a"]["b"][1],
        pickle.loads(pickle.dumps(mine)).meta,
    ):
        for change in (
            lambda m=meta: m.__setitem__("x", 1),
            lambda m=meta: m.update(x=1),
            lambda m=meta: m.clear(),
            lambda m=meta: m.pop(next(iter(m))),
        ):
            with pytest.raises(TypeError, match="belongs to a value"):
                change()
    for call in (lambda: mesh.meta["made"]["by"].append("eve"), lambda: mine.meta["a"]["b"].sort()):
        with pytest.raises(TypeError, match="belongs to a value"):
            call()
    assert glsplat.default_avatar().meta == before
    assert mine.meta == {"a": {"b": [1, {"c": 2}]}} and json.loads(json.dumps(mine.meta)) == mine.meta
    assert copy.deepcopy(mine).meta == mine.meta
    changed = replace(avatar, meta=avatar.meta | {"x": 1})
    assert changed.meta["x"] == 1 and "x" not in avatar.meta


def _bound() -> Any:
    from glsplat.meshes import MeshPart

    part = MeshPart("a", np.array([[0, 1, 2]], np.int32), np.zeros((1, 3, 2)), np.zeros((1, 1, 4), np.uint8))
    return Skeleton.from_joints(["a"], [-1], [[0, 0, 0]]), np.zeros((3, 1), np.int64), np.ones((3, 1)), (part,)


# ------------------------------------------------------------------------------------------------ scenes, files, names


@pytest.mark.parametrize("items", [cloud(5), limb(5), Item(cloud(5)), 5, None, "scene", [cloud(5)], [5], {1: 2}])
def test_a_scene_is_made_of_items(items: Any) -> None:
    refused(lambda: Scene(items), "Item")
    refused(lambda: Scene().remove(items), "is not in the scene")
    if not isinstance(items, Item):
        refused(lambda: Scene().add(items), "Items")


def test_a_scene_of_a_scenes_items_is_another() -> None:
    items = [Item(cloud(5)), Item(cloud(5))]
    scene = Scene(iter(items))
    assert Scene(scene).items == Scene(scene.items).items == tuple(items)


@pytest.mark.parametrize("name", [5, None, b"Ann", ["Ann"]])
def test_a_name_is_text(name: Any) -> None:
    refused(lambda: Item(cloud(5), name=name), "name")


def test_an_item_is_read_from_whatever_names_a_file(tmp_path: Path) -> None:
    from glsplat.scenes import load, load_scene

    path = tmp_path / "a.glb"
    glsplat.save(limb(20), path)
    for name in (path, str(path), bytes(path)):
        assert isinstance(load(name), Avatar) and len(load_scene(name).scene) == 1
    for name in (5, None, tmp_path / "b.glb", str(tmp_path)):
        for read in (load, load_scene):
            refused(lambda name=name, read=read: read(name))
