"""Extreme poses, weights and rigs: the cases of docs/skinning.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat import reference
from glsplat.arrays import F64, restored
from glsplat.avatar import Avatar
from glsplat.errors import FormatError, GlsplatError, PoseError
from glsplat.extras.evaluate.stability.frame import Case, Outcome, camera, refused, renderer
from glsplat.gl.context import Context
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

POSITION, COVARIANCE = 1e-5, 1e-4  # gates of docs/skinning.md: metres, relative
SWEEP = 0.5  # degrees per step
Row = tuple[str, str, str, Callable[[Context], Outcome]]
_TWIN = "as the float64 twin, rotations stay rotations"


def skin_cases() -> list[Case]:
    """Return cases of poses, weights and rigs at their limits."""
    rows = [*_pose_cases(), *_rig_cases(), *_refusals(), *_weight_cases(), *_expression_cases()]
    return [Case("skinning", *row) for row in rows]


def _pose_cases() -> list[Row]:
    limb, rng = chain(300, 12), np.random.default_rng(5)

    def random(count: int, spread: float) -> list[Pose]:
        return [Pose(rng.normal(0, spread, (12, 3)), np.zeros(3)) for _ in range(count)]

    half_turns = [_turned(12, j, axis, 180) for j in range(12) for axis in np.eye(3)]
    stretched = [Pose(rng.normal(0, 0.5, (12, 3)), np.zeros(3), rng.normal(0, 0.5, (12, 3))) for _ in range(5)]
    swept = "one joint from 170 to 190 degrees, weights 0.5 to 0.6"
    return [
        ("half turns", "180 degrees at each joint about each axis", _TWIN, _posed(limb, half_turns)),
        ("candy wrapper", "two equal weights turned apart by 180 degrees", "the ring falls on its axis", _wrapper),
        ("full turns", "every joint at +-2 pi", "the zero pose within 1e-6", _full_turns),
        ("random poses", "1 rad a component", _TWIN, _posed(limb, random(10, 1.0))),
        ("any rotations", "3 rad a component, all joints at once", _TWIN, _posed(limb, random(20, 3.0))),
        ("sweep", swept, "no splat turns more than 34 times the step + 0.3 degrees", _sweep),
        ("stretched bones", "0.5 m added at random", _TWIN, _posed(limb, stretched)),
        ("100 km away", "trans 1e5, 0, -3e4 m", "about its root within 1e-5 m", _far((1e5, 0, -3e4))),
        ("1000 km away", "trans -7e5, 9e5, 1 m", "about its root within 1e-5 m", _far((-7e5, 9e5, 1.0))),
    ]


def _rig_cases() -> list[Row]:
    limb, rng = chain(300, 12), np.random.default_rng(6)
    cut = Skeleton.from_joints(limb.skeleton.names, [-1, 0, 1, 2, 3, 4, -1, 6, 7, 8, 9, 10], limb.skeleton.joints)
    many = Pose(rng.normal(0, 0.2, (300, 3)), np.ones(3))
    any_pose = Pose(rng.normal(0, 1.0, (12, 3)), rng.normal(size=3))
    rows: list[Row] = [
        ("two roots", "a chain cut in two", _TWIN, _posed(Avatar(limb.splats, cut, limb.skin), [any_pose])),
        ("one joint", "a skeleton of one", _TWIN, _posed(chain(100, 1), [_turned(1, 0, (1, 2, 3), 77)])),
        ("300 joints", "a chain of 300", _TWIN, _posed(chain(300, 300, 0.01), [many])),
    ]
    bones = {
        "scales": np.diag([2.0, 0.5, 1.0]),
        "reflects": np.diag([-1.0, 1, 1]),
        "flattens": np.diag([1e-3, 1, 1]),
        "is zero": np.zeros((3, 3)),
    }
    for word, matrix in bones.items():
        poses = [Pose(rng.normal(0, 0.8, (5, 3)), np.zeros(3)) for _ in range(5)]
        check = _posed(_bent(matrix), poses, covariance=1e-3)
        rows.append((f"a bone {word}", "one bone of a chain", "means follow, rotations stay rotations", check))
    return rows


def _refusals() -> list[Row]:
    names, apart = ("a", "b", "c"), np.zeros((3, 3))
    makes: list[tuple[str, str, type[GlsplatError], str, Callable[[], object]]] = [
        ("NaN in a pose", "one rotation", PoseError, "finite", lambda: _turned(3, 0, (1, 0, 0), np.nan)),
        ("a mistake of units", "trans 1e7 m", PoseError, "metres", lambda: Pose(apart, np.array([1e7, 0, 0]))),
        (
            "joint out of range",
            "joint 4 of 4, with weight",
            FormatError,
            "the skeleton has 4",
            lambda: Skin.create([[0, 4]], [[0.5, 0.5]], 4, 2),
        ),
        ("a cycle", "1 under 2 under 1", PoseError, "cycle", lambda: Skeleton.from_joints(names, [-1, 2, 1], apart)),
        ("no root", "parents 1, 2, 0", PoseError, "a root", lambda: Skeleton.from_joints(names, [1, 2, 0], apart)),
        ("singular rest frame", "a joint without axes", PoseError, "no inverse", _singular),
    ]
    return [(name, words, kind.__name__, refused(kind, text, make)) for name, words, kind, text, make in makes]


def _weight_cases() -> list[Row]:
    weights: dict[str, tuple[list[float], list[float]]] = {
        "weights sum to 0.5": ([0.3, 0.2], [0.6, 0.4]),
        "weights sum to 2": ([1.2, 0.8], [0.6, 0.4]),
        "weights sum to 0": ([0.0, 0.0], [1.0, 0.0]),
        "negative weight": ([0.6, -0.4], [1.0, 0.0]),
        "NaN weight": ([0.6, np.nan], [1.0, 0.0]),
        "infinite weight": ([np.inf, 0.4], [0.0, 1.0]),
    }
    rows: list[Row] = [
        (name, f"{given[0]:g}, {given[1]:g}", f"counts as {wanted[0]:g}, {wanted[1]:g}", _weighed(given, wanted))
        for name, (given, wanted) in weights.items()
    ]
    culled = "that splat is culled, the others keep their bytes"
    return [*rows, ("NaN weight behind the checks", "a Skin made by hand", culled, _bad_weight)]


def chain(count: int, joints: int, step: float = 0.05, seed: int = 5) -> Avatar:
    """Return splats around a chain of joints along x, each bound to four joints nearby with random weights."""
    rng = np.random.default_rng(seed)
    centres = np.stack([step * np.arange(joints), np.zeros(joints), np.zeros(joints)], -1)
    skeleton = Skeleton.from_joints(tuple(f"joint{i}" for i in range(joints)), np.arange(joints) - 1, centres)
    first = rng.integers(0, joints, count)
    ids = (first[:, None] + np.arange(4)) % joints
    means = np.stack([step * first, *rng.normal(0, 0.05, (2, count))], -1)
    scales = np.exp(rng.uniform(-8, -4, (count, 3)))
    colours = rng.random((count, 3))
    splats = Splats.create(means, rng.normal(size=(count, 4)), scales, rng.uniform(0.3, 1, count), rgb=colours)
    return Avatar(splats, skeleton, Skin.create(ids, rng.random(ids.shape) + 0.01, joints))


def _turned(joints: int, joint: int, axis: ArrayLike, degrees: float) -> Pose:
    rotations = np.zeros((joints, 3))
    rotations[joint] = np.asarray(axis) / np.linalg.norm(axis) * np.radians(degrees)
    return Pose(rotations, np.zeros(3))


def expressive(limb: Avatar) -> Avatar:
    """Return the avatar with six shapes; each moves and bends a random half of the splats."""
    rng, count = np.random.default_rng(8), len(limb.splats)
    splats, targets = np.nonzero(rng.random((count, 6)) < 0.5)
    moves, bends = rng.normal(0, 0.02, (len(splats), 3)), rng.normal(0, 0.4, (len(splats), 2, 3))
    names = [f"shape {k}" for k in range(6)]
    return replace(limb, shapes=Shapes.create(names, count, splats=splats, targets=targets, moves=moves, bends=bends))


def _expression_cases() -> list[Row]:
    limb = chain(300, 12)
    face = expressive(limb)
    shapes = face.shapes
    assert shapes is not None
    names = shapes.names

    def at(weight: float) -> Pose:
        return Pose(np.full((12, 3), 0.1), expression=dict.fromkeys(names, weight))

    same = "an expression within its limits"
    return [
        (same, "six shapes at 1", "as the float64 twin", _posed(face, [at(1.0)], proper=False)),
        ("weights of 0", "six shapes at 0", "the bytes of an avatar without shapes", _alike(face, at(0), limb, at(0))),
        ("weights of 2", "six shapes at 2", "the bytes of weights of 1", _alike(face, at(2), face, at(1))),
        ("weights of -1", "six shapes at -1", "the bytes of weights of 0", _alike(face, at(-1), face, at(0))),
        (
            "weights from -1 to 2",
            "an avatar whose limits are -2 and 3, its shapes at -1 and 2",
            "as the float64 twin",
            _posed(
                replace(face, shapes=replace(shapes, limits=np.tile((-2, 3), (6, 1)))), [at(-1), at(2)], proper=False
            ),
        ),
        ("NaN in an expression", "one weight", "PoseError", refused(PoseError, "finite", lambda: at(float("nan")))),
    ]


def _alike(one: Avatar, pose: Pose, other: Avatar, its: Pose) -> Callable[[Context], Outcome]:
    """Return a check that two avatars in two poses give the same bytes."""

    def check(context: Context) -> Outcome:
        with renderer(one, context) as drawn, renderer(other, context) as wanted:
            image = drawn.render([camera()], pose)
            expected = wanted.render([camera()], its)
            return Outcome(np.array_equal(image, expected), _largest(image - expected), "of 1")

    return check


def _posed(
    avatar: Avatar, poses: Iterable[Pose], covariance: float = COVARIANCE, proper: bool = True
) -> Callable[[Context], Outcome]:
    """Return a check of the skin pass against reference.skin in all poses; ``proper``: splats only rotate."""

    def check(context: Context) -> Outcome:
        position = shape = 0.0
        rigid = True
        with renderer(avatar, context, (1, 1)) as drawn:
            for pose in poses:
                drawn.render([camera(1)], pose)
                means, shapes = drawn.posed()
                bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
                expected = reference.skin(avatar.splats, avatar.skin, bones, shapes=avatar.shapes, expression=weights)
                position = max(position, _largest(means - expected.means))
                got, wanted = _covariances(shapes), _covariances(expected.shapes)
                size = np.maximum(np.linalg.norm(wanted, axis=(1, 2)), 1e-300)
                shape = max(shape, _largest(np.linalg.norm(got - wanted, axis=(1, 2)) / size))
                turned = _rotations(avatar.splats, shapes)
                gram = np.abs(turned @ np.swapaxes(turned, 1, 2) - np.eye(3)).max()
                rigid &= bool(gram <= 1e-5 and np.linalg.det(turned).min() > 0.9)
        held = position <= POSITION and shape <= covariance and rigid >= proper
        said = ("rotations" if rigid else "NOT rotations") if proper else "bent"
        return Outcome(held, position, "m", f"covariance {shape:.1e}, {said}")

    return check


def _wrapper(context: Context) -> Outcome:
    skeleton = Skeleton.from_joints(("a", "b"), [-1, 0], [[0.0, 0, 0], [0.5, 0, 0]])
    angle = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    ring = np.stack([np.full(256, 0.5), 0.05 * np.cos(angle), 0.05 * np.sin(angle)], -1)
    skin = Skin.create(np.tile([0, 1], (256, 1)), np.full((256, 2), 0.5), 2, 2)
    avatar = Avatar(replace(chain(256, 2).splats, means=ring.astype(np.float32)), skeleton, skin)
    with renderer(avatar, context) as drawn:
        image = drawn.render([camera()], _turned(2, 1, (1, 0, 0), 180))
        means, _ = drawn.posed()
        count = drawn.stats.drawn
    error = _largest(means - (0.5, 0, 0))
    return Outcome(error <= 1e-6 and count == 256 and bool(np.isfinite(image).all()), error, "m", f"{count} drawn")


def _full_turns(context: Context) -> Outcome:
    avatar, error = chain(300, 12), 0.0
    with renderer(avatar, context, (1, 1)) as drawn:
        drawn.render([camera(1)], Pose.zero(12))
        rest, _ = drawn.posed()
        for axis in (*np.eye(3), *-np.eye(3)):
            drawn.render([camera(1)], Pose(np.tile(2 * np.pi * axis, (12, 1)), np.zeros(3)))
            error = max(error, _largest(drawn.posed()[0] - rest))
    return Outcome(error <= 1e-6, error, "m")


def _sweep(context: Context) -> Outcome:
    skeleton = Skeleton.from_joints(("a", "b"), [-1, 0], [[0.0, 0, 0], [0.5, 0, 0]])
    half = np.linspace(0.5, 0.6, 200)
    skin = Skin.create(np.tile([0, 1], (200, 1)), np.stack([half, 1 - half], -1), 2, 2)
    avatar = Avatar(chain(200, 2).splats, skeleton, skin)
    fastest, before = 0.0, None
    with renderer(avatar, context, (1, 1)) as drawn:
        for degrees in np.arange(170, 190, SWEEP):
            drawn.render([camera(1)], _turned(2, 1, (0.3, 0.8, -0.5), degrees))
            now = _rotations(avatar.splats, drawn.posed()[1])
            if before is not None:
                chord = np.linalg.norm(now - before, axis=(1, 2)) / np.sqrt(8)
                fastest = max(fastest, _largest(np.degrees(2 * np.arcsin(np.clip(chord, 0, 1)))))
            before = now
    return Outcome(fastest <= 34 * SWEEP + 0.3, fastest, f"degrees in a step of {SWEEP:g}")


def _far(trans: tuple[float, float, float]) -> Callable[[Context], Outcome]:
    def check(context: Context) -> Outcome:
        avatar = chain(300, 12)
        near = Pose(np.random.default_rng(3).normal(0, 0.5, (12, 3)), np.zeros(3))
        expected = reference.skin(avatar.splats, avatar.skin, near.bones(avatar.skeleton)).means
        with renderer(avatar, context, (1, 1)) as drawn:
            drawn.render([camera(1)], replace(near, trans=np.array(trans)))
            error = _largest(drawn.posed()[0] - trans - expected)
        return Outcome(error <= POSITION, error, "m")

    return check


def _bad_weight(context: Context) -> Outcome:
    avatar, pose = chain(40, 4), _turned(4, 1, (0, 0, 1), 40)
    hidden, weights = avatar.splats.opacities.copy(), avatar.skin.weights.copy()
    hidden[7], weights[7] = 0, np.nan
    with renderer(replace(avatar, splats=replace(avatar.splats, opacities=hidden)), context) as drawn:
        expected = drawn.render([camera()], pose)
    # bypass the checks of Skin, as an old pickle does
    skin = restored(Skin, {"joints": avatar.skin.joints, "weights": weights, "lost": 0.0, "repaired": 0})
    parts = {
        "splats": avatar.splats,
        "skeleton": avatar.skeleton,
        "skin": skin,
        "meta": {},
        "levels": (),
        "shapes": None,
    }
    with renderer(restored(Avatar, parts), context) as drawn:
        error = _largest(drawn.render([camera()], pose) - expected)
        count = drawn.stats.culled["out of range"]
    return Outcome(error == 0 and count == 1, error, "of 1", f"{count} out of range")


def _weighed(given: list[float], wanted: list[float]) -> Callable[[Context], Outcome]:
    def check(_: Context) -> Outcome:
        skin = Skin.create([[0, 1]], [given], 2, 2)
        error = _largest(skin.dense(2)[0] - wanted)
        return Outcome(error <= 1e-6, error, "weight", f"{skin.repaired} repaired")

    return check


def _bent(linear: F64) -> Avatar:
    base = chain(300, 5)
    inverse_bind: F64 = np.linalg.inv(base.skeleton.rest).astype(np.float64)
    inverse_bind[2, :3] = linear @ inverse_bind[2, :3]
    skeleton = Skeleton(base.skeleton.names, base.skeleton.parents, base.skeleton.rest, inverse_bind)
    return Avatar(base.splats, skeleton, base.skin)


def _singular() -> Skeleton:
    rest = np.tile(np.eye(4), (2, 1, 1))
    rest[1, :3, :3] = 0
    return Skeleton(("a", "b"), np.array([-1, 0]), rest)


def _largest(values: NDArray[Any]) -> float:
    """Return the largest absolute value; NaN counts as infinite."""
    return float(np.nan_to_num(np.abs(values), nan=np.inf).max(initial=0))


def _covariances(shapes: NDArray[np.floating]) -> F64:
    m = shapes.astype(np.float64)
    return m @ np.swapaxes(m, 1, 2)


def _rotations(splats: Splats, shapes: NDArray[np.floating]) -> F64:
    """Return the R_i [N, 3, 3] with ``shapes`` = R_i R(q) diag(s)."""
    turned = shapes / splats.scales.astype(np.float64)[:, None, :]
    return turned @ np.swapaxes(reference.quaternion_matrices(splats.quats), 1, 2)
