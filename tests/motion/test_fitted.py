"""Embedded motions, and motions on bodies that they were not made for."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.errors import PoseError
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from tools.data.motions import library, to_json

FEET = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
LEGS = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("knee", "ankle", "foot")]


def of(points: np.ndarray) -> Skeleton:
    return Skeleton.from_joints(JOINT_NAMES, PARENTS, points)


def heights(path: str, skeleton: Skeleton) -> np.ndarray:
    """Of each frame's lowest foot joint above where it rests."""
    motion = load_motion(path, skeleton)
    return np.array(
        [
            (skeleton.forward(turns, trans)[FEET, 1, 3] - skeleton.joints[FEET, 1]).min()
            for turns, trans in zip(motion.rotations, motion.trans, strict=True)
        ]
    )


@pytest.mark.parametrize("factor", [0.3, 2.0])
def test_a_smaller_body_makes_smaller_ways(factor: float) -> None:
    body = default_avatar().skeleton
    other = of(body.joints * factor)
    for name in ("walk", "wave-and-turn", "idle"):
        one, scaled = load_motion(name, body), load_motion(name, other)
        assert np.array_equal(one.rotations, scaled.rotations)
        np.testing.assert_allclose(scaled.trans, one.trans * factor, atol=3e-4)  # the file rounds the body to 0.1 mm


def test_other_proportions_stand_where_the_first_body_stands() -> None:
    body = default_avatar().skeleton
    points = body.joints.copy()
    points[LEGS, 1] *= 0.6  # short shins
    scale = _legs(points) / _legs(body.joints)
    np.testing.assert_allclose(heights("walk", of(points)), scale * heights("walk", body), atol=3e-4)


def _legs(points: np.ndarray) -> float:
    chain = [JOINT_NAMES.index(f"left_{part}") for part in ("hip", "knee", "ankle")]
    return float(np.linalg.norm(np.diff(points[chain], axis=0), axis=1).sum())


def test_the_body_it_was_made_for_moves_as_it_is_written() -> None:
    frames = json.loads((Path(__file__).parents[2] / "glsplat" / "data" / "walk.json").read_text())["frames"]
    walk = load_motion("walk", default_avatar().skeleton)
    assert np.array_equal(walk.trans, [frame["trans"] for frame in frames])


def test_a_motion_that_does_not_say_whose_it_is_stays_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "hop.json"
    file.write_text(json.dumps([{"root_pose": [0, 0, 0], "trans": move} for move in ([0, 0, 0], [1.0, 0.5, 0])]))
    small = of(default_avatar().skeleton.joints * 0.5)
    assert load_motion(file, small).trans[1].tolist() == [1.0, 0.5, 0]


@pytest.mark.parametrize(
    "joints", [[], [[0, 0, 0]] * 54, "no", [["a", 0, 0]] * 55, [[1e999, 0, 0]] * 55, {"a": 1}, None]
)
def test_a_body_that_is_none_is_refused_in_one_line(tmp_path: Path, joints: object) -> None:
    file = tmp_path / "bad.json"
    file.write_text(json.dumps({"joints": joints, "frames": [{}]}))
    with pytest.raises(PoseError) as error:
        load_motion(file, default_avatar().skeleton)
    assert "\n" not in str(error.value) and "bad.json" in str(error.value)


def test_they_are_made_of_these_curves(skeleton: Skeleton) -> None:
    made = library(skeleton)
    assert sorted(made) == list(embedded_motions())
    for name, motion in made.items():
        text = resources.files("glsplat.data").joinpath(f"{name}.json").read_text()
        assert text == to_json(motion, skeleton)
