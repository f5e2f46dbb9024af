"""Training data from motions: a headset's samples at the network's rate, disturbed, and the ground truth.

Samples are disturbed as by real tracking: noise, lost hands, offsets of devices, calibration errors. Users also look
about, while captured people look where they go.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.extras.learned.network import OUTPUTS, RATE_HZ, TICK_S, TrackedFrames, in_yaw_frame, unit_of, yaw_of
from glsplat.extras.motions.derive import truth_from_motion
from glsplat.motion.motion import Motion
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.solve.body import ANKLES, FEET, HEAD, KNEES, PELVIS, SPINE3, WRISTS, Body

SPEEDS = (1.0, 0.87, 1.15)  # playback speeds of every motion
AWAY = 60.0  # degrees of the head from the chest
STILL = 0.55  # m/s below which the ball of a foot stands

HEIGHT = 0.02  # standard deviation of a calibration's scale
PITCH, SEAT = 3.0, 0.01  # standard deviations of a headset's fit: degrees, metres
GRIP, TILT = 0.012, 5.0  # standard deviations of a controller in a hand: metres, degrees
WHITE, SPIN = 0.0007, 0.15  # white noise: metres, degrees
CLEAN = 0.3  # share of sequences without these errors
HEAD_ONLY, LOSES = 0.08, 0.3  # shares of sequences without hands, and with temporary losses of hands
LOSS = 0.7  # mean length of a loss, seconds
LOOKS = 0.5  # share of sequences in which the head looks elsewhere
GAZE, MOST = (32.0, 14.0), (70.0, 35.0)  # yaw and pitch of a gaze, degrees: standard deviations, limits
HELD, SHIFT = 1.6, 0.11  # mean length of a gaze; time constant of the two low passes of a turn; seconds
NECK = (0.0, -0.07, -0.08)  # from between the eyes to the head's pivot, in its frame (of eyes at 1.6 m)


@dataclass(slots=True)
class TrainingClip:
    """One motion at RATE_HZ: the network's view of it, and the ground truth in the world."""

    group: str  # the captured person
    seen: TrackedFrames
    points: F32  # [T, 7, 3] pelvis, knees, ankles, feet
    pelvis: F32  # [T, 3, 3]
    chest: F32  # [T, 3, 3]
    contact: F32  # [T, 2]
    plain: bool = False  # as captured: neither mirrored nor at another speed
    made: bool = False  # combined from several captures (``standing.py``)


def clips_of(
    group: str, motion: Motion, skeleton: Skeleton, speeds: Sequence[float] = SPEEDS, made: bool = False
) -> list[TrainingClip]:
    """Return the motion at several speeds, or its own if ``made``, each also mirrored."""
    out = []
    for speed in (1.0,) if made else speeds:
        if len(motion) / motion.fps / speed < 1:
            continue
        clip = _clip(group, motion, skeleton, speed)
        clip.plain = speed == 1
        other = mirrored(clip)
        clip.made = other.made = made
        out += [clip, other]
    return out


def _clip(group: str, motion: Motion, skeleton: Skeleton, speed: float) -> TrainingClip:
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps * speed, RATE_HZ)
    body = Body.of(skeleton)
    p, f = truth.positions, truth.frames
    eye = p[:, HEAD] + f[:, HEAD] @ np.array(body.eye)
    tracked = np.ones((len(p), 2))
    wrists = list(WRISTS)
    seen = TrackedFrames(
        *[a.astype(np.float32) for a in (eye, yaw_of(f[:, HEAD]), f[:, HEAD], p[:, wrists], f[:, wrists], tracked)]
    )
    feet = p[:, list(FEET)]
    speed_of = np.linalg.norm(np.gradient(feet, axis=0), axis=-1) * RATE_HZ
    contact = speed_of < STILL  # not by height: captured floors and retargeted ankles are centimetres off
    points = p[:, [PELVIS, *KNEES, *ANKLES, *FEET]]
    of_points, pelvis, chest, stands = (a.astype(np.float32) for a in (points, f[:, PELVIS], f[:, SPINE3], contact))
    return TrainingClip(group, seen, of_points, pelvis, chest, stands)


def mirrored(clip: TrainingClip) -> TrainingClip:
    """Exchange left and right: reflect the world in x."""
    flip = np.array([-1, 1, 1], np.float32)
    turn = flip[:, None] * flip
    seen = clip.seen
    other = [1, 0]
    return TrainingClip(
        clip.group,
        TrackedFrames(
            seen.eye * flip,
            -seen.yaw,
            seen.head * turn,
            seen.at[:, other] * flip,
            seen.hand[:, other] * turn,
            seen.tracked[:, other],
        ),
        clip.points[:, [0, 2, 1, 4, 3, 6, 5]] * flip,
        clip.pelvis * turn,
        clip.chest * turn,
        clip.contact[:, other],
    )


