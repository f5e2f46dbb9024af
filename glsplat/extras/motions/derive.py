"""Derive head and hand tracking from a full-body motion, the ground truth that scores solvers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError
from glsplat.motion.motion import Motion
from glsplat.rotations import (
    matrix_quaternions,
    quaternion_product,
    quaternion_vectors,
    rotation_matrices,
    vector_quaternions,
)
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.calibration import JOINTS
from glsplat.tracking.sample import BODY_JOINTS, TRACKERS, Sample, Transform
from glsplat.tracking.solve.body import ANKLES, FEET, HAND_FRAMES, HEAD, HIPS, KNEES, PELVIS, SPINE1, WRISTS, Body
from glsplat.tracking.solve.quat import Vec

Array = NDArray[np.float64]

EXTRAS = ("waist", "feet", "body")  # trackers that ``derive`` can add to a headset

MOUNTS: tuple[tuple[Vec, Vec], ...] = (
    ((0.03, 0.06, -0.13), (0.3, 2.9, 0.2)),
    ((0.01, -0.02, 0.07), (-0.6, 0.3, 0.1)),
    ((-0.02, -0.01, 0.08), (2.0, -0.4, 1.0)),
)
"""Poses of trackers in the frames of pelvis, left and right ankle: metres, and a rotation vector. They are on the back
of a belt and on both insteps, the right one at an arbitrary angle."""


def forward_all(skeleton: Skeleton, rotations: Array, trans: Array) -> tuple[Array, Array]:
    """Return world positions [T, J, 3] and rotations [T, J, 3, 3] of axis-angle [T, J, 3] and trans [T, 3].

    The rig's rest frames must be parallel to the world (SMPL-X).
    """
    local = rotation_matrices(rotations)
    rest, parents = skeleton.joints, skeleton.parents
    frames, positions = np.empty_like(local), np.empty(rotations.shape)
    for joint in range(len(skeleton)):  # SMPL-X lists parents first
        parent = int(parents[joint])
        if parent < 0:
            frames[:, joint], positions[:, joint] = local[:, joint], trans + rest[joint]
        else:
            frames[:, joint] = frames[:, parent] @ local[:, joint]
            positions[:, joint] = positions[:, parent] + frames[:, parent] @ (rest[joint] - rest[parent])
    return positions, frames


def resample(rotations: Array, trans: Array, fps: float, rate: float) -> tuple[Array, Array]:
    """Resample a motion from ``fps`` to ``rate``: cubic Hermite (Catmull-Rom) on trans and sign-aligned quaternions."""
    frames = len(trans)
    if frames < 2 or abs(rate - fps) < 1e-9:
        return rotations, trans
    quats = vector_quaternions(rotations)
    flips = np.where((quats[1:] * quats[:-1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    quats[1:] *= np.cumprod(flips, axis=0)
    when = np.arange(int(np.floor((frames - 1) / fps * rate + 1e-9)) + 1) * (fps / rate)
    out = _hermite(quats.reshape(frames, -1), when).reshape(-1, *quats.shape[1:])
    return quaternion_vectors(out / np.linalg.norm(out, axis=-1, keepdims=True)), _hermite(trans, when)


def _hermite(values: Array, when: NDArray[np.floating]) -> Array:
    k = np.clip(np.floor(when).astype(np.intp), 0, len(values) - 2)
    s = (when - k)[:, None]
    p0, p1 = values[k], values[k + 1]
    tangents = np.gradient(values, axis=0)
    m0, m1 = tangents[k], tangents[k + 1]
    s2, s3 = s * s, s * s * s
    return (2 * s3 - 3 * s2 + 1) * p0 + (s3 - 2 * s2 + s) * m0 + (3 * s2 - 2 * s3) * p1 + (s3 - s2) * m1


_BODY = [PELVIS, SPINE1, *[leg[i] for i in (0, 1) for leg in (HIPS, KNEES, ANKLES, FEET)]]  # BODY_JOINTS


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """A motion on the ground, at the rate of its samples."""

    times: Array  # [T] seconds
    rotations: Array  # [T, 55, 3] axis-angle
    trans: Array  # [T, 3] metres
    positions: Array  # [T, 55, 3] joints in the world
    frames: Array  # [T, 55, 3, 3] joint axes in the world


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Errors of real tracking."""

    noise_mm: float = 0.0  # standard deviation of positions, a coordinate; white
    noise_deg: float = 0.0  # standard deviation of orientations, an axis
    dropout: float = 0.0  # share of the time a hand is lost
    dropout_s: float = 0.3  # mean length of a loss, seconds
    latency_s: float = 0.0  # age of the samples' poses, seconds
    seed: int = 0


