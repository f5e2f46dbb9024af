"""The embedded person, all of it, in both eyes: the pair against the float64 reference and against its singles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glsplat import reference
from glsplat.camera import sorting_camera, stereo_cameras
from glsplat.data import default_avatar
from glsplat.formats.motion_files import load_motion
from glsplat.renderer import Renderer
from tests.compare import assert_contract

pytestmark = pytest.mark.gl


@pytest.mark.parametrize(
    ("motion", "frame"),
    [("walk", 11), *(pytest.param(*row, marks=pytest.mark.check) for row in (("wave-and-turn", 97), ("idle", 30)))],
)
def test_the_person_in_motion(renderer_of: Callable[..., Renderer], motion: str, frame: int) -> None:
    avatar = default_avatar()
    pose = load_motion(motion, avatar.skeleton).pose(frame)
    head = np.eye(4)
    head[:3, 3] = -0.2, 1.1, 1.9
    eyes = stereo_cameras(head, 0.063, size=(128, 128))
    pair = renderer_of(avatar, (128, 128), 2).render(eyes, pose)
    expected = reference.render(avatar.splats, eyes, avatar.skin, pose.bones(avatar.skeleton))
    assert (expected[..., 3] > 0.5).mean() > 0.1
    assert_contract(pair, expected)
    single = renderer_of(avatar, (128, 128))
    for eye, view in enumerate(eyes):
        assert np.array_equal(single.in_order(sorting_camera(eyes), [view], pose)[0], pair[eye])