def looks_away(clip: TrainingClip) -> bool:
    """Return whether the head is turned from the chest by more than AWAY most of the time: a marker was lost."""
    off = (clip.seen.yaw - yaw_of(clip.chest) + np.pi) % (2 * np.pi) - np.pi
    return bool(np.degrees(np.median(np.abs(off))) > AWAY)


def targets_of(clip: TrainingClip, unit: float) -> F32:
    """Return the network's target outputs [T, OUTPUTS]; contacts are 0 or 1. The last tick repeats its own as next."""
    t, yaw = len(clip.points), clip.seen.yaw
    ground = clip.seen.eye * np.array([1, 0, 1], np.float32)
    points = in_yaw_frame(clip.points - ground[:, None], yaw)
    later = clip.points[np.minimum(np.arange(t) + 1, t - 1), 3:]
    ahead = in_yaw_frame(later - ground[:, None], yaw)
    axes = [
        in_yaw_frame(m[:, :, [0, 2]].transpose(0, 2, 1), yaw).transpose(0, 2, 1).reshape(t, 6)
        for m in (clip.pelvis, clip.chest)
    ]
    out = np.concatenate((points.reshape(t, 21) / unit, ahead.reshape(t, 12) / unit, *axes, clip.contact), -1)
    assert out.shape[1] == OUTPUTS
    return out.astype(np.float32)


def unit_of_skeleton(skeleton: Skeleton) -> float:
    """Return the network's unit of length for this body, metres."""
    return unit_of(Body.of(skeleton).eye_height)


def disturbed(seen: TrackedFrames, rng: np.random.Generator) -> TrackedFrames:
    """Return one sequence [T] as a device would track it; the ground truth does not change."""
    t = len(seen.yaw)
    eye, head, at, hand = (a.astype(np.float64) for a in (seen.eye, seen.head, seen.at, seen.hand))
    if rng.random() < LOOKS:
        eye, head = _elsewhere(eye, head, rng)
    if rng.random() >= CLEAN:
        scale = 1 + HEIGHT * rng.standard_normal()
        # scales height and reach, not the position in the room
        tall = eye * np.array([1, scale, 1])
        eye, at = tall, tall[:, None] + (at - eye[:, None]) * scale
        head = head @ _turn(rng, (PITCH, 0.5, 1.0), 1)[0]
        eye += SEAT * rng.standard_normal(3)
        for side in (0, 1):
            hand[:, side] = hand[:, side] @ _turn(rng, (TILT,) * 3, 1)[0]
            at[:, side] += np.einsum("tab,b->ta", hand[:, side], GRIP * rng.standard_normal(3))
        size = rng.random()
        eye += size * WHITE * rng.standard_normal(eye.shape)
        at += size * WHITE * rng.standard_normal(at.shape)
        head = head @ _turn(rng, (size * SPIN,) * 3, t)
        hand = hand @ _turn(rng, (size * SPIN,) * 3, 2 * t).reshape(t, 2, 3, 3)
    tracked = seen.tracked.copy()
    kind = rng.random()
    if kind < HEAD_ONLY:
        tracked[:] = 0
    elif kind < HEAD_ONLY + LOSES:
        for side in (0, 1):
            when = 0.0
            while (when := when + rng.exponential(4.0)) < t * TICK_S:
                length = rng.exponential(LOSS)
                tracked[int(when / TICK_S) : int((when + length) / TICK_S) + 1, side] = 0
                when += length
    yaw = np.where(head[:, 1, 1] > -0.9, yaw_of(head), seen.yaw)
    return TrackedFrames(*[a.astype(np.float32) for a in (eye, yaw, head, at, hand, tracked)])


def _elsewhere(
    eye: NDArray[np.float64], head: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Turn eyes and head about the neck from gaze to gaze, independent of the body."""
    t = len(eye)
    goals = np.empty((t, 2))
    first = 0
    while first < t:
        last = first + 1 + int(rng.exponential(HELD) / TICK_S)
        goals[first:last] = np.clip(rng.standard_normal(2) * GAZE, np.negative(MOST), MOST)
        first = last
    k = 1 - np.exp(-TICK_S / SHIFT)
    for _ in range(2):
        now = goals[0]
        for i in range(t):
            goals[i] = now = now + (goals[i] - now) * k
    yaw, pitch = np.radians(goals).T
    nought = np.zeros(t)
    turned = rotation_matrices(np.stack((nought, yaw, nought), -1)) @ head
    turned = turned @ rotation_matrices(np.stack((pitch, nought, nought), -1))
    neck = eye + head @ NECK
    return neck - turned @ NECK, np.asarray(turned, np.float64)


def _turn(rng: np.random.Generator, degrees: tuple[float, float, float], count: int) -> NDArray[np.float64]:
    return np.asarray(rotation_matrices(np.radians(degrees) * rng.standard_normal((count, 3))), np.float64)
