"""Values of the public API: any numbers make them, and nothing changes them afterwards."""

from __future__ import annotations

import copy
import json
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Camera, GlsplatError, Pose, RenderConfig, Skeleton, Skin, Splats
from glsplat.config import DebugConfig, with_fields
from glsplat.formats.camera_file import camera_from_json, read_cameras
from glsplat.meshes import RiggedMesh
from glsplat.net.reply import Reply
from tests.api.variants import sheet
from tests.scene.worlds import upright

VIEW = glsplat.look_at((0, 0, 3), (0, 0, 0))
K = glsplat.pinhole(64, 64, 50)
QUAT = [[1.0, 0, 0, 0]]


def one_splat(**changes: Any) -> Splats:
    parts: dict[str, Any] = {"means": [[0, 0, 0]], "quats": QUAT, "scales": [[0.1, 0.1, 0.1]], "opacities": [0.9]}
    return Splats.create(**{**parts, "rgb": [[1, 0, 0]], **changes})


def two_bones() -> Skeleton:
    return Skeleton.from_joints(["a", "b"], [-1, 0], [[0, 0, 0], [0, 1, 0]])


def refused(call: Callable[[], Any], *words: str) -> None:
    with pytest.raises(GlsplatError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text and 10 < len(text) < 300, text
    for word in words:
        assert word in text, f"{word!r} is not in {text!r}"


VALUES: dict[str, Callable[[], Any]] = {
    "camera": lambda: Camera(VIEW, K, 64, 64, name="left"),
    "pose": lambda: Pose(np.full((2, 3), 0.1), [1, 2, 3], np.full((2, 3), 0.2)),
    "skin": lambda: Skin([[0, 1], [1, 0]], [[0.5, 0.5], [1, 0]]),
    "skeleton": two_bones,
    "splats": lambda: replace(one_splat(), cones=np.array([[1, 2, 3, 4]], np.int8), antialias=True),
    "avatar": lambda: Avatar(one_splat(), two_bones(), Skin([[0, 1]], [[0.75, 0.25]]), {"source": "here"}),
    "config": lambda: with_fields(RenderConfig(), cull_hidden=True, eps2d=np.float32(0.25)),
}


def arrays_of(value: Any) -> dict[str, np.ndarray[Any, Any]]:
    found: dict[str, np.ndarray[Any, Any]] = {}
    for name in value.__dataclass_fields__:
        held = getattr(value, name)
        if isinstance(held, np.ndarray):
            found[name] = held
        elif hasattr(held, "__dataclass_fields__"):
            found |= {f"{name}.{inner}": array for inner, array in arrays_of(held).items()}
    return found


# ------------------------------------------------------------------------------------------------ nothing changes


def test_a_loop_that_moves_one_matrix_makes_different_cameras(renderer_of: Any) -> None:
    view = VIEW.copy()
    cameras = []
    for step in range(3):
        view[0, 3] = 0.5 * step
        cameras.append(Camera(view, K, 64, 64))
    assert [c.viewmat[0, 3] for c in cameras] == [0, 0.5, 1]
    pictures = renderer_of(one_splat()).render(cameras)
    assert not np.array_equal(pictures[0], pictures[1]) and not np.array_equal(pictures[1], pictures[2])


def test_nan_written_into_the_source_later_changes_no_picture(renderer_of: Any) -> None:
    view, rotations, means = VIEW.copy(), np.zeros((2, 3)), np.zeros((1, 3), np.float32)
    weights = np.array([[0.75, 0.25]], np.float32)
    avatar = Avatar(one_splat(means=means), two_bones(), Skin(np.array([[0, 1]], np.uint16), weights))
    camera, pose = Camera(view, K, 64, 64), Pose(rotations)
    before = renderer_of(avatar).render([camera], pose)
    for array in (view, rotations, means, weights):
        array[:] = np.nan
    assert np.array_equal(renderer_of(avatar).render([camera], pose), before) and before.any()


@pytest.mark.parametrize("name", VALUES)
def test_arrays_are_read_only_and_stay_so(name: str) -> None:
    value = VALUES[name]()
    made = [value, copy.copy(value), copy.deepcopy(value), replace(value)]
    made += [pickle.loads(pickle.dumps(value, protocol)) for protocol in (2, 5)]
    for other in made:
        assert type(other) is type(value) and arrays_of(other).keys() == arrays_of(value).keys()
        for where, array in arrays_of(other).items():
            assert np.array_equal(array, arrays_of(value)[where]) and array.dtype == arrays_of(value)[where].dtype
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


def test_large_splats_are_copied_once_or_not_at_all() -> None:
    means = np.zeros((1000, 3), np.float32)
    rest = (np.tile(np.float32(QUAT), (1000, 1)), np.ones((1000, 3)), np.ones(1000), np.ones((1000, 1, 3)))
    assert not np.shares_memory(Splats(means, *rest).means, means)
    handed_over = means.copy()
    handed_over.flags.writeable = False
    first = Splats(handed_over, *rest)
    assert first.means is handed_over
    assert replace(first, antialias=True).sh is first.sh
    window = means[:500]  # read-only, but what it looks at is not
    window.flags.writeable = False
    assert not np.shares_memory(Splats(window, *(a[:500] for a in rest)).means, means)


def test_meta_belongs_to_its_value() -> None:
    avatar = glsplat.default_avatar()
    before = copy.deepcopy(dict(avatar.meta))
    mesh = replace(sheet(), meta={"made": {"by": ["ann"]}})
    note = {"a": {"b": [1, {"c": 2}]}}
    mine = replace(avatar, meta=note)
    note["a"]["b"].append(3)
    assert isinstance(mesh, RiggedMesh) and before
    for meta in (avatar.meta, mesh.meta, mine.meta, mine.meta["a"], mine.meta["a"]["b"][1]):
        for change in (lambda m=meta: m.update(x=1), lambda m=meta: m.clear(), lambda m=meta: m.pop(next(iter(m)))):
            with pytest.raises(TypeError, match="belongs to a value"):
                change()
    for call in (lambda: mesh.meta["made"]["by"].append("eve"), lambda: mine.meta["a"]["b"].sort()):
        with pytest.raises(TypeError, match="belongs to a value"):
            call()
    assert glsplat.default_avatar().meta == before
    for again in (mine, copy.deepcopy(mine), pickle.loads(pickle.dumps(mine))):
        assert again.meta == {"a": {"b": [1, {"c": 2}]}} and json.loads(json.dumps(again.meta)) == again.meta
    assert replace(avatar, meta=avatar.meta | {"x": 1}).meta["x"] == 1 and "x" not in avatar.meta


# ------------------------------------------------------------------------------------- everything numpy can read


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, np.int8, np.float16, ">f4", list])
def test_numbers_of_any_type_are_the_same_value(kind: Any) -> None:
    def turned(values: Any) -> Any:
        array = np.asarray(values)
        return array.tolist() if kind is list else array.astype(kind)

    camera = Camera(turned(np.eye(4)), turned([[2, 0, 1], [0, 2, 1], [0, 0, 1]]), 2, 2, background=turned([1, 1, 1]))
    assert camera.viewmat.dtype == np.float64 and camera.background == (1.0, 1.0, 1.0)
    pose = Pose(turned([[1, 0, 2]]), turned([1, 2, 3]), turned([[0, 0, 1]]))
    assert pose.rotations.dtype == np.float64 and pose.rotations.tolist() == [[1, 0, 2]]
    skin = Skin(turned([[3, 1]]), turned([[1, 0]]))
    assert skin.joints.dtype == np.uint16 and skin.weights.dtype == np.float32
    assert skin.joints.tolist() == [[3, 3]] and skin.weights.tolist() == [[1, 0]]
    splats = Splats.create(
        turned([[1, 2, 3]]), turned([[2, 0, 0, 0]]), turned([[1, 1, 1]]), turned([1]), turned([[[1, 0, 1]]])
    )
    assert {a.dtype for a in arrays_of(splats).values()} == {np.dtype(np.float32)}
    assert splats.quats.tolist() == [[1, 0, 0, 0]]
    skeleton = Skeleton(["a"], turned([-1]), turned([np.eye(4)]))
    assert skeleton.parents.dtype == np.int32 and skeleton.rest.dtype == np.float64


