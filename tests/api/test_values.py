"""Programs a library user writes about values: each is right, or refused in one line; nothing changes afterwards."""

from __future__ import annotations

import copy
import itertools
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Camera, GlsplatError, Pose, RenderConfig, Skeleton, Skin, Splats
from glsplat.camera import head_matrix
from glsplat.net.reply import Reply

VIEW = glsplat.look_at((0, 0, 3), (0, 0, 0))
K = glsplat.pinhole(64, 64, 50)
QUAT, SIZE = [[1.0, 0, 0, 0]], [[0.1, 0.1, 0.1]]
NOT_NUMBERS: list[Any] = [None, "abc", True, 1j, object(), {"a": 1}, [1, [2, 3]], ["1", "2"], [None, 1.0], iter([1])]


def one_splat(**changes: Any) -> Splats:
    parts: dict[str, Any] = {
        "means": [[0, 0, 0]],
        "quats": QUAT,
        "scales": SIZE,
        "opacities": [0.9],
        "rgb": [[1, 0, 0]],
    }
    return Splats.create(**{**parts, **changes})


def two_bones() -> Skeleton:
    return Skeleton.from_joints(["a", "b"], [-1, 0], [[0, 0, 0], [0, 1, 0]])


def refused(make: Callable[[], Any], *words: str) -> str:
    with pytest.raises(GlsplatError) as caught:
        make()
    text = str(caught.value)
    assert "\n" not in text and len(text) < 300, text
    for word in words:
        assert word in text, f"{word!r} is not in {text!r}"
    return text


VALUES: dict[str, Callable[[], Any]] = {
    "camera": lambda: Camera(VIEW, K, 64, 64, name="left"),
    "pose": lambda: Pose(np.full((2, 3), 0.1), [1, 2, 3], np.full((2, 3), 0.2)),
    "skin": lambda: Skin([[0, 1], [1, 0]], [[0.5, 0.5], [1, 0]]),
    "skeleton": two_bones,
    "splats": lambda: replace(one_splat(), cones=np.array([[1, 2, 3, 4]], np.int8), antialias=True),
    "avatar": lambda: Avatar(one_splat(), two_bones(), Skin([[0, 1]], [[0.75, 0.25]]), {"source": "here"}),
    "config": lambda: RenderConfig(cull_hidden=True, eps2d=np.float32(0.25)),
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
    made = [value, pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value), replace(value)]
    made += [pickle.loads(pickle.dumps(value, protocol)) for protocol in (2, 5)]
    for other in made:
        assert type(other) is type(value) and repr(other) == repr(value)
        assert arrays_of(other).keys() == arrays_of(value).keys()
        for where, array in arrays_of(other).items():
            assert np.array_equal(array, arrays_of(value)[where]) and array.dtype == arrays_of(value)[where].dtype
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
    assert arrays_of(value) or name == "config"


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


def test_a_pose_keeps_the_tracker_and_the_file_from_each_other() -> None:
    pose = Pose.zero(3)
    with pytest.raises(ValueError, match="read-only"):
        pose.rotations[1] = 1
    assert replace(pose, trans=[1, 0, 0]).rotations is pose.rotations


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
    camera = Camera(
        VIEW,
        K,
        np.int64(64),
        np.uint8(64),
        near=np.float32(0.5),
        far=np.int32(9),
        sh_degree=np.int8(2),
        background=np.ones(3),
    )
    assert (camera.width, camera.height, camera.far, camera.sh_degree) == (64, 64, 9.0, 2)
    assert [type(v) for v in (camera.width, camera.near, camera.far, camera.sh_degree)] == [int, float, float, int]
    assert np.array_equal(glsplat.pinhole(np.int32(64), np.int64(64), np.float64(50)), K)
    left, right = glsplat.stereo_cameras(np.eye(4, dtype=np.float32), np.float32(0.5), size=(np.int32(8), np.int64(8)))
    assert right.position[0] - left.position[0] == 0.5


def test_a_white_background_given_as_a_list_is_drawn(renderer_of: Any) -> None:
    camera = Camera(glsplat.look_at((0, 0, 3), (0, 0, 9)), K, 64, 64, background=[1, 1, 1])
    assert (renderer_of(one_splat()).render([camera])[..., :3] == 1).all()


# ------------------------------------------------------------------------------------------------ or it is refused


