"""The box of a posed avatar from what each joint carries, against its splats, posed one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.errors import PoseError
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.net.backends.extent import Extent
from glsplat.rotations import rotation_matrices
from glsplat.skinning.pose import Pose
from tests.scenes import limb
from tests.skinning.avatars import part


def poses(avatar: Avatar) -> Iterator[Pose]:
    """Random ones, from nearly standing to contorted, and what people do."""
    rng, joints = np.random.default_rng(5), len(avatar.skeleton)
    for index in range(24):
        turns = rng.normal(0, (0.1, 0.2, 0.4, 0.6)[index % 4], (joints, 3))
        yield Pose(turns, rng.normal(0, 1, 3))
    for name in embedded_motions() if joints == 55 else ():
        motion = load_motion(name, avatar.skeleton)
        for t in rng.uniform(0, motion.duration, 4):
            yield motion.at(t)


def check(avatar: Avatar, largest: float, typical: float, short: float) -> None:
    """``short``: metres by which two standard deviations of blended splats may stick out."""
    extent, sizes = Extent.of(avatar.splats, avatar.skin), []
    for pose in poses(avatar):
        bones = pose.bones(avatar.skeleton)
        box, posed = extent.box(bones), reference.skin(avatar.splats, avatar.skin, bones)
        inside = ((posed.means >= box[0]) & (posed.means <= box[1])).all(axis=1)
        assert inside.mean() >= 0.995
        reach = 2 * np.linalg.norm(posed.shapes, axis=2)
        low, high = (posed.means - reach).min(axis=0), (posed.means + reach).max(axis=0)
        assert (box[0] <= low + short).all() and (box[1] >= high - short).all()
        sizes.append((box[1] - box[0]) / (high - low))
    assert np.max(sizes) <= largest and (np.mean(sizes, axis=0) <= typical).all(), (np.max(sizes), np.mean(sizes, 0))


def test_the_embedded_avatar() -> None:
    check(part(default_avatar(), np.arange(0, 40000, 8)), largest=1.15, typical=1.03, short=0.01)


def test_a_rod_of_other_joints() -> None:
    check(limb(300), largest=1.25, typical=1.1, short=0.05)  # soft weights: every splat is between two joints


def test_one_joint_is_bounded_exactly_along_axes_and_diagonals() -> None:
    """An ellipsoid that is turned by its joint: its true reach, and never less than that between the directions."""
    avatar = limb(1, joints=1)
    splats = replace(avatar.splats, means=[[0.3, 0.2, -0.1]], scales=[[0.3, 0.1, 0.02]], quats=[[1, 0, 0, 0]])
    extent = Extent.of(splats, avatar.skin)
    for turn in ([0, 0, 0], [0, 0, np.pi / 4], [np.pi / 2, 0, 0], [0, np.pi / 4, 0], [0.3, -1.0, 2.0]):
        rotation = rotation_matrices([turn])[0]
        bones = np.concatenate([rotation, [[1.0], [2.0], [3.0]]], axis=1)[None]
        box = extent.box(bones)
        mean = rotation @ [0.3, 0.2, -0.1] + (1, 2, 3)
        true = np.stack([mean - (r := 2 * np.linalg.norm(rotation * (0.3, 0.1, 0.02), axis=1)), mean + r])
        exact = np.allclose(np.abs(np.sin(2 * np.array(turn))), np.abs(np.sin(2 * np.array(turn))).round(), atol=1e-6)
        assert (box[0] <= true[0] + 1e-7).all() and (box[1] >= true[1] - 1e-7).all()
        assert np.abs(box - true).max() < (1e-6 if exact else 0.12)


def test_what_is_never_drawn_does_not_count() -> None:
    avatar = limb(50)
    plain = Extent.of(avatar.splats, avatar.skin).box(Pose.zero(4).bones(avatar.skeleton))
    skin = avatar.skin.take(np.r_[np.arange(50), 0, 1])
    far = avatar.splats.take(np.r_[np.arange(50), 0, 1])
    means, opacities = far.means.copy(), far.opacities.copy()
    means[50], means[51], opacities[51] = np.nan, 99.0, 0.0
    found = Extent.of(replace(far, means=means, opacities=opacities), skin).box(Pose.zero(4).bones(avatar.skeleton))
    np.testing.assert_array_equal(found, plain)
    nothing = Extent.of(far.take([]), skin.take(np.arange(0)))
    assert nothing.box(Pose.zero(4).bones(avatar.skeleton)) is None


def test_an_avatar_without_its_head() -> None:
    """What mostly follows the head, the jaw or an eye goes, the rest stays as it was, in its order."""
    avatar = default_avatar()
    bare = avatar.without("head")
    names = np.array(avatar.skeleton.names)
    below = avatar.skeleton.under("head")
    assert set(names[below]) == {"head", "jaw", "left_eye_smplhf", "right_eye_smplhf"}
    weight = avatar.skin.dense(55)[:, below].sum(axis=1)
    keep = np.flatnonzero(weight <= 0.5)
    assert 0.5 * len(avatar.splats) < len(keep) < 0.95 * len(avatar.splats)
    assert bare.skeleton is avatar.skeleton
    for name in ("means", "quats", "scales", "opacities", "sh", "cones"):
        np.testing.assert_array_equal(getattr(bare.splats, name), getattr(avatar.splats, name)[keep])
    for name in ("joints", "weights"):
        np.testing.assert_array_equal(getattr(bare.skin, name), getattr(avatar.skin, name)[keep])
    top = Extent.of(bare.splats, bare.skin).box(Pose.zero().bones(bare.skeleton))[1, 1]
    assert avatar.splats.means[:, 1].max() > top + 0.1
    assert len(limb(40, joints=3).without("joint0").splats) == 0  # the root: all hangs from it
    with pytest.raises(PoseError, match='no joint "tail"; it has pelvis, left_hip'):
        avatar.without("tail")
