"""Shapes and expressions as values: what is kept, what is refused, what weights mean."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.errors import FormatError, PoseError
from glsplat.skinning.expression import ARKIT, arkit_name, checked_expression
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.splats import Level
from tests.skinning.faces import NAMES, expressive, random_shapes


def test_names_of_others() -> None:
    assert len(set(ARKIT)) == 52
    for name in ARKIT:
        assert arkit_name(name) == name == arkit_name(name[0].upper() + name[1:])
    theirs = {
        "eyeBlink_L": "eyeBlinkLeft", "blendShape1.jaw_open": "jawOpen", "blinkRight": "eyeBlinkRight",
        "Face.M_F00_000_MouthSmile_R": "mouthSmileRight", "mouthOpen": None, "": None, "left": None,
    }  # fmt: skip
    assert {name: arkit_name(name) for name in theirs} == theirs


def test_an_expression_is_named_or_in_order() -> None:
    numbers = np.zeros(52)
    numbers[17] = 0.5
    assert dict(checked_expression(numbers)) == {"jawOpen": 0.5}
    assert dict(checked_expression({"jawOpen": 0.5, "cheekPuff": 0})) == {"jawOpen": 0.5}
    assert dict(checked_expression(None)) == {}


@pytest.mark.parametrize(
    "bad",
    [
        {"jawOpen": float("nan")},
        {"jawOpen": float("inf")},
        {"jawOpen": "0.5"},
        {"jawOpen": True},
        {"jawOpen": None},
        {"jawOpen": [1]},
        {"": 1.0},
        {"x" * 65: 1.0},
        {3: 1.0},
        dict.fromkeys(map(str, range(257)), 1.0),
        [0.5] * 51,
        "jawOpen",
        7,
    ],
)
def test_what_is_no_expression_is_refused_in_a_line(bad: Any) -> None:
    with pytest.raises(PoseError) as caught:
        Pose(np.zeros((2, 3)), expression=bad)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


def test_a_pose_keeps_its_expression() -> None:
    pose = Pose.from_smplx({"expression": {"jawOpen": 0.25}})
    assert Pose.from_smplx(pose.to_smplx()).expression == {"jawOpen": 0.25} == replace(pose, trans=[1, 0, 0]).expression
    for again in (copy.deepcopy(pose), pickle.loads(pickle.dumps(pose))):
        assert dict(again.expression) == {"jawOpen": 0.25}
    with pytest.raises(TypeError):
        pose.expression["jawOpen"] = 1.0  # type: ignore[index]
    skeleton = expressive().skeleton
    assert Pose.from_json({"joints": {}, "expression": {"a": 2}}, skeleton).expression == {"a": 2.0}


@pytest.mark.parametrize("weight, drawn", [(0, 0), (1, 1), (2, 1), (-1, 0), (0.3, 0.3)])
def test_weights_stay_within_the_limits(weight: float, drawn: float) -> None:
    shapes = random_shapes(10)
    found = shapes.weights({"jawOpen": weight, "unknown": 1.0})
    assert (found is None) == (drawn == 0)
    if found is not None:
        assert found.tolist() == [drawn, 0, 0, 0]


def test_metres_and_axes_come_back_rounded() -> None:
    rng = np.random.default_rng(0)
    splats, moves, bends = rng.permutation(60)[:50], rng.normal(0, 0.02, (50, 3)), rng.uniform(-2, 2, (50, 2, 3))
    shapes = Shapes.create(["a"], 60, splats=splats, targets=np.zeros(50), moves=moves, bends=bends)
    order = np.argsort(splats)
    assert np.array_equal(shapes.rows, splats[order])
    assert shapes.metres == pytest.approx(moves[order], abs=0.52 * float(shapes.sizes[0]))
    assert shapes.bends * BEND == pytest.approx(bends[order], abs=0.51 * BEND)


def test_what_does_nothing_is_left_out() -> None:
    shapes = Shapes.create(["a", "b"], 3, splats=[0, 1, 2], targets=[0, 0, 1], moves=[[1, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert len(shapes.targets) == 1 and len(shapes) == 2


def test_rows_are_taken_unchanged() -> None:
    shapes = random_shapes(40)
    index = np.array([3, 3, 39, 0])
    some = shapes.take(index)
    for place, row in enumerate(index):
        one, other = slice(*some.starts[place : place + 2]), slice(*shapes.starts[row : row + 2])
        for name in ("targets", "moves", "bends"):
            assert np.array_equal(getattr(some, name)[one], getattr(shapes, name)[other])
    assert shapes.take(np.zeros(40, bool)).splats == 0


BAD: dict[str, dict[str, Any]] = {
    "no name": {"names": []},
    "a name twice": {"names": ["a", "a", "b", "c"]},
    "names of numbers": {"names": [1, 2, 3, 4]},
    "too many names": {"names": [str(i) for i in range(257)]},
    "starts that fall": {"starts": np.r_[0, 5, 3, np.full(8, 99)]},
    "starts beyond the entries": {"starts": np.r_[np.zeros(10, int), 10**9]},
    "a target that is not there": {"targets": np.full(len(random_shapes(10, share=0.7).targets), 4)},
    "a target twice": {"targets": np.zeros(len(random_shapes(10, share=0.7).targets), int)},
    "too few moves": {"moves": np.zeros((1, 3), int)},
    "moves of fractions": {"moves": np.full((len(random_shapes(10, share=0.7).targets), 3), 0.5)},
    "bends of another shape": {"bends": np.zeros((len(random_shapes(10, share=0.7).targets), 6), int)},
    "sizes of NaN": {"sizes": np.full(4, np.nan)},
    "sizes of kilometres": {"sizes": np.full(4, 1.0)},
    "limits of NaN": {"limits": np.full((4, 2), np.nan)},
    "limits without 0": {"limits": np.full((4, 2), 0.5)},
}


@pytest.mark.parametrize("what", BAD)
def test_what_are_no_shapes_is_refused_in_a_line(what: str) -> None:
    with pytest.raises(FormatError) as caught:
        replace(random_shapes(10, share=0.7), **BAD[what])
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "changes",
    [{"moves": [[np.nan] * 3]}, {"moves": [[200.0, 0, 0]]}, {"splats": [5]}, {"targets": [1]}, {"targets": [-1]}],
)
def test_metres_that_cannot_be_are_refused(changes: dict[str, Any]) -> None:
    values: dict[str, Any] = {"splats": [0], "targets": [0], "moves": [[0.1, 0, 0]]}
    with pytest.raises(FormatError):
        Shapes.create(["a"], 5, **(values | changes))


def test_shapes_fit_their_avatar() -> None:
    avatar = expressive(100)
    with pytest.raises(FormatError, match="shapes of 75 splats"):
        replace(avatar, shapes=random_shapes(75))
    few = replace(expressive(40), skeleton=avatar.skeleton)
    assert few.shapes is not None
    assert len(replace(avatar, levels=(Level(few, 100.0),)).levels) == 1
    assert len(replace(avatar, levels=(Level(replace(few, shapes=None), 100.0),)).levels) == 1
    other = replace(few, shapes=replace(few.shapes, names=NAMES[::-1]))
    with pytest.raises(FormatError, match="level 1"):
        replace(avatar, levels=(Level(other, 100.0),))
    assert "4 shapes" in repr(avatar)


def test_parts_of_an_avatar_keep_their_shapes() -> None:
    avatar = expressive(200)
    joint = avatar.skeleton.names[2]
    one, other = avatar.only(joint), avatar.without(joint)
    assert one.shapes.splats == len(one.splats)
    assert len(one.shapes.targets) + len(other.shapes.targets) == len(avatar.shapes.targets)


def test_a_sheet_that_is_stretched_stays_a_sheet() -> None:
    """Splats on a plane under a linear map of the plane: covariances follow it, to what 8 bits leave."""
    rng = np.random.default_rng(2)
    base: Avatar = expressive(50)
    splats = replace(base.splats, scales=np.tile(np.float32((0.02, 0.01, 0.001)), (50, 1)))
    still = reference.rest(splats)
    axes = reference.quaternion_matrices(splats.quats)
    linear = np.eye(3) + rng.normal(0, 0.3, (50, 3, 3))
    bends = np.stack([np.einsum("nij,nj->ni", linear - np.eye(3), axes[:, :, k]) for k in (0, 1)], axis=1)
    shapes = Shapes.create(["a"], 50, splats=np.arange(50), targets=np.zeros(50), moves=np.zeros((50, 3)), bends=bends)
    found = reference.expressed(splats, shapes, np.ones(1))
    wanted = linear @ still.shapes
    assert found.shapes[:, :, :2] == pytest.approx(wanted[:, :, :2], abs=0.51 * BEND * 0.02)
    third = found.shapes[:, :, 2]
    assert np.linalg.norm(third, axis=1) == pytest.approx(0.001)  # as thick as before
    for k in (0, 1):
        assert np.einsum("ni,ni->n", third, found.shapes[:, :, k]) == pytest.approx(0, abs=1e-12)


def test_the_thin_axis_is_the_first_of_the_least() -> None:
    axes = long_axes(np.float32([[1, 2, 3], [2, 1, 1], [3, -1, 2], [1, 1, 1]]))
    assert axes.tolist() == [[1, 2, 0], [2, 0, 1], [2, 0, 1], [1, 2, 0]]


def test_no_splat_moves_farther_than_is_said() -> None:
    avatar = expressive(300)
    weights = np.array([0.5, 1.0, 0.2, 0.0])
    moved = reference.expressed(avatar.splats, avatar.shapes, weights).means - avatar.splats.means
    assert 0 < np.linalg.norm(moved, axis=1).max() <= avatar.shapes.farthest(weights)


def test_an_avatar_may_say_other_limits() -> None:
    shapes = replace(random_shapes(10), limits=np.array([[-1, 2]] * 4))
    assert shapes.weights({"jawOpen": -3, "browInnerUp": 1.5}) == pytest.approx([-1, 0, 0, 1.5])
