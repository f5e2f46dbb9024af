"""The embedded avatar's levels: from half a metre to twenty nobody sees one change, and nothing flickers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import LEAN
from glsplat.data import default_avatar
from glsplat.extras.evaluate.metrics import psnr
from glsplat.formats.motion_files import load_motion
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose

pytestmark = pytest.mark.gl
Make = Callable[..., Renderer]

SIZE = 512
LEAST = 38.0  # dB


def seen_from(distance: float, turn: float, height: float = 1.0, size: int = SIZE) -> Camera:
    """From ``turn`` degrees to the avatar's left, looking at its head from near and at its middle from afar."""
    target = np.array([0, height + 0.55 * np.clip(1.6 - distance, 0, 1), 0])
    eye = target + distance * np.array([np.sin(np.radians(turn)), 0, np.cos(np.radians(turn))])
    return Camera(look_at(eye, target), pinhole(size, size, 65.0), size, size)


def standing() -> Pose:
    """In the middle of a step, arms beside the body."""
    return load_motion("walk", default_avatar().skeleton).at(0.35)


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """dB over the whole pictures, the worst of them."""
    return min(psnr(a[..., :3] / 255.0, b[..., :3] / 255.0) for a, b in zip(one, other, strict=True))


@pytest.mark.check
@pytest.mark.parametrize("turn", [20.0, 200.0])
def test_a_sweep_of_distance_shows_no_switch(renderer_of: Make, turn: float) -> None:
    avatar, pose = default_avatar(), standing()
    knobs = {"level": LEAN.level, "cull_hidden": LEAN.cull_hidden, "max_sigma": LEAN.max_sigma}
    lean = renderer_of(avatar, size=(SIZE, SIZE), output="uint8", **knobs)
    exact = renderer_of(avatar, size=(SIZE, SIZE), output="uint8")
    seen = []
    for distance in np.geomspace(0.5, 20, 12):
        view = [seen_from(float(distance), turn)]
        kept = difference(lean.render(view, pose), exact.render(view, pose))
        assert kept >= LEAST, distance
        seen.append(lean.stats.levels[0])
    assert seen == sorted(seen) and seen[0] == 0 and seen[-1] == len(avatar.levels)