@pytest.mark.parametrize("bad", NOT_NUMBERS, ids=lambda b: f"{type(b).__name__} {b!r:.12}")
def test_what_is_no_number_is_refused_in_one_line(bad: Any) -> None:
    makers: list[Callable[[], Any]] = [
        lambda: Camera(bad, K, 64, 64),
        lambda: Camera(VIEW, bad, 64, 64),
        lambda: Camera(VIEW, K, bad, 64),
        lambda: Camera(VIEW, K, 64, 64, background=bad),
        lambda: Camera(VIEW, K, 64, 64, near=bad),
        lambda: Camera(VIEW, K, 64, 64, sh_degree=bad),
        lambda: Pose(bad),
        lambda: Pose(np.zeros((2, 3)), bad),
        lambda: Pose.from_smplx({"root_pose": bad}),
        lambda: Skin(bad, [[1.0]]),
        lambda: Skin([[0]], bad),
        lambda: Skin.create(bad, [[1.0]], 2),
        lambda: Skin.create([[0]], bad, 2),
        lambda: one_splat(means=bad),
        lambda: one_splat(opacities=bad),
        lambda: Skeleton.from_joints(["a"], [-1], bad),
        lambda: Skeleton(["a"], bad, [np.eye(4)]),
        lambda: Skeleton(["a"], [-1], bad),
        lambda: glsplat.look_at(bad, (0, 0, 0)),
        lambda: glsplat.pinhole(bad, 64),
        lambda: glsplat.pinhole(64, 64, bad),
        lambda: glsplat.stereo_cameras(bad),
        lambda: glsplat.stereo_cameras(np.eye(4), bad),
        lambda: glsplat.stereo_cameras(np.eye(4), size=bad),
        lambda: RenderConfig(eps2d=bad),
        lambda: RenderConfig(sort_period=bad),
        lambda: RenderConfig(sh_degree=bad),
        lambda: RenderConfig(target=bad),
        lambda: glsplat.straight(bad),
    ]  # fmt: skip
    for make in makers:
        refused(make)
    for make in (lambda: Skin.create([[0]], [[1.0]], bad), lambda: Pose.zero(bad)):
        refused(make)
    refused(lambda: Skeleton(bad, [-1], [np.eye(4)]))
    refused(lambda: head_matrix(bad, (0, 0, 0, 1)))
    refused(lambda: head_matrix((0, 0, 0), bad))
    if bad is not None:
        refused(lambda: one_splat(rgb=bad))
        refused(lambda: Pose(np.zeros((2, 3)), translations=bad))
        refused(lambda: Skeleton(["a"], [-1], [np.eye(4)], bad))


@pytest.mark.parametrize("shape", [(3,), (1, 3), (2, 1), (3, 2), (1, 2, 3), (2, 4), ()])
def test_translations_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    refused(lambda: Pose(np.zeros((2, 3)), translations=np.zeros(shape)), "(2, 3)")
    refused(lambda: two_bones().forward(np.zeros((2, 3)), translations=np.zeros(shape)), "(2, 3)")
    refused(lambda: Pose(np.zeros((2, 3)), trans=np.zeros((1, 3))), "(3,)")


def test_a_matrix_of_the_other_convention_is_refused() -> None:
    refused(lambda: Camera(VIEW.T, K, 64, 64), "last row 0 0 0 1")
    moved = np.eye(4)
    moved[3, :3] = 0, 1, 0  # translation in the last row
    refused(lambda: Skeleton(["a"], [-1], [moved]), "last row 0 0 0 1", "transpose")
    refused(lambda: Skeleton("ab", [-1, 0], [np.eye(4)] * 2), "sequence")
    refused(lambda: Skeleton(["a", "b"], [-1, 0.5], [np.eye(4)] * 2), "whole numbers")
    refused(lambda: glsplat.look_at((0, np.nan, 0), (0, 0, 0)), "finite")


def test_colours_of_0_to_255_are_refused_with_a_hint() -> None:
    for rgb in ([[255, 128, 0]], np.array([[200, 3, 9]], np.uint8), [[255.0, 0.0, 0.0]]):
        refused(lambda rgb=rgb: one_splat(rgb=rgb), "0 to 1", "by 255", "sh")  # type: ignore[misc]
    assert len(one_splat(rgb=[[1.3, -0.2, 0.5]])) == 1 and len(one_splat(rgb=[[1, 0, 1]])) == 1


def test_splats_of_nothing_and_of_wrong_shapes() -> None:
    empty = Splats.create([], [], [], [], rgb=[])
    assert (len(empty), empty.sh_degree, empty.means.shape) == (0, 0, (0, 3))
    assert len(Splats.create([], [], [], [], sh=[])) == 0
    refused(lambda: one_splat(means=[0, 0, 0]), "means")
    refused(lambda: one_splat(opacities=[[1.0, 1.0]]), "opacities")
    refused(lambda: one_splat(rgb=[1, 0, 0]), "rgb", "(N, 3)")
    refused(lambda: one_splat(rgb=None), "exactly one of sh and rgb")
    refused(lambda: one_splat(cones=[[0.5, 0, 0, 0]]), "cones")
    refused(lambda: one_splat(antialias="yes"), "antialias")
    for index in ([0.7], [1], [-2], ["a"], [[0]], [True, False], 0, None):
        refused(lambda index=index: one_splat().take(index), "take()")  # type: ignore[misc]
    assert len(one_splat().take([])) == 0 and len(one_splat().take([True])) == 1


