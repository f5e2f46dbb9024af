"""Stiff and extreme poses and rigs: each has a stated behaviour (docs/skinning.md) and is held to it here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import ArrayLike

from glsplat import reference
from glsplat.arrays import restored
from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.errors import FormatError, PoseError
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from tests.scenes import camera
from tests.skinning.avatars import VIEW, SkinError, any_rotations, blended_part, chain, part, rotations, turn

Make = Callable[..., Renderer]

STEP = 0.5  # degrees of a sweep
FASTEST = 34 * STEP + 0.3  # degrees a splat may turn in one step: 32 times the joint, and a change of column


def turned(joints: int, joint: int, axis: ArrayLike, degrees: float) -> Pose:
    pose = np.zeros((joints, 3))
    pose[joint] = np.asarray(axis) / np.linalg.norm(axis) * np.radians(degrees)
    return Pose(pose, np.zeros(3))


@pytest.mark.gl
def test_half_turns_of_every_joint(renderer_of: Make) -> None:
    """180 degrees at each of the 55 joints, about each axis: as the reference has it, and R_i stays a rotation."""
    avatar = blended_part(default_avatar(), 300)
    renderer = renderer_of(avatar, (1, 1))
    for joint in range(55):
        for axis in np.eye(3):
            error = SkinError.of(renderer, avatar, turned(55, joint, axis, 180))
            assert error.within(), (joint, axis, error)


@pytest.mark.gl
def test_full_turns_are_no_turns(renderer_of: Make) -> None:
    avatar = part(default_avatar(), np.arange(0, 40000, 16))
    renderer = renderer_of(avatar, (1, 1))
    renderer.render([VIEW], Pose.zero())
    rest = renderer.posed()
    for sign in (-1, 1):
        for axis in np.eye(3):
            pose = Pose(np.tile(sign * 2 * np.pi * axis, (55, 1)), np.zeros(3))
            assert SkinError.of(renderer, avatar, pose).within()
            means, shapes = renderer.posed()
            assert np.abs(means - rest[0]).max() < 1e-6
            assert np.abs(shapes - rest[1]).max() < 1e-6 * np.abs(rest[1]).max()


@pytest.mark.gl
def test_candy_wrapper(renderer_of: Make) -> None:
    """Two equal weights turned against each other about the limb: the ring falls on its axis, as LBS has it; the
    rotation is the anchor's or between the two, never a reflection, and no splat is lost."""
    skeleton = Skeleton.from_joints(("a", "b"), [-1, 0], [[0.0, 0, 0], [0.5, 0, 0]])
    angle = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    ring = np.stack([np.full(256, 0.5), 0.05 * np.cos(angle), 0.05 * np.sin(angle)], -1)
    base = chain(256, 2).splats
    skin = Skin.create(np.tile([0, 1], (256, 1)), np.full((256, 2), 0.5), 2, 2)
    avatar = Avatar(replace(base, means=ring.astype(np.float32)), skeleton, skin)
    renderer = renderer_of(avatar, (64, 64))
    error = SkinError.of(renderer_of(avatar, (1, 1)), avatar, turned(2, 1, (1, 0, 0), 180))
    assert error.within(covariance=1e-2)  # an exact tie: rounding chooses the column, 0.2 degrees apart
    image = renderer.render([camera()], turned(2, 1, (1, 0, 0), 180))
    means, _ = renderer.posed()
    assert np.abs(means - (0.5, 0, 0)).max() < 1e-6 and renderer.stats.drawn == 256
    assert np.isfinite(image).all()


@pytest.mark.gl
def test_no_splat_jumps_while_one_joint_turns(renderer_of: Make) -> None:
    """Through the collapse at 180 degrees at every other body joint, on the splats that blend most."""
    avatar = blended_part(default_avatar(), 1000)
    renderer = renderer_of(avatar, (1, 1))
    fastest = 0.0
    for joint in range(0, 25, 2):
        before = None
        for degrees in np.arange(170, 190, STEP):
            renderer.render([VIEW], turned(55, joint, ((1, 0, 0), (0.3, 0.8, -0.5))[joint % 2], degrees))
            now = rotations(avatar.splats, renderer.posed()[1])
            if before is not None:
                fastest = max(fastest, float(turn(now, before).max()))
            before = now
    assert 5 * STEP < fastest <= FASTEST  # it does collapse, and nothing jumps


