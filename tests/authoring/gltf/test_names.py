"""Whatever joints are called: the map is the one that is meant, helpers are none."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.skinning.rigs.match import match_rig
from glsplat.skinning.rigs.words import word_of, words_of
from tests.authoring.gltf.more_families import NAMED, laid_out


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