def truth_from_motion(skeleton: Skeleton, rotations: Array, trans: Array, fps: float, rate: float) -> TrueMotion:
    """Return a motion of ``skeleton`` at ``rate`` Hz, in a world whose ground is y = 0 (where the zero pose stands)."""
    if not (1 <= rate <= 1000 and fps > 0):
        raise PoseError(f"a rate needs 1 to 1000 Hz, not {rate:g} (motion at {fps:g} fps)")
    if len(trans) < 2:
        raise PoseError("tracking is derived from a motion of at least two frames, not one pose")
    rotations, trans = resample(np.asarray(rotations, np.float64), np.asarray(trans, np.float64), fps, rate)
    trans = trans - np.array([0.0, Body.of(skeleton).ground, 0.0])
    positions, frames = forward_all(skeleton, rotations, trans)
    return TrueMotion(np.arange(len(trans)) / rate, rotations, trans, positions, frames)


def derive(skeleton: Skeleton, truth: TrueMotion, fingers: bool = True, trackers: Sequence[str] = ()) -> list[Sample]:
    """Return an ideal headset's samples of the truth: eyes, wrists and (``fingers``) 25 joints a hand.

    ``trackers`` adds any of "waist", "feet" and "body"; ``MOUNTS`` has their poses on the body.
    """
    if unknown := set(trackers) - set(EXTRAS):
        raise PoseError(f"trackers are {', '.join(EXTRAS)}, not {', '.join(sorted(unknown))}")
    body = Body.of(skeleton)
    head_quats = quaternion_product(matrix_quaternions(truth.frames[:, HEAD]), np.array([0.0, 0.0, 1.0, 0.0]))
    eyes = truth.positions[:, HEAD] + truth.frames[:, HEAD] @ np.array(body.eye)
    head = _transforms(eyes, head_quats)
    hands = {}
    for side, wrist in zip(("left", "right"), WRISTS, strict=True):
        quats = quaternion_product(matrix_quaternions(truth.frames[:, wrist]), np.array(HAND_FRAMES[side]))
        hands[side] = _transforms(truth.positions[:, wrist], quats)
    joints: dict[str, list[tuple[tuple[float, ...], ...]] | list[None]] = {
        side: _hand_joints(body, truth, side) if fingers else [None] * len(head) for side in ("left", "right")
    }
    samples = [
        Sample(float(t), head[i], hands["left"][i], hands["right"][i], joints["left"][i], joints["right"][i])
        for i, t in enumerate(truth.times)
    ]
    worn = [name for name in TRACKERS if (name if name == "waist" else "feet") in trackers]
    poses = {name: _tracker(truth, TRACKERS.index(name)) for name in worn}
    if worn:
        samples = [
            replace(s, **{name: poses[name][i] for name in worn})  # type: ignore[arg-type]
            for i, s in enumerate(samples)
        ]
    if "body" in trackers:
        places = truth.positions[:, _BODY].tolist()
        bodies = [dict(zip(BODY_JOINTS, map(tuple, joints), strict=True)) for joints in places]
        samples = [replace(s, body=joints) for s, joints in zip(samples, bodies, strict=True)]
    return samples


def with_expressions(samples: Sequence[Sample], motion: Motion) -> list[Sample]:
    """Return the samples with the expressions of ``motion`` at their times."""
    if not motion.expressions:
        return list(samples)
    return [replace(sample, expression=motion.at(sample.t, loop=False).expression) for sample in samples]