@pytest.mark.gl
def test_outvoted_strongest_joint_does_not_spin() -> None:
    """0.45 against 0.30 + 0.25 that turn together: the splat follows the majority through 180 degrees, smoothly."""
    names, joints = ("a", "b", "c"), [[0.0, 0, 0], [0.3, 0, 0], [0.6, 0, 0]]
    skeleton = Skeleton.from_joints(names, [-1, 0, 1], joints)
    splats = chain(1, 3).splats
    avatar = Avatar(splats, skeleton, Skin.create([[0, 1, 2]], [[0.45, 0.3, 0.25]], 3))
    sweep = np.arange(150, 210, 0.1)

    def largest(skin: Skin) -> float:
        posed = [reference.skin(splats, skin, turned(3, 1, (1, 0, 0), d).bones(skeleton)).rotations for d in sweep]
        return max(float(turn(b, a)[0]) for a, b in pairwise(posed))

    strongest = Skin.create([[0, 1, 2]], [[0.45, 0.3, 0.25]], 3)
    assert largest(strongest) > 50  # why the anchor is not the strongest joint
    assert largest(avatar.skin) < 12 * 0.1


@pytest.mark.gl
def test_pose_that_is_not_a_number_is_refused() -> None:
    for value in (np.nan, np.inf):
        with pytest.raises(PoseError, match="finite"):
            Pose(np.full((55, 3), value), np.zeros(3))
    with pytest.raises(PoseError, match="trans needs metres"):
        Pose(np.zeros((55, 3)), np.array([1e7, 0, 0]))
    with pytest.raises(PoseError, match="radians"):  # finite, but its square is not
        Pose(np.full((55, 3), 1e160), np.zeros(3))
    with pytest.raises(PoseError, match="translations"):
        Pose(np.zeros((55, 3)), np.zeros(3), np.full((55, 3), 1e300))


@pytest.mark.gl
@pytest.mark.parametrize("trans", [(1e5, 0, -3e4), (-7e5, 9e5, 1.0)])
def test_an_avatar_far_from_the_origin(renderer_of: Make, rng: np.random.Generator, trans: tuple[float, ...]) -> None:
    """Exact to 1e-5 m: the root leaves the bones in float64 on the host and comes back with the camera. Blending at
    the place itself would not be: float32 weights sum to one within 1e-7, which is a centimetre at 1e5 m."""
    avatar = blended_part(default_avatar(), 400)
    renderer = renderer_of(avatar, (1, 1))
    for _ in range(5):
        near = Pose(rng.normal(0, 0.5, (55, 3)), np.zeros(3))
        expected = reference.skin(avatar.splats, avatar.skin, near.bones(avatar.skeleton))
        renderer.render([VIEW], replace(near, trans=np.array(trans)))
        means, shapes = renderer.posed()
        assert np.abs(means - trans - expected.means).max() < 1e-5
        assert turn(rotations(avatar.splats, shapes), expected.rotations).max() < 1e-3


@pytest.mark.gl
def test_an_avatar_modelled_far_from_the_origin(renderer_of: Make, rng: np.random.Generator) -> None:
    """Its splats lie about a centre of their own on the GPU, and the bones take them from there: exact all the same."""
    away = np.array([30.0, -40.0, 100.0])
    near = chain(500, 12)
    splats = replace(near.splats, means=near.splats.means + away.astype(np.float32))
    names, parents, joints = near.skeleton.names, near.skeleton.parents, near.skeleton.joints + away
    avatar = Avatar(splats, Skeleton.from_joints(names, parents, joints), near.skin)
    renderer = renderer_of(avatar, (1, 1))
    for trans in (np.zeros(3), -away):
        pose = Pose(rng.normal(0, 0.5, (12, 3)), trans)
        assert SkinError.of(renderer, avatar, pose).within(position=1e-4)


@pytest.mark.gl
def test_stretched_bones(renderer_of: Make, rng: np.random.Generator) -> None:
    avatar = chain(500, 12)
    renderer = renderer_of(avatar, (1, 1))
    pose = Pose(rng.normal(0, 0.5, (12, 3)), np.zeros(3), rng.normal(0, 0.5, (12, 3)))
    assert SkinError.of(renderer, avatar, pose).within()