def test_numpy_scalars_are_numbers() -> None:
    more: dict[str, Any] = {"near": np.float32(0.5), "far": np.int32(9), "sh_degree": np.int8(2)}
    camera = Camera(VIEW, K, np.int64(64), np.uint8(64), background=np.ones(3), **more)
    assert (camera.width, camera.height, camera.far, camera.sh_degree) == (64, 64, 9.0, 2)
    assert [type(v) for v in (camera.width, camera.near, camera.far, camera.sh_degree)] == [int, float, float, int]
    assert np.array_equal(glsplat.pinhole(np.int32(64), np.int64(64), np.float64(50)), K)
    left, right = glsplat.stereo_cameras(np.eye(4, dtype=np.float32), np.float32(0.5), size=np.array([8, 8]))
    assert right.position[0] - left.position[0] == 0.5
    assert RenderConfig(antialias=np.True_).antialias is True  # type: ignore[arg-type]
    assert type(DebugConfig(sort_bits=np.int64(16)).sort_bits) is int  # type: ignore[arg-type]


def test_choices_may_be_enums() -> None:
    choice = Enum("choice", {"NARROW": "16f", "AUTO": "auto"}, type=str)
    config = RenderConfig(target=choice.NARROW, level=choice.AUTO)  # type: ignore[arg-type, attr-defined]
    assert (type(config.target), config.target, config.level) == (str, "16f", "auto")
    assert repr(config) == "RenderConfig(target='16f', level='auto')"