def disturb(samples: list[Sample], how: Disturbance) -> list[Sample]:
    """Apply latency, then losses of hands, then noise; the same for the same seed."""
    rng = np.random.default_rng(how.seed)
    times = np.array([s.t for s in samples])
    dt = float(np.median(np.diff(times))) if len(times) > 1 else 1 / 72
    source = np.searchsorted(times, times - how.latency_s - 1e-9)
    out = []
    lost = {"left": False, "right": False}
    leave = min(1.0, dt / max(how.dropout_s, 1e-3))
    enter = min(1.0, leave * how.dropout / max(1 - how.dropout, 1e-6)) if how.dropout > 0 else 0.0
    for index, sample in enumerate(samples):
        seen = replace(samples[int(source[index])], t=sample.t)
        for side in ("left", "right"):
            lost[side] = rng.random() >= leave if lost[side] else rng.random() < enter
            if lost[side]:
                seen = replace(seen, **{side: None, f"{side}_joints": None})  # type: ignore[arg-type]
        if how.noise_mm or how.noise_deg:
            noisy = {
                key: _noisy(pose, rng, how.noise_mm / 1000, np.radians(how.noise_deg))
                for key in ("head", "left", "right", *TRACKERS)
                if (pose := getattr(seen, key)) is not None
            }
            seen = replace(seen, **noisy)  # type: ignore[arg-type]
            if seen.body is not None:
                places = np.array([joint[:3] for joint in seen.body.values()]).reshape(-1, 3)
                places += rng.normal(0, how.noise_mm / 1000, places.shape)
                seen = replace(seen, body=dict(zip(seen.body, map(tuple, places.tolist()), strict=True)))
        out.append(seen)
    return out


def _tracker(truth: TrueMotion, index: int) -> list[Transform]:
    """Return the poses of a tracker mounted by ``MOUNTS``."""
    joint, (offset, turn) = JOINTS[index], MOUNTS[index]
    frames = truth.frames[:, joint]
    return _transforms(
        truth.positions[:, joint] + frames @ np.array(offset),
        quaternion_product(matrix_quaternions(frames), vector_quaternions(np.array(turn))),
    )


def _noisy(pose: Transform, rng: np.random.Generator, metres: float, radians: float) -> Transform:
    position = np.array(pose[:3]) + rng.normal(0, metres, 3) if metres else np.array(pose[:3])
    small = np.array([*rng.normal(0, radians / 2, 3), 1.0]) if radians else np.array([0, 0, 0, 1.0])
    x, y, z, w = pose[3:]
    quat = quaternion_product(np.array([w, x, y, z]), small[[3, 0, 1, 2]])
    quat /= np.linalg.norm(quat)
    return (*position.tolist(), *quat[[1, 2, 3, 0]].tolist())


def _transforms(positions: Array, quats: Array) -> list[Transform]:
    rows = np.concatenate([positions, quats[:, [1, 2, 3, 0]]], 1).tolist()
    return [tuple(row) for row in rows]


def _hand_joints(body: Body, truth: TrueMotion, side: str) -> list[tuple[tuple[float, ...], ...]]:
    """Return WebXR's 25 joints (wrist, thumb (4), four fingers of 5) from SMPL-X's 16 and rest-pose fingertips."""
    wrist, first = (WRISTS[0], 25) if side == "left" else (WRISTS[1], 40)
    palm = truth.positions[:, wrist]
    columns: list[Array] = [palm]
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        base = first + 3 * ("index", "middle", "pinky", "ring", "thumb").index(finger)
        bones = [truth.positions[:, base + i] for i in range(3)]
        # the last phalanx is a little shorter than the one before it (Buryanov & Kotiuk 2010: about 0.75)
        reach = 0.75 * (body.rest[base + 2] - body.rest[base + 1])
        tip = bones[2] + truth.frames[:, base + 2] @ reach
        metacarpal = [] if finger == "thumb" else [palm + 0.3 * (bones[0] - palm)]
        columns += [*metacarpal, *bones, tip]
    stacked = np.stack(columns, 1).tolist()  # [T, 25, 3]
    return [tuple([tuple(joint) for joint in row]) for row in stacked]