@pytest.mark.gl
@pytest.mark.parametrize(
    ("weights", "same_as", "repaired"),
    [
        ([0.3, 0.2], [0.6, 0.4], 0),
        ([1.2, 0.8], [0.6, 0.4], 0),
        ([0.0, 0.0], [1.0, 0.0], 1),
        ([0.6, -0.4], [1.0, 0.0], 1),
        ([0.6, np.nan], [1.0, 0.0], 1),
        ([np.inf, 0.4], [0.0, 1.0], 1),
        ([-1.0, np.nan], [1.0, 0.0], 1),
    ],
    ids=["sum 0.5", "sum 2", "sum 0", "negative", "nan", "infinite", "none left"],
)
def test_weights_are_made_to_sum_to_one(weights: list[float], same_as: list[float], repaired: int) -> None:
    skin = Skin.create([[0, 1]], [weights], 2, 2)
    assert np.allclose(skin.dense(2), [same_as]) and skin.repaired == repaired
    assert abs(float(skin.weights.sum()) - 1) < 1e-6


@pytest.mark.gl
def test_bad_weights_behind_the_checks_cost_only_their_splats(renderer_of: Make) -> None:
    """A Skin that came past its checks (here as a pickle would): NaN hides that splat, nothing else changes."""
    avatar, pose = chain(40, 4), turned(4, 1, (0, 0, 1), 40)
    good = renderer_of(avatar).render([camera()], pose)
    hidden = avatar.splats.opacities.copy()
    hidden[7] = 0
    expected = renderer_of(replace(avatar, splats=replace(avatar.splats, opacities=hidden))).render([camera()], pose)
    weights = avatar.skin.weights.copy()
    weights[7] = np.nan
    with pytest.raises(FormatError, match=r"found nan; Skin.create\(joints, weights, joint_count\) repairs"):
        Skin(avatar.skin.joints, weights)
    unchecked = restored(Skin, {"joints": avatar.skin.joints, "weights": weights, "lost": 0.0, "repaired": 0})
    parts = {"splats": avatar.splats, "skeleton": avatar.skeleton, "skin": unchecked, "meta": {}}
    parts |= {"levels": (), "shapes": None}
    broken = restored(Avatar, parts)
    renderer = renderer_of(broken)
    assert np.array_equal(renderer.render([camera()], pose), expected) and not np.array_equal(good, expected)
    assert renderer.stats.culled["out of range"] == 1


@pytest.mark.gl
def test_joints_out_of_range_are_refused() -> None:
    for joint in (-1, 4, 70000):
        with pytest.raises(FormatError, match="the skeleton has 4"):
            Skin.create([[0, joint]], [[0.5, 0.5]], 4, 2)
    Skin.create([[0, 9]], [[1.0, 0.0]], 4, 2)  # without weight it binds nothing
    two = chain(1, 2)
    with pytest.raises(FormatError, match="names joint 5 of 2"):
        Avatar(two.splats, two.skeleton, Skin(np.full((1, 4), 5, np.uint16), two.skin.weights))


@pytest.mark.gl
def test_cycles_are_refused() -> None:
    for parents, message in (([-1, 2, 1], "cycle through joint 1"), ([1, 2, 0], "needs a root"), ([-1, 0, 3], "-1..2")):
        with pytest.raises(PoseError, match=message):
            Skeleton.from_joints(("a", "b", "c"), parents, np.zeros((3, 3)))


@pytest.mark.gl
def test_a_rest_frame_without_inverse_is_refused() -> None:
    rest = np.tile(np.eye(4), (2, 1, 1))
    rest[1, :3, :3] = 0
    with pytest.raises(PoseError, match="no inverse"):
        Skeleton(("a", "b"), np.array([-1, 0]), rest)


@pytest.mark.gl
def test_two_roots(renderer_of: Make, rng: np.random.Generator) -> None:
    """Legal: trans moves both, each turns about itself, splats between them blend."""
    base = chain(300, 6)
    skeleton = Skeleton.from_joints(base.skeleton.names, [-1, 0, 1, -1, 3, 4], base.skeleton.joints)
    avatar = Avatar(base.splats, skeleton, base.skin)
    renderer = renderer_of(avatar, (1, 1))
    for _ in range(10):
        assert SkinError.of(renderer, avatar, Pose(any_rotations(rng, 6), rng.normal(size=3))).within()