def test_fields_of_a_config_and_of_its_debug_change_together() -> None:
    changed = with_fields(RenderConfig(), debug=DebugConfig(eps2d=0.2), sort_bits=16, target="8")
    assert changed == RenderConfig(target="8", debug=DebugConfig(eps2d=0.2, sort_bits=16))
    with pytest.raises(GlsplatError, match="debug needs a DebugConfig"):
        with_fields(RenderConfig(), debug=5, sort_bits=16)


def test_a_mesh_prints_its_counts() -> None:
    mesh = upright(0, 1, (9, 9, 9))
    assert repr(mesh) == "RiggedMesh(4 vertices, 2 triangles, 1 joints)"


def test_quaternions_of_any_length_draw_the_same(renderer_of: Any) -> None:
    flat, turn = [[0.4, 0.02, 0.1]], np.array([[0.9, 0.1, 0.2, 0.4]])
    camera = Camera(VIEW, K, 64, 64)
    short = Splats([[0, 0, 0]], turn / np.linalg.norm(turn), flat, [0.9], [[[1, 1, 0]]])
    long = Splats([[0, 0, 0]], 3 * turn, flat, [0.9], [[[1, 1, 0]]])
    assert renderer_of(long).render([camera]) == pytest.approx(renderer_of(short).render([camera]), abs=1e-6)


def test_reprs_are_one_line() -> None:
    avatar = glsplat.default_avatar()
    reply = Reply(7, {0: bytes(20000), 1: bytes(30000)}, {"t": list(range(999))})
    for value in (avatar, avatar.splats, avatar.skin, avatar.skeleton, Pose.zero(), VALUES["camera"](), reply):
        text = repr(value)
        assert "\n" not in text and len(text) <= 120 and re.match(rf"{type(value).__name__}\(.*\)$", text), text


# -------------------------------------------------------------------------------------------------------- cameras

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


def test_a_camera_comes_back_from_json_as_it_was(tmp_path: Path) -> None:
    camera = Camera(VIEW, K, 64, 64, (0.1, 0.2, 0.3), 0.2, 50.0, 1, "left")
    (tmp_path / "a.json").write_text(json.dumps([camera.to_json(), Camera(VIEW, K, 64, 64).to_json()]))
    (again, plain), _ = read_cameras(tmp_path / "a.json")
    for name in camera.__dataclass_fields__:
        assert np.array_equal(getattr(again, name), getattr(camera, name)), name
    assert plain.far == 1e10 and plain.name == "" and "name" not in Camera(VIEW, K, 64, 64).to_json()
    refused(lambda: camera_from_json({**camera.to_json(), "name": 5}, "a.json"), "name is text")


def test_eyes_may_be_in_one_place() -> None:
    left, right = glsplat.stereo_cameras(np.eye(4), ipd=0)
    assert np.array_equal(left.viewmat, right.viewmat)
    assert glsplat.stereo_cameras(np.eye(4), ipd=np.float32(0.9))[0].position[0] == pytest.approx(-0.45)


# --------------------------------------------------------------------------------------------------------- poses

NAMES = {
    "global_orient": "root_pose",
    "transl": "trans",
    "left_hand_pose": "lhand_pose",
    "right_hand_pose": "rhand_pose",
}


