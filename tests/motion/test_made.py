"""The embedded motions are what their maker makes."""

from __future__ import annotations

from importlib import resources

from glsplat.motion.loading import embedded_motions
from glsplat.skinning.skeleton import Skeleton
from tools.data.motions import library, to_json


def test_they_are_made_of_these_curves(skeleton: Skeleton) -> None:
    made = library(skeleton)
    assert sorted(made) == list(embedded_motions())
    for name, motion in made.items():
        text = resources.files("glsplat.data").joinpath(f"{name}.json").read_text()
        assert text == to_json(motion, skeleton)
