"""Arguments of the public API that are refused, in one line that says what was expected."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Camera, Item, Pose, RenderConfig, Renderer, Scene, Skeleton, Skin, Splats
from glsplat.config import DebugConfig
from glsplat.net.client import Client
from glsplat.tracking import Tracker
from tests.api.test_values import VIEW, K, one_splat, refused, two_bones
from tests.scenes import cloud

NO_NUMBERS: list[Any] = ["2", b"2", True, np.True_, 1j, np.complex64(1), None, [1], np.array([1.0]), {}, object()]
NO_NUMBERS += [10**400, np.datetime64("2020"), memoryview(b"ab"), float]
NO_SIZES: list[Any] = [64, 64.0, "64", (64,), (64, 48, 3), (64.0, 48.0), (64, True), ("6", "4"), (0, 4), (-1, 4), {}]
NO_SWITCHES: list[Any] = ["no", "", 0, 1, 1.0, None, [], [False], np.array([True]), object()]
URL = "ws://localhost:1/ws"
EYE = np.eye(4)


def masked(values: Any) -> Any:
    mask = np.zeros(np.shape(values), bool)
    mask.flat[0] = True
    return np.ma.masked_array(values, mask)


# the argument as it has to be, and a call with another
ARRAYS: dict[str, tuple[Any, Callable[[Any], Any]]] = {
    "means": ([[0, 0, 0]], lambda v: one_splat(means=v)),
    "quats": ([[1.0, 0, 0, 0]], lambda v: one_splat(quats=v)),
    "scales": ([[0.1, 0.1, 0.1]], lambda v: one_splat(scales=v)),
    "opacities": ([0.9], lambda v: one_splat(opacities=v)),
    "rgb": ([[1, 0, 0]], lambda v: one_splat(rgb=v)),
    "sh": (np.zeros((1, 1, 3)), lambda v: one_splat(rgb=None, sh=v)),
    "viewmat": (VIEW, lambda v: Camera(v, K, 64, 64)),
    "K": (K, lambda v: Camera(VIEW, v, 64, 64)),
    "background": ([0.5, 0.5, 0.5], lambda v: Camera(VIEW, K, 64, 64, background=v)),
    "eye": ([0.0, 0.0, 3.0], lambda v: glsplat.look_at(v, (0, 0, 0))),
    "head": (EYE, glsplat.stereo_cameras),
    "rotations": (np.zeros((2, 3)), Pose),
    "trans": (np.zeros(3), lambda v: Pose([[0, 0, 0]], v)),
    "smplx": (np.zeros((21, 3)), lambda v: Pose.from_smplx({"body_pose": v})),
    "parents": ([-1, 0], lambda v: Skeleton(["a", "b"], v, np.tile(EYE, (2, 1, 1)))),
    "joints": ([[0.0, 0, 0], [0, 1, 0]], lambda v: Skeleton.from_joints(["a", "b"], [-1, 0], v)),
    "skin": ([[0, 1]], lambda v: Skin(v, [[0.5, 0.5]])),
    "weights": ([[0.75, 0.25]], lambda v: Skin([[0, 1]], v)),
    "translation": ([1.0, 2, 3], glsplat.similarity),
    "rotation": ([0.0, 0, 0, 1], lambda v: glsplat.similarity(rotation=v)),
    "transform": (EYE, lambda v: Item(cloud(5), transform=v)),
    "moved": (EYE, lambda v: setattr(Item(cloud(5)), "transform", v)),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_of_anything_but_numbers(name: str) -> None:
    good, call = ARRAYS[name]
    good = np.array(good)
    call(good)
    call(np.ma.masked_array(good, np.zeros(good.shape, bool)))  # nothing is masked
    refused(lambda: call(masked(good)), "mask")
    if good.ndim > 1:
        refused(lambda: call([masked(row) for row in good]), "mask")
    nothing = [] if name == "transform" else [None]  # where it stands as it was loaded
    others = [good.astype(kind) for kind in (complex, bool, str, object)]
    odd = ["1", iter([1]), [1, [2, 3]], memoryview(b"ab"), 10**400, np.datetime64("2020"), object(), np.full(3, np.nan)]
    for other in (*others, *nothing, *odd):
        refused(lambda other=other: call(other))


SCALARS: dict[str, tuple[Callable[[Any], Any], list[Any]]] = {
    "width": (lambda v: Camera(VIEW, K, v, 64), [0, -1, 1.5]),
    "near": (lambda v: Camera(VIEW, K, 64, 64, near=v), [0, np.nan]),
    "sh_degree": (lambda v: Camera(VIEW, K, 64, 64, sh_degree=v), [4, -1, 1.5]),
    "pinhole": (lambda v: glsplat.pinhole(v, 64), [0]),
    "fov": (lambda v: glsplat.pinhole(64, 64, v), [0, 180, np.nan]),
    "ipd": (lambda v: glsplat.stereo_cameras(EYE, ipd=v), [63, 6.3, 2.1, -0.063, np.nan, np.inf]),
    "scale": (lambda v: glsplat.similarity(scale=v), [np.nan, np.inf, 0, -1, 1e-7, 1e7]),
    "joint_count": (lambda v: Skin.create([[0]], [[1.0]], v), [0.5, 0, -1]),
    "zero": (Pose.zero, [-1, 0.5]),
    "eps2d": (lambda v: DebugConfig(eps2d=v), [np.nan]),
    "sort_period": (lambda v: DebugConfig(sort_period=v), [2.0]),
    "timeout": (lambda v: Client(URL, timeout=v), [0, -1, -0.5, np.nan, np.inf]),
}


@pytest.mark.parametrize("name", SCALARS)
def test_numbers_that_are_none_or_out_of_range(name: str) -> None:
    call, out_of_range = SCALARS[name]
    for value in NO_NUMBERS + out_of_range:
        refused(lambda value=value: call(value))


@pytest.mark.parametrize("size", NO_SIZES)
def test_sizes(size: Any) -> None:
    refused(lambda: glsplat.stereo_cameras(EYE, size=size), "size")
    refused(lambda: Renderer(cloud(5), size=size), "size")


@pytest.mark.parametrize("switch", NO_SWITCHES)
def test_switches(switch: Any) -> None:
    item = Item(cloud(5))
    refused(lambda: Item(cloud(5), visible=switch), "visible")
    refused(lambda: setattr(item, "visible", switch), "visible")
    refused(lambda: one_splat(antialias=switch), "antialias")
    refused(lambda: Tracker(glsplat.default_avatar().skeleton, head_only=switch), "head_only")
    refused(lambda: Client(URL, mirror=switch), "mirror")
    assert item.visible is True
    item.visible = np.False_  # type: ignore[assignment]
    assert item.visible is False


@pytest.mark.parametrize(
    "arguments",
    [
        ((0, 0, 3), (0, 0, 0), (0, 0, 0)), ((0, 0, 3), (1e200, 0, 0)), ((0, 0, 3), (1e13, 0, 0)),
        ((1e160, 0, 3), (0, 0, 0)), ((0, 0, 3), (0, 0, 3)), ((1e6, 0, 0), (1e6, 0, 1e-12)),
        ((0, 0, 3), (0, 0, 1j)), ((0, 0, 3), [0, np.ma.masked, 0]), ((0, np.nan, 0), (0, 0, 0)),
    ],
)  # fmt: skip
def test_look_at_without_a_direction(arguments: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refused(lambda: glsplat.look_at(*arguments))


@pytest.mark.parametrize("off", [1e-3, 5e-4, 1e-4, -1e-3])
def test_rotations_that_are_not_orthonormal(off: float) -> None:
    for change in (np.full((3, 3), off / 2), np.eye(3) * off, np.outer([1, 0, 0], [0, off, 0])):
        view = VIEW.copy()
        view[:3, :3] += change
        refused(lambda view=view: Camera(view, K, 64, 64), "R R^T is off by")
    turned = glsplat.look_at((0.3, 0.4, 3), (0.1, 0, 0))
    for digits in (5, 6, 7):
        assert Camera(turned.round(digits), K, 64, 64)
    assert Camera(turned.astype(np.float32), K, 64, 64)


@pytest.mark.parametrize(
    "background", [(255, 0, 0), [0, 128, 0], (0, 0, -2), np.uint8([9, 9, 9]), "red", (1, 1), 1, 1j]
)
def test_backgrounds(background: Any) -> None:
    refused(lambda: Camera(VIEW, K, 64, 64, background=background), "background")
    refused(lambda: glsplat.stereo_cameras(EYE, background=background), "background")
    refused(lambda: glsplat.straight(np.zeros((2, 2, 4), np.uint8), background=background), "background")


@pytest.mark.parametrize("shape", [(3,), (1, 3), (2, 1), (3, 2), (1, 2, 3), (2, 4), ()])
def test_translations_of_another_shape(shape: tuple[int, ...]) -> None:
    refused(lambda: Pose(np.zeros((2, 3)), translations=np.zeros(shape)), "(2, 3)")
    refused(lambda: two_bones().forward(np.zeros((2, 3)), translations=np.zeros(shape)), "(2, 3)")


@pytest.mark.parametrize("angle", [180, 90.0, -90, 360])
def test_degrees(angle: float) -> None:
    for rotations in (np.full((2, 3), angle), [[0, 0, 0], [0, angle, 0]]):
        refused(lambda rotations=rotations: Pose(rotations), "radians, not degrees")
    refused(lambda: Pose.from_smplx({"body_pose": np.full((21, 3), angle)}), "radians, not degrees")
    assert Pose([[0, 20 * np.pi, 0]])


def test_matrices_of_the_other_convention() -> None:
    refused(lambda: Camera(VIEW.T, K, 64, 64), "last row 0 0 0 1")
    moved = np.eye(4)
    moved[3, :3] = 0, 1, 0  # translation in the last row
    refused(lambda: Skeleton(["a"], [-1], [moved]), "last row 0 0 0 1", "transpose")


def test_colours_and_opacities_of_0_to_255() -> None:
    for rgb in ([[255, 128, 0]], np.array([[200, 3, 9]], np.uint8), [[255.0, 0.0, 0.0]]):
        refused(lambda rgb=rgb: one_splat(rgb=rgb), "0 to 1", "by 255", "sh")
    assert len(one_splat(rgb=[[1.3, -0.2, 0.5]])) == 1
    for opacities in ([255], np.array([255], np.uint8), np.array([128])):
        refused(lambda opacities=opacities: one_splat(opacities=opacities), "opacities needs 0 to 1", "255")
        refused(lambda opacities=opacities: replace(one_splat(), opacities=opacities), "opacities needs 0 to 1")
    assert replace(one_splat(), opacities=[1.5]).opacities.tolist() == [1.5]


MANY: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    "names as text": (lambda: Skeleton("ab", [-1, 0], [EYE] * 2), ("sequence",)),
    "half a parent": (lambda: Skeleton(["a", "b"], [-1, 0.5], [EYE] * 2), ("whole numbers",)),
    "one mean": (lambda: one_splat(means=[0, 0, 0]), ("means",)),
    "two opacities": (lambda: one_splat(opacities=[[1.0, 1.0]]), ("opacities",)),
    "one colour": (lambda: one_splat(rgb=[1, 0, 0]), ("rgb", "(N, 3)")),
    "no colour": (lambda: one_splat(rgb=None), ("exactly one of sh and rgb",)),
    "cones": (lambda: one_splat(cones=[[0.5, 0, 0, 0]]), ("cones",)),
    "large joint": (lambda: Skin([[70000]], [[1.0]]), ("65535", "70000")),
    "negative joint": (lambda: Skin([[-1]], [[1.0]]), ("65535",)),
    "half a joint": (lambda: Skin([[0.5]], [[1.0]]), ("whole numbers",)),
    "half a joint, created": (lambda: Skin.create([[0.5]], [[1.0]], 2), ("whole numbers",)),
    "negative weight": (lambda: Skin([[0, 1]], [[0.5, -0.25]]), ("Skin.create",)),
    "weight of NaN": (lambda: Skin([[0, 1]], [[0.5, np.nan]]), ("Skin.create",)),
    "no weight": (lambda: Skin([[0, 1], [0, 1]], [[1, 0], [0, 0]]), ("splat 1 has no weight",)),
    "nine influences": (lambda: Skin(np.zeros((1, 9), int), np.ones((1, 9))), ("influences=8",)),
    "other weights": (lambda: Skin([[0, 1]], [[1.0]]), ("one shape",)),
    "avatar of a skin": (lambda: Avatar(Skin([[0]], [[1.0]]), two_bones(), one_splat()), ("splats needs a Splats",)),  # type: ignore[arg-type]
    "avatar of nothing": (lambda: Avatar(one_splat(), None, Skin([[0]], [[1.0]])), ("skeleton needs a Skeleton",)),  # type: ignore[arg-type]
    "trans [1, 3]": (lambda: Pose(np.zeros((2, 3)), trans=np.zeros((1, 3))), ("(3,)",)),
    "a hand of PCA": (lambda: Pose.from_smplx({"left_hand_pose": np.zeros(6)}), ("15 x 3", "PCA")),
    "a body [3, 21]": (lambda: Pose.from_smplx({"body_pose": np.zeros((3, 21))}), ("21 x 3",)),
    "two bodies": (lambda: Pose.from_smplx({"body_pose": np.zeros((2, 63))}), ("21 x 3",)),
    "a jaw [3, 1]": (lambda: Pose.from_smplx({"jaw_pose": np.zeros((3, 1))}), ("1 x 3",)),
    "no key": (lambda: Pose.from_smplx({"theta": [0, 0, 0]}), ("root_pose",)),
    "betas": (lambda: Pose.from_smplx({"betas": [1.0] * 10}), ("trans; found betas",)),
    "a list of poses": (lambda: Pose.from_smplx([1, 2]), ("mapping",)),  # type: ignore[arg-type]
    "transl of NaN": (lambda: Pose.from_smplx({"root_pose": [0, 0, 0], "transl": [np.nan, 0, 0]}), ()),
    "transl of two": (lambda: Pose.from_smplx({"root_pose": [0, 0, 0], "transl": [0, 0]}), ()),
    "a switch as 1": (lambda: RenderConfig(cull_hidden=1), ("cull_hidden",)),  # type: ignore[arg-type]
    "no influences": (lambda: DebugConfig(influences=False), ("influences",)),
    "complex influences": (lambda: DebugConfig(influences=np.complex64(1)), ("influences", "0, 1, 2, 4, 8")),
    "sort bits of a float": (lambda: DebugConfig(sort_bits=32.0), ("sort_bits",)),  # type: ignore[arg-type]
    "a degree as True": (lambda: RenderConfig(sh_degree=True), ("sh_degree",)),
    "a switch as a number": (lambda: RenderConfig(antialias=np.int64(1)), ("antialias",)),  # type: ignore[arg-type]
    "a debug setting": (lambda: RenderConfig(debug={"fetch": "auto"}), ("debug needs a DebugConfig",)),  # type: ignore[arg-type]
    "targets": (lambda: RenderConfig(target=["8"]), ("target",)),  # type: ignore[arg-type]
    "a level": (lambda: RenderConfig(level=17), ("level",)),
    "no sigma": (lambda: RenderConfig(max_sigma=0), ("max_sigma needs a number above 0, at most 3.33, not 0",)),
    "a large sigma": (lambda: RenderConfig(max_sigma=4), ("max_sigma needs a number above 0, at most 3.33, not 4",)),
    "half a level": (lambda: RenderConfig(level=1.5), ("level",)),  # type: ignore[arg-type]
    "a bias": (lambda: RenderConfig(lod_bias=-9), ("lod_bias",)),
    "a scene of splats": (lambda: Scene(cloud(5)), ("Item",)),  # type: ignore[arg-type]
    "a scene of numbers": (lambda: Scene([5]), ("Item",)),  # type: ignore[list-item]
    "an item's name": (lambda: Item(cloud(5), name=b"Ann"), ("name",)),  # type: ignore[arg-type]
    "no context": (lambda: glsplat.create_context(given="egl"), ("given needs a Context",)),  # type: ignore[arg-type]
    "half a device": (lambda: glsplat.create_context(device=1.5), ("device",)),  # type: ignore[arg-type]
    "a backend": (lambda: glsplat.create_context(backend=5), ("backend",)),  # type: ignore[arg-type]
    "an avatar to track": (lambda: Tracker(glsplat.default_avatar()), ("Skeleton, not Avatar", ".skeleton")),  # type: ignore[arg-type]
    "a calibration": (lambda: Tracker(glsplat.default_avatar().skeleton, {"scale": 1}), ("Calibration",)),  # type: ignore[arg-type]
    "a tracker's config": (lambda: Tracker(glsplat.default_avatar().skeleton, None, {"gap": 1}), ("TrackerConfig",)),  # type: ignore[arg-type]
}  # fmt: skip


@pytest.mark.parametrize("name", MANY)
def test_what_is_refused(name: str) -> None:
    call, words = MANY[name]
    refused(call, *words)


@pytest.mark.parametrize("index", [[0.7], [1], [-2], ["a"], [[0]], [True, False], 0, None], ids=str)
def test_indices_of_take(index: Any) -> None:
    refused(lambda: one_splat().take(index), "take()")


@pytest.mark.parametrize("token", ["a\n", "a\r\nX-Admin: 1", "a b", "\u00e4", "\0", 5, b"token", ["a"]])
def test_tokens(token: Any) -> None:
    refused(lambda: Client(URL, token), "token")


@pytest.mark.parametrize(
    "given",
    [
        {"window": 0}, {"window": 1.5}, {"window": "2"}, {"height": "tall"}, {"span": np.nan}, {"at": 5},
        {"at": (1, 2)}, {"at": "123"}, {"at": (1, 2, "3")}, {"url": 5}, {"url": None}, {"url": "localhost"},
        {"url": b"ws://localhost:1/ws"},
    ],
)  # fmt: skip
def test_options_of_a_client(given: dict[str, Any]) -> None:
    refused(lambda: Client(**{"url": URL, **given}))


def test_splats_of_nothing_are_none() -> None:
    empty = Splats.create([], [], [], [], rgb=[])
    assert (len(empty), empty.sh_degree, empty.means.shape) == (0, 0, (0, 3))
    assert len(Splats.create([], [], [], [], sh=[])) == 0
    assert len(one_splat().take([])) == 0 and len(one_splat().take([True])) == 1
