"""Combine upper bodies of captured people with standing legs, which users need most and captures have least.

The feet do not move; the pelvis sways, and moves against the lean of the torso to keep balance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.learned.network import RATE_HZ, yaw_of
from glsplat.extras.motions.derive import truth_from_motion
from glsplat.motion.motion import Motion
from glsplat.rotations import matrix_quaternions, quaternion_product, quaternion_vectors, rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.solve.body import ANKLES, FEET, HIPS, KNEES, PELVIS, SPINE1, SPINE3, Body
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.leg import Leg
from glsplat.tracking.solve.quat import Quat, Vec, add, inverse_mul, mul, power, rotate

Array = NDArray[np.float64]

STILL = 0.12  # highest speed of pelvis and feet that stand, m/s
FLAT = 0.06  # greatest height of a ball above its rest height, metres
TALL = 0.93  # least height of a standing pelvis, of its height at rest
EACH = 1.0  # seconds between stances of one motion
UPRIGHT = 0.6  # least vertical component of the up axes of pelvis and chest
LEANS = 0.35  # greatest horizontal distance of the chest from the pelvis, metres
NEARLY = 2.0  # percent of a motion that may exceed these two
HEADING = 0.5  # smoothing of a donor's heading, seconds; faster turns are twists of the torso
BALANCE = 0.75  # of the chest's lean that the pelvis moves the other way
SINKS = 0.2  # most metres that a donor's crouch lowers the pelvis
SWAY, SHIFT = (0.012, 0.8), (0.03, 3.0)  # metres and seconds of two random sways over the feet
REACH = 0.995  # of its length that a standing leg has at most
TILT = 0.6  # of the donor's pelvis tilt that is kept


@dataclass(slots=True)
class Stance:
    """A standing pose; the origin is on the ground (y = 0) below the pelvis, +z is ahead."""

    height: float  # of the pelvis, metres
    balls: tuple[Vec, Vec]
    yaws: tuple[float, float]  # of the feet
    knees: tuple[Vec, Vec]  # from the middle between hip and ankle
    chest: Vec  # from the pelvis


def stances_of(motion: Motion, skeleton: Skeleton) -> list[Stance]:
    """Return the stances of a motion in which feet and pelvis are still, at least EACH apart."""
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, RATE_HZ)
    body = Body.of(skeleton)
    at, frames = truth.positions, truth.frames
    if len(at) < 3:
        return []
    moving = at[:, [PELVIS, *FEET]]
    speed = np.linalg.norm(np.gradient(moving, axis=0), axis=-1).max(1) * RATE_HZ
    high = body.joints[PELVIS][1] - body.ground
    stands = (speed < STILL) & (at[:, list(FEET), 1].max(1) < body.sole + FLAT) & (at[:, PELVIS, 1] > TALL * high)
    out: list[Stance] = []
    rest = [np.arctan2(*np.subtract(body.rest[FEET[i]], body.rest[ANKLES[i]])[[0, 2]]) for i in (0, 1)]
    last = -np.inf
    for i in np.flatnonzero(stands).tolist():
        if i - last < EACH * RATE_HZ:
            continue
        last = float(i)
        yaw = float(yaw_of(frames[i, PELVIS]))
        c, s = np.cos(yaw), np.sin(yaw)
        back = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        local = (at[i] - at[i, PELVIS] * [1, 0, 1]) @ back.T
        yaws = [float(np.arctan2(*(local[FEET[k]] - local[ANKLES[k]])[[0, 2]]) - rest[k]) for k in (0, 1)]
        knees = [local[KNEES[k]] - 0.5 * (local[HIPS[k]] + local[ANKLES[k]]) for k in (0, 1)]
        chest = local[SPINE3] - local[PELVIS]
        balls = local[list(FEET)] * [1, 0, 1] + [0, body.sole, 0]
        (one, other), (left, right) = map(_vec, balls), map(_vec, knees)
        height = float(local[PELVIS, 1])
        out.append(Stance(height, (one, other), (yaws[0], yaws[1]), (left, right), _vec(chest)))
    return out


def stood(motion: Motion, stances: Sequence[Stance], skeleton: Skeleton, rng: np.random.Generator) -> Motion | None:
    """Return the motion's upper body on a random stance, at RATE_HZ; None if it would fall, or is too short."""
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, RATE_HZ)
    at, frames = truth.positions, truth.frames
    off = at[:, SPINE3] - at[:, PELVIS]
    up = np.minimum(frames[:, PELVIS, 1, 1], frames[:, SPINE3, 1, 1])
    lean = np.hypot(off[:, 0], off[:, 2])
    if not stances or len(at) < 2 * RATE_HZ:
        return None
    if np.percentile(up, NEARLY) < UPRIGHT or np.percentile(lean, 100 - NEARLY) > LEANS:
        return None
    body, stance = Body.of(skeleton), stances[int(rng.integers(len(stances)))]
    away = -_slowly(np.unwrap(yaw_of(frames[:, PELVIS])), HEADING)
    facing = rotation_matrices(np.stack((0 * away, away, 0 * away), -1))
    frames = facing[:, None] @ frames
    tilt = matrix_quaternions(frames[:, PELVIS])
    pelvis = np.array([power((q[0], q[1], q[2], q[3]), TILT) for q in tilt.tolist()])
    place = _places(stance, (facing @ off[..., None])[..., 0], at[:, PELVIS, 1], rng)
    rotations = truth.rotations.copy()
    spine = quaternion_product(pelvis * [1, -1, -1, -1], matrix_quaternions(frames[:, SPINE1]))
    for joint, quats in ({PELVIS: pelvis, SPINE1: spine} | _legs(body, stance, place, pelvis)).items():
        rotations[:, joint] = quaternion_vectors(quats)
    trans = place + [0.0, body.ground, 0.0] - body.rest[PELVIS]
    return Motion(RATE_HZ, rotations, trans)


