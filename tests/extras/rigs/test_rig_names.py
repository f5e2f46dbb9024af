"""What a rig's joints are called and where they are: the words of names, and two joints in one place."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.extras.rigs.humanoid import upright
from glsplat.extras.rigs.match import RigMap, match_rig
from glsplat.extras.rigs.words import word_of, words_of
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS


def test_bones_of_a_finger_hang_from_each_other() -> None:
    parents = {name: JOINT_NAMES[parent] for name, parent in zip(JOINT_NAMES, PARENTS, strict=True) if parent >= 0}
    for side in ("left", "right"):
        for finger in ("index", "middle", "pinky", "ring", "thumb"):
            chain = [f"{side}_{finger}{i}" for i in (3, 2, 1)]
            assert [parents[name] for name in chain] == [*chain[1:], f"{side}_wrist"]


def test_a_name_that_is_only_the_common_word_keeps_it() -> None:
    words = words_of(["Bob_LeftArm", "Bob_RightArm", "Bob_Head", "Bob"])
    assert [word.stem for word in words] == ["arm", "arm", "head", "bob"]


@pytest.mark.parametrize(("name", "finger", "bone"), [("Bip01 L Finger11", "index", 2), ("Finger4", "pinky", 1)])
def test_fingers_by_number(name: str, finger: str, bone: int) -> None:
    word = word_of(name)
    assert (word.stem, word.number) == (finger, bone)


@pytest.mark.parametrize("at", [0.0, 1.0])
def test_a_joint_on_its_own_parent_is_passed_over(at: float) -> None:
    """CMU's LHipJoint holds the thigh and lies on the hips, wherever these are."""
    names = ["Hips", "LHipJoint", "LeftHip", "LeftKnee"]
    positions = np.array([[0, at, 0], [0, at, 0], [0.1, at - 0.1, 0], [0.1, at - 0.5, 0]])
    assert match_rig(names, [-1, 0, 1, 2], positions).joints["left_hip"] == 2


@pytest.mark.parametrize(("count", "shown"), [(4, "(a, b, c, d)"), (5, "(a, b, c, d, ...)")])
def test_names_that_are_left_out_are_dots(count: int, shown: str) -> None:
    parents = [-1, *range(count - 1)]
    joints = np.arange(3 * count).reshape(count, 3) / 10
    assert why_not_driven(Skeleton.from_joints(list("abcde")[:count], parents, joints)).endswith(shown)


def test_a_trunk_that_is_not_above_the_legs_is_refused() -> None:
    parts = [f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "shoulder")]
    rig = RigMap({name: index for index, name in enumerate(parts)}, ())

    def positions(*shoulder: float) -> np.ndarray:
        left = np.array([[0.1, 0.9, 0], [0.1, 0.5, 0], shoulder])
        return np.vstack([left, left * (-1, 1, 1)])

    assert np.allclose(upright(rig, positions(0.2, 1.4, 0)), np.eye(3))
    for shoulder in ((0.2, 1.1, 0.6), (0.2, 0.3, 0.0)):  # on four legs; folded over
        with pytest.raises(PoseError, match="trunk is not above the legs"):
            upright(rig, positions(*shoulder))