def test_quaternions_of_any_length_draw_the_same(renderer_of: Any) -> None:
    flat, turn = [[0.4, 0.02, 0.1]], np.array([[0.9, 0.1, 0.2, 0.4]])
    camera = Camera(VIEW, K, 64, 64)
    short = Splats([[0, 0, 0]], turn / np.linalg.norm(turn), flat, [0.9], [[[1, 1, 0]]])
    long = Splats([[0, 0, 0]], 3 * turn, flat, [0.9], [[[1, 1, 0]]])
    assert renderer_of(long).render([camera]) == pytest.approx(renderer_of(short).render([camera]), abs=1e-6)


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
    single = Pose.from_smplx({name: value.astype(np.float32) for name, value in theirs.items()})
    assert single.rotations == pytest.approx(ours.rotations, abs=1e-6) and single.rotations.dtype == np.float64


def test_poses_that_could_mean_two_things_are_refused() -> None:
    for name, key in NAMES.items():
        joints = 15 if "hand" in name else 1
        refused(lambda: Pose.from_smplx({name: np.zeros((joints, 3)), key: np.zeros((joints, 3))}), name, key)  # noqa: B023
    refused(lambda: Pose.from_smplx({"left_hand_pose": np.zeros(6)}), "15 x 3", "PCA")
    refused(lambda: Pose.from_smplx({"body_pose": np.zeros((3, 21))}), "21 x 3")
    refused(lambda: Pose.from_smplx({"body_pose": np.zeros((2, 63))}), "21 x 3")
    refused(lambda: Pose.from_smplx({"jaw_pose": np.zeros((3, 1))}), "1 x 3")
    refused(lambda: Pose.from_smplx({"theta": [0, 0, 0]}), "root_pose")
    refused(lambda: Pose.from_smplx([1, 2]), "mapping")  # type: ignore[arg-type]
    for trans in ([0, 0], [[0, 0, 0], [0, 0, 0]], [np.nan, 0, 0]):
        refused(lambda trans=trans: Pose.from_smplx({"root_pose": [0, 0, 0], "transl": trans}))  # type: ignore[misc]


# -------------------------------------------------------------------------------------------------- knobs and prints


def test_a_switch_is_no_number_and_a_number_no_switch() -> None:
    assert RenderConfig(antialias=np.True_).antialias is True  # type: ignore[arg-type]
    assert type(RenderConfig(sort_bits=np.int64(16)).sort_bits) is int  # type: ignore[arg-type]
    wrong: list[dict[str, Any]] = [
        {"sh_degree": True}, {"cull_hidden": 1}, {"influences": False}, {"eps2d": np.nan}, {"eps2d": "0.3"},
        {"max_sigma": None}, {"sort_period": 2.0}, {"target": ["8"]}, {"target": np.array(["8", "16f"])},
    ]  # fmt: skip
    for change in wrong:
        refused(lambda change=change: RenderConfig(**change), next(iter(change)))  # type: ignore[misc]


def test_reprs_are_one_line_that_says_what_it_is() -> None:
    avatar = glsplat.default_avatar()
    pictures = {0: bytes(20000), 1: bytes(30000)}
    values = [
        avatar, avatar.splats, avatar.skin, avatar.skeleton, Pose.zero(), Camera(VIEW, K, 64, 64, name="left"),
        RenderConfig(), RenderConfig(target="32f", cull_hidden=True), Reply(7, pictures, {"t": list(range(999))}),
    ]  # fmt: skip
    for value in values:
        text = repr(value)
        assert "\n" not in text and len(text) <= 120 and re.match(rf"{type(value).__name__}\(.*\)$", text), text
    assert repr(values[0]).startswith(f"Avatar({len(avatar.splats)} splats, 55 joints")
    assert repr(RenderConfig(cull_hidden=True)) == "RenderConfig(cull_hidden=True)"
    assert "frame 7" in repr(values[-1]) and "30000 bytes" in repr(values[-1])


def test_names_and_values_of_any_order_pickle_between_processes() -> None:
    """What ProcessBackend sends to the process it spawns, and gets back."""
    avatar = glsplat.default_avatar()
    there = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(avatar))))
    for (name, mine), (_, theirs) in zip(arrays_of(avatar).items(), arrays_of(there).items(), strict=True):
        assert mine.tobytes() == theirs.tobytes() and not theirs.flags.writeable, name
    pose = Pose(np.full((55, 3), 0.01))
    assert np.array_equal(there.skeleton.forward(pose.rotations), avatar.skeleton.forward(pose.rotations))


def test_every_pair_of_bad_arguments_still_gives_one_line() -> None:
    for first, second in itertools.product(NOT_NUMBERS[:6], repeat=2):
        refused(lambda a=first, b=second: Camera(a, b, 64, 64))  # type: ignore[misc]
        refused(lambda a=first, b=second: Skin(a, b))  # type: ignore[misc]
        refused(lambda a=first, b=second: Pose(a, b))  # type: ignore[misc]
