"""Disturb a headset's samples as real tracking does: noise, lost hands, offsets of devices, calibration errors.

Users also look about, while captured people look where they go.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.learned.frames import TICK_S, TrackedFrames, yaw_of
from glsplat.rotations import rotation_matrices

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
