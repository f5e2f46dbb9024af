"""Rigs by the names of their joints, and by where the joints are."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.rigs.match import NEEDED, match_rig
from glsplat.extras.rigs.shape import match_shape
from glsplat.extras.rigs.words import word_of, words_of
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.rigs.gltf.built import FAMILIES
from tests.extras.rigs.gltf.more_families import NAMED, Named, laid_out


@pytest.mark.parametrize("name", list(NAMED))
def test_the_map_is_the_one_that_is_meant(name: str) -> None:
    rig = NAMED[name]
    names, parents, points = laid_out(rig)
    found = match_rig(names, parents, points)
    told = {joint: names[index] for joint, index in found.joints.items()}
    assert told == rig.names and not found.missing


def test_of_two_that_are_called_alike_the_one_that_moves_something_counts() -> None:
    """Controls stand beside the bones of the skin under the same names, as targets of a rig do."""
    rig = NAMED["VRChat"]
    names, parents, points = laid_out(rig)
    count = len(names)
    whole = [*names, *names]  # a second skeleton, which moves nothing, comes first
    above = np.concatenate([parents, np.where(parents < 0, -1, parents + count)])
    found = match_rig(whole, above, np.concatenate([points, points]), None, [False] * count + [True] * count)
    assert not found.missing and min(found.joints.values()) >= count


def test_two_people_are_not_mixed() -> None:
    rig = NAMED["VRChat"]
    names, parents, points = laid_out(rig)
    count = len(names)
    above = np.concatenate([parents, np.where(parents < 0, -1, parents + count)])
    found = match_rig([*names, *names], above, np.concatenate([points, points + (2.0, 0, 0)]))
    parts = ("hip", "knee", "ankle", "shoulder", "elbow")
    limbs = [joint for joint in found.joints if joint.partition("_")[2] in parts]
    assert len({found.joints[joint] < count for joint in limbs}) == 1


def test_any_text_is_a_name() -> None:
    rng = np.random.default_rng(5)
    letters = "lLrR_ .-:|0189abXfinger左手足指１ｱ🙂é\0"
    stems = ["", "finger", "Bip01 Finger", "thumb", "FBXASC999", "Left", "x0", "metacarpal", "D"]
    for _ in range(3000):
        name = str(rng.choice(stems)) + "".join(rng.choice(list(letters), rng.integers(0, 9)))
        word_of(name)
    assert words_of([]) == [] and words_of(["", ":"])[1].parts == ()


RIGS = {**NAMED, **{name: Named(family.names, family.more) for name, family in FAMILIES.items()}}


@pytest.mark.parametrize("name", list(RIGS))
@pytest.mark.parametrize("facing", [1.0, -1.0])
def test_a_person_is_told(name: str, facing: float) -> None:
    rig = RIGS[name]
    names, parents, points = laid_out(rig)
    points = points * (facing, 1, facing)
    found = match_shape(parents, points, np.ones(len(names), bool))
    if {"left_ankle", "left_wrist"} <= set(rig.names):
        assert found
    if not found:
        return
    told = match_rig([""] * len(names), parents, points, found)
    assert set(NEEDED) <= set(told.joints)
    parts = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    limbs = [f"{side}_{part}" for side in ("left", "right") for part in parts]
    for joint in (*limbs, "head"):
        if joint in rig.names:
            side, _, part = joint.partition("_")  # taken to face +z, as files do
            mine = joint if facing > 0 or not part else f"{'right' if side == 'left' else 'left'}_{part}"
            off = points[told.joints[mine]] - points[names.index(rig.names[joint])]
            assert np.linalg.norm(off) < 0.12, (joint, names[told.joints[mine]])


def quadruped() -> tuple[np.ndarray, np.ndarray]:
    points, parents = [(0.0, 0.6, -0.4), (0, 0.6, 0), (0, 0.65, 0.4), (0, 0.8, 0.6), (0, 0.85, 0.8)], [-1, 0, 1, 2, 3]
    for above, z in ((0, -0.4), (2, 0.4)):
        for x in (0.1, -0.1):
            for n, y in enumerate((0.55, 0.3, 0.05)):
                points.append((x, y, z))
                parents.append(above if n == 0 else len(points) - 2)
    return np.array(points), np.array(parents)


def test_limbs_that_point_down_are_the_legs_though_the_arms_are_longer() -> None:
    middle = [(0.0, y, 0.0) for y in (0.4, 0.55, 0.7, 0.75, 0.85, 1.0)]  # pelvis, spine, chest, neck, head, its tip
    legs = [(side * 0.1, y, 0.0) for side in (1, -1) for y in (0.4, 0.22, 0.05)]
    arms = [(side * x, 0.7, 0.0) for side in (1, -1) for x in (0.1, 0.33, 0.55)]
    parents = [-1, 0, 1, 2, 3, 4, 0, 6, 7, 0, 9, 10, 2, 12, 13, 2, 15, 16]
    limbs = (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))
    names = [f"{side}_{part}" for parts in limbs for side in ("left", "right") for part in parts]
    found = match_shape(parents, np.array([*middle, *legs, *arms]), np.ones(18, bool))
    assert found["pelvis"] == 0 and [found[name] for name in names] == list(range(6, 18))


def test_nobody_else_is() -> None:
    points, parents = quadruped()
    assert match_shape(parents, points, np.ones(len(points), bool)) == {}
    rng = np.random.default_rng(4)
    for count in (0, 1, 7, 20, 60):
        parents = np.array([rng.integers(-1, max(i, 1)) if i else -1 for i in range(count)], int)
        match_shape(parents, rng.normal(0, 1, (count, 3)), np.ones(count, bool))
    line = np.stack([np.zeros(30), np.linspace(0, 2, 30), np.zeros(30)], axis=1)
    assert match_shape(np.arange(30) - 1, line, np.ones(30, bool)) == {}
    assert len(JOINT_NAMES) == 55


def standing(head: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A person 1 m tall without names, whose head leans that far aside."""
    middle = [(0.0, 0.4, 0.0), (0, 0.55, 0), (0, 0.7, 0), (head, 0.75, 0), (head, 0.85, 0), (head, 1.0, 0)]
    legs = [(side * 0.1, y, 0.0) for side in (1, -1) for y in (0.4, 0.2, 0.0)]
    arms = [(side * x, 0.7, 0.0) for side in (1, -1) for x in (0.1, 0.33, 0.55)]
    parents = [-1, 0, 1, 2, 3, 4, 0, 6, 7, 0, 9, 10, 2, 12, 13, 2, 15, 16]
    return np.array([*middle, *legs, *arms]), np.array(parents)


def test_a_person_is_told_wherever_the_origin_is() -> None:
    points, parents = standing()
    found = match_shape(parents, points, np.ones(18, bool))
    assert found["head"] in (4, 5)
    for moved in ((0.0, -5.0, 0.0), (3.0, 7.0, -2.0)):
        assert match_shape(parents, points + moved, np.ones(18, bool)) == found


@pytest.mark.parametrize(("lean", "is_one"), [(0.1, True), (0.11, False)])
def test_a_head_leans_a_tenth_of_the_height_at_most(lean: float, is_one: bool) -> None:
    points, parents = standing(lean)
    assert bool(match_shape(parents, points, np.ones(18, bool))) == is_one