def _places(stance: Stance, off: Array, height: Array, rng: np.random.Generator) -> Array:
    """Return positions [T, 3] of the pelvis over the feet; the chest is at ``off`` from it."""
    t = len(off)
    place = np.zeros((t, 3))
    leans = off - np.array(stance.chest)
    for metres, seconds in (SWAY, SHIFT):
        noise = _slowly(rng.standard_normal((t + 200, 2)), seconds)[100:-100]
        place[:, [0, 2]] += metres * noise / max(float(noise.std()), 1e-9)
    place[:, [0, 2]] -= BALANCE * _slowly(leans, 0.1)[:, [0, 2]]
    place[:, 1] = stance.height - np.clip(np.percentile(height, 80) - height, 0.0, SINKS)
    return place


def _legs(body: Body, stance: Stance, place: Array, pelvis: Array) -> dict[int, Array]:
    """Return local rotations [T, 4] of hips, knees and ankles; lower the pelvis until both feet reach the ground."""
    legs, feet = (Leg(body, 0), Leg(body, 1)), (Foot(0), Foot(1))
    for foot, ball, yaw in zip(feet, stance.balls, stance.yaws, strict=True):
        foot.plant(ball, yaw)
    ankles = [leg.above(foot, 0.0) for leg, foot in zip(legs, feet, strict=True)]
    out: dict[int, list[Quat]] = {joint: [] for joint in (*HIPS, *KNEES, *ANKLES)}
    for i, row in enumerate(pelvis.tolist()):
        turn: Quat = (row[0], row[1], row[2], row[3])
        hips = [rotate(turn, leg.hip) for leg in legs]
        for leg, hip, ankle in zip(legs, hips, ankles, strict=True):
            x, z = place[i, 0] + hip[0] - ankle[0], place[i, 2] + hip[2] - ankle[2]
            reach = max((REACH * leg.length) ** 2 - x * x - z * z, 0.0) ** 0.5
            place[i, 1] = min(place[i, 1], reach + ankle[1] - hip[1])
        at = _vec(place[i])
        for side, (leg, foot, hip) in enumerate(zip(legs, feet, hips, strict=True)):
            thigh, knee, flat = leg.solve(foot, add(at, hip), turn, 0.0, stance.knees[side])
            out[HIPS[side]].append(inverse_mul(turn, thigh))
            out[KNEES[side]].append(knee)
            out[ANKLES[side]].append(inverse_mul(mul(thigh, knee), flat))
    return {joint: np.array(quats) for joint, quats in out.items()}


def _vec(values: Array) -> Vec:
    x, y, z = values.tolist()
    return x, y, z


def _slowly(values: Array, seconds: float) -> Array:
    """Smooth along the first axis by a Gaussian of this standard deviation; ends are repeated."""
    reach = int(3 * seconds * RATE_HZ) + 1
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (seconds * RATE_HZ)) ** 2)
    weights /= weights.sum()
    padded = np.concatenate((np.repeat(values[:1], reach, 0), values, np.repeat(values[-1:], reach, 0)))
    flat = padded.reshape(len(padded), -1)
    smooth = np.stack([np.convolve(column, weights, "valid") for column in flat.T], -1)
    return smooth.reshape(values.shape)