@pytest.mark.gl
@pytest.mark.parametrize(
    "linear",
    [np.diag([2.0, 0.5, 1.0]), np.diag([-1.0, 1, 1]), -np.eye(3), np.diag([1e-3, 1, 1]), np.diag([0.0, 0, 0])],
    ids=["scale", "reflection", "point reflection", "flat", "zero"],
)
def test_a_bone_that_scales_or_reflects(renderer_of: Make, rng: np.random.Generator, linear: np.ndarray) -> None:
    """Means follow the matrix as it is; R_i stays a proper rotation (scale and reflection do not reach the shape).
    In raw mode the shape takes the whole matrix."""
    base = chain(400, 5)
    inverse_bind = np.linalg.inv(base.skeleton.rest)
    inverse_bind[2, :3] = linear @ inverse_bind[2, :3]
    skeleton = Skeleton(base.skeleton.names, base.skeleton.parents, base.skeleton.rest, inverse_bind)
    avatar = Avatar(base.splats, skeleton, base.skin)
    for index in range(10):
        pose = Pose(rng.normal(0, 0.8, (5, 3)) * (index > 0), np.zeros(3))
        error = SkinError.of(renderer_of(avatar, (1, 1)), avatar, pose)
        assert error.within(covariance=1e-3), error
        raw = renderer_of(avatar, (1, 1), rotation="raw")
        raw.render([VIEW], pose)
        expected = reference.skin(avatar.splats, avatar.skin, pose.bones(skeleton), "raw").shapes
        assert np.abs(raw.posed()[1] - expected).max() < 1e-6


@pytest.mark.gl
@pytest.mark.parametrize("joints", [1, 300])
def test_number_of_joints(renderer_of: Make, rng: np.random.Generator, joints: int) -> None:
    avatar = chain(600, joints, step=0.01)
    renderer = renderer_of(avatar, (1, 1))
    for index in range(5):
        pose = Pose(rng.normal(0, 0.2 if index else 0, (joints, 3)), rng.normal(size=3))
        assert SkinError.of(renderer, avatar, pose).within()
    with pytest.raises(PoseError, match="joints, the avatar"):
        renderer.render([VIEW], Pose.zero(joints + 1))


@pytest.mark.gl
def test_anchor_keeps_half_of_the_weight_on_its_side() -> None:
    """Whichever joint of the rig turns; idempotent; the same weights on the same joints."""
    avatar = default_avatar()
    skin, parents = avatar.skin, avatar.skeleton.parents
    below = np.eye(55, dtype=bool)
    for joint in range(55):
        above = parents[joint]
        while above >= 0:
            below[above, joint] = True
            above = parents[above]
    dense = skin.dense(55)
    with_anchor = np.zeros(len(skin))
    for cut in range(55):
        inside = dense @ below[cut]
        side = np.where(below[cut, skin.joints[:, 0]], 1 - inside, inside)
        with_anchor = np.maximum(with_anchor, side)
    assert with_anchor.max() < 0.5 + 1e-5
    moved = skin.weights[:, 0] < skin.weights.max(axis=1)
    assert 0.01 < moved.mean() < 0.1
    again = skin.anchored(parents)
    assert np.array_equal(again.joints, skin.joints) and np.array_equal(again.weights, skin.weights)
    plain = Skin.create(skin.joints, skin.weights, 55)
    assert np.allclose(plain.dense(55), dense, atol=1e-6)


@pytest.mark.parametrize("influences", [0, 3, 16])
def test_a_number_of_influences_without_a_shader(influences: int) -> None:
    with pytest.raises(FormatError, match=rf"influences needs one of \(1, 2, 4, 8\), not {influences}"):
        Skin.create(np.zeros((2, 4), int), np.ones((2, 4)), 1, influences)


@pytest.mark.parametrize("trans", [1.0, [1.0], [[1.0, 2.0, 3.0]]])
def test_a_translation_that_only_numpy_can_add(trans: object) -> None:
    skeleton = Skeleton.from_joints(["hip", "knee"], [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    with pytest.raises(PoseError, match=r"trans needs shape \(3,\)"):
        skeleton.forward(np.zeros((2, 3)), trans)  # type: ignore[arg-type]
