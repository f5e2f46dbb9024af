"""Training data from motions: a headset's samples at the network's rate, and the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glsplat.arrays import F32
from glsplat.extras.learned.frames import OUTPUTS, RATE_HZ, TrackedFrames, in_yaw_frame, unit_of, yaw_of
from glsplat.extras.motions.derive import truth_from_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.solve.body import ANKLES, FEET, HEAD, KNEES, PELVIS, SPINE3, WRISTS, Body

SPEEDS = (1.0, 0.87, 1.15)  # playback speeds of every motion
AWAY = 60.0  # degrees of the head from the chest
STILL = 0.55  # m/s below which the ball of a foot stands


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