def test_smplx_calls_the_same_things_by_its_own_names() -> None:
    rng = np.random.default_rng(1)
    counts = {"global_orient": 1, "transl": 1, "body_pose": 21, "left_hand_pose": 15, "right_hand_pose": 15}
    counts |= {"jaw_pose": 1, "leye_pose": 1, "reye_pose": 1}
    theirs = {name: rng.normal(0, 0.3, (count, 3)) for name, count in counts.items()}
    ours = Pose.from_smplx({NAMES.get(name, name): value for name, value in theirs.items()})
    assert ours.rotations.any(axis=1).all() and np.array_equal(ours.trans, theirs["transl"][0])
    shapes: list[Callable[[Any], Any]] = [
        lambda a: a, lambda a: a.reshape(-1), lambda a: a.reshape(1, -1), lambda a: a[None], lambda a: a.tolist(),
    ]  # fmt: skip
    for shape in shapes:
        pose = Pose.from_smplx({name: shape(value) for name, value in theirs.items()})
        assert np.array_equal(pose.rotations, ours.rotations) and np.array_equal(pose.trans, ours.trans)
    skeleton = glsplat.default_avatar().skeleton
    from_file = Pose.from_json({name: value.tolist() for name, value in theirs.items()}, skeleton)
    assert np.array_equal(from_file.rotations, ours.rotations)


def test_poses_that_could_mean_two_things_are_refused() -> None:
    for name, key in NAMES.items():
        joints = 15 if "hand" in name else 1
        refused(lambda: Pose.from_smplx({name: np.zeros((joints, 3)), key: np.zeros((joints, 3))}), name, key)  # noqa: B023


def test_the_root_alone_is_a_pose() -> None:
    for key in ("trans", "transl"):
        pose = Pose.from_smplx({key: [1, 2, 3]})
        assert pose.trans.tolist() == [1, 2, 3] and not pose.rotations.any()


# --------------------------------------------------------------------------------------------------------- skins


def test_a_skin_of_numpys_default_types_bends_like_the_same_in_the_renderers(renderer_of: Any) -> None:
    rng = np.random.default_rng(3)
    n, camera = 200, Camera(glsplat.look_at((0, 0.7, 4), (0, 0.7, 0)), K, 64, 64)
    means = rng.uniform((-0.3, 0, -0.3), (0.3, 1.5, 0.3), (n, 3))
    splats = Splats.create(means, np.tile(QUAT, (n, 1)), np.full((n, 3), 0.05), np.ones(n), rgb=rng.random((n, 3)))
    ids = rng.integers(0, 2, (n, 4))
    weights = rng.random((n, 4))
    pose = Pose([[0, 0, 0.4], [0.3, 0, -0.9]])
    total = weights / weights.sum(axis=1, keepdims=True)
    exact = Skin(ids.astype(np.uint16), total.astype(np.float32))
    expected = renderer_of(Avatar(splats, two_bones(), exact)).render([camera], pose)
    for skin in (Skin(ids, weights), Skin(ids.tolist(), weights.tolist()), Skin(ids.astype(np.int32), 7 * weights)):
        found = renderer_of(Avatar(splats, two_bones(), skin)).render([camera], pose)
        assert found == pytest.approx(expected, abs=2e-5)
    assert not np.allclose(renderer_of(Avatar(splats, two_bones(), exact)).render([camera]), expected)


@pytest.mark.parametrize(("given", "slots"), [(1, 1), (2, 2), (3, 4), (4, 4), (5, 8), (7, 8), (8, 8)])
def test_any_number_of_influences_up_to_eight(renderer_of: Any, given: int, slots: int) -> None:
    rng = np.random.default_rng(given)
    ids, weights = rng.integers(0, 2, (5, given)), rng.random((5, given))
    skin = Skin(ids, weights)
    assert skin.influences == slots
    wanted = np.zeros((5, 2))
    np.add.at(wanted, (np.arange(5)[:, None], ids), weights / weights.sum(axis=1, keepdims=True))
    assert skin.dense(2) == pytest.approx(wanted, abs=1e-6)
    splats = one_splat().take([0] * 5)
    assert renderer_of(Avatar(splats, two_bones(), skin)).render([Camera(VIEW, K, 64, 64)]).any()


def test_a_skin_that_is_right_already_keeps_its_bits() -> None:
    skin = glsplat.default_avatar().skin
    again = Skin(skin.joints.copy(), skin.weights.copy())
    assert np.array_equal(again.joints, skin.joints) and again.weights.tobytes() == skin.weights.tobytes()
    assert Skin([[1, 65535]], [[1.0, 0.0]]).joints.tolist() == [[1, 1]]  # binds nothing, so it names nothing
