"""The skin pass on the GPU against the float64 reference: positions, covariances, rotations, pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.compare import assert_contract
from tests.scenes import cloud, limb
from tests.skinning.avatars import VIEW, SkinError, any_rotations, blended_part, chain, part

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]


def random_pose(rng: np.random.Generator, joints: int, index: int) -> Pose:
    """Ordinary, wild and any rotations of all joints at once, in turn."""
    rotations = any_rotations(rng, joints) if index % 3 == 2 else rng.normal(0, (0.3, 1.0)[index % 3], (joints, 3))
    return Pose(rotations, rng.normal(0, 0.3, 3))


def test_random_poses(renderer_of: Make, rng: np.random.Generator) -> None:
    avatar = blended_part(default_avatar(), 200)
    renderer = renderer_of(avatar, (1, 1))
    for index in range(300):
        error = SkinError.of(renderer, avatar, random_pose(rng, 55, index))
        assert error.within(), (index, error)


@pytest.mark.parametrize("name", embedded_motions())
def test_the_embedded_motions(renderer_of: Make, name: str) -> None:
    avatar = default_avatar()
    renderer, motion = renderer_of(avatar, (1, 1)), load_motion(Path(name), avatar.skeleton)
    for frame in np.linspace(0, len(motion) - 1, 4)[1:3].astype(int):
        error = SkinError.of(renderer, avatar, motion.pose(int(frame)))
        assert error.within(position=2e-6, covariance=1e-5), error


@pytest.mark.parametrize("influences", [1, 2, 4, 8])
@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("rotation", ["polar", "raw"])
def test_every_layout(renderer_of: Make, rng: np.random.Generator, influences: int, degree: int, rotation: str) -> None:
    """Each number of influences, with and without R_i in the record (SH), both rotation modes."""
    avatar = limb(800, 5, influences, degree)
    renderer = renderer_of(avatar, (1, 1), rotation=rotation)
    for index in range(6):
        error = SkinError.of(renderer, avatar, random_pose(rng, 5, index), rotation)
        assert error.position < 1e-5 and error.covariance < 1e-4, error
        assert rotation == "raw" or error.within(), error


def test_fewer_influences_by_config(renderer_of: Make, rng: np.random.Generator) -> None:
    avatar = chain(500, 20, 8)
    for influences in (1, 2, 4):
        reduced = Avatar(avatar.splats, avatar.skeleton, avatar.skin.reduced(influences))
        renderer = renderer_of(avatar, (1, 1), influences=influences)
        assert SkinError.of(renderer, reduced, random_pose(rng, 20, 0)).within()


def test_pictures_of_a_posed_avatar(renderer_of: Make) -> None:
    """A pair of the default avatar in mid-motion, and a wild pose, within the gate of the contract."""
    whole = default_avatar()
    few, some = (part(whole, np.arange(0, len(whole.splats), n)) for n in (8, 3))  # 40 us a splat, view, and reference
    motion = load_motion(Path("wave-and-turn"), whole.skeleton)
    head = np.eye(4)
    head[:3, 3] = 0.1, 1.0, 2.0
    eyes = stereo_cameras(head, 0.063, size=(128, 128))
    wild = Pose(np.random.default_rng(8).normal(0, 0.6, (55, 3)), np.array([0.0, 0.1, 0.0]))
    view = Camera(look_at((1.2, 1.6, 2.2), (0, 0.9, 0)), pinhole(192, 192), 192, 192, background=(0.2, 0.4, 0.6))
    for avatar, cameras, pose, size in ((few, eyes, motion.pose(len(motion) // 2), 128), (some, [view], wild, 192)):
        image = renderer_of(avatar, (size, size), len(cameras)).render(cameras, pose)
        expected = reference.render(avatar.splats, cameras, avatar.skin, pose.bones(avatar.skeleton))
        assert 0.02 < (expected[..., 3] > 0.5).mean() < 0.9
        assert_contract(image, expected)


def test_posed_refuses_what_was_not_skinned(renderer_of: Make) -> None:
    static, fresh = renderer_of(cloud(10), (1, 1)), renderer_of(limb(10), (1, 1))
    static.render([VIEW])
    for renderer in (static, fresh):
        with pytest.raises(GlsplatError, match="not skinned or not rendered"):
            renderer.posed()
