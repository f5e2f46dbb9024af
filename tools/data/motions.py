"""Make the embedded motions from joint-angle curves: idle, walk (on the spot), wave-and-turn.

python -m tools.data.motions
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from glsplat.arrays import F64
from glsplat.data import default_avatar
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, POSE_KEYS

FPS = 30.0
_INDEX = {name: i for i, name in enumerate(JOINT_NAMES)}
_SIDES = (("left", 1.0), ("right", -1.0))

# Joint angles of level walking over one cycle from heel strike, degrees: flexion positive, (phase, angle) knots.
_HIP = ((0.0, 26), (0.12, 22), (0.3, 6), (0.5, -10), (0.6, -6), (0.75, 18), (0.87, 28))
_KNEE = ((0.0, 5), (0.14, 17), (0.38, 6), (0.5, 12), (0.62, 38), (0.73, 58), (0.88, 22))
_ANKLE = ((0.0, 0), (0.07, -5), (0.3, 6), (0.45, 10), (0.62, -16), (0.75, -2), (0.88, 2))


def library(skeleton: Skeleton) -> dict[str, Motion]:
    """Return looping motions by name; ``skeleton`` (SMPL-X) gives the height of the pelvis above the floor."""
    return {"idle": _idle(), "walk": _walk(skeleton), "wave-and-turn": _wave_and_turn()}


def to_json(motion: Motion, skeleton: Skeleton) -> str:
    """Return JSON with fps, joints (of the body) and frames: poses without keys that stay zero, rounded to 1e-4."""
    moving = {key: joints for key, joints in POSE_KEYS.items() if np.abs(motion.rotations[:, joints]).max() > 5e-5}
    frames = []
    for rotations, trans in zip(motion.rotations, motion.trans, strict=True):
        frame: dict[str, object] = {"trans": _rounded(trans)}
        for key, joints in moving.items():
            value = rotations[joints]
            frame[key] = _rounded(value[0]) if len(value) == 1 else [_rounded(v) for v in value]
        frames.append(frame)
    note = {"licence": "CC0-1.0", "source": "glsplat, made from joint-angle curves", "fps": motion.fps}
    note["joints"] = [_rounded(place) for place in skeleton.joints]
    return json.dumps({**note, "frames": frames}, separators=(",", ":")) + "\n"


def _rounded(values: F64) -> list[float]:
    return [0.0 if abs(v) < 5e-5 else round(float(v), 4) for v in values]


def _base(frames: int, joints: Mapping[str, Rotation]) -> dict[str, Rotation]:
    """Return ``joints`` over a base pose: hanging arms, slightly bent elbows and fingers."""
    out: dict[str, Rotation] = {}
    for side, sign in _SIDES:
        out[f"{side}_collar"] = _about("z", -0.08 * sign)
        out[f"{side}_shoulder"] = _about("x", 0.05) * _about("z", -1.22 * sign)
        out[f"{side}_elbow"] = _about("y", -0.28 * sign)
        out[f"{side}_wrist"] = _about("z", 0.06 * sign)
        for spread, finger in enumerate(("index", "middle", "ring", "pinky")):
            for i, bend in ((1, 0.22), (2, 0.32), (3, 0.2)):
                out[f"{side}_{finger}{i}"] = _about("z", -sign * bend * (1 + 0.12 * spread))
        out[f"{side}_thumb1"] = _about("y", 0.12 * sign)
        out[f"{side}_thumb2"] = _about("y", 0.15 * sign)
    out.update(joints)
    return out


def _about(axis: str, angle: float | F64) -> Rotation:
    return Rotation.from_euler(axis, np.asarray(angle, np.float64)[..., None])


def _motion(frames: int, joints: Mapping[str, Rotation], trans: F64) -> Motion:
    rotations = np.zeros((frames, len(JOINT_NAMES), 3))
    for name, rotation in joints.items():
        rotations[:, _INDEX[name]] = rotation.as_rotvec()
    return Motion(FPS, rotations, trans)


def _idle(seconds: float = 6.0) -> Motion:
    """Return a standing motion: breath, a slow shift of weight with the feet in place, and a moving head."""
    frames = round(seconds * FPS)
    joints, trans = _standing(2 * np.pi * np.arange(frames) / frames)
    return _motion(frames, _base(frames, joints), trans)


def _standing(turn: F64) -> tuple[dict[str, Rotation], F64]:
    breath = np.sin(2 * turn)  # two breaths per loop
    sway = 0.012 * np.sin(turn)  # metres
    trans = np.stack([sway, 0.0012 * np.cos(2 * turn) - 0.0012, 0.004 * np.sin(turn + 1)], axis=1)
    lean = np.arctan2(sway, 0.9)  # legs of about 0.9 m keep the feet where they are
    joints = {
        "spine1": _about("z", 0.4 * lean),
        "spine2": _about("x", 0.008 * breath + 0.01),
        "spine3": _about("x", 0.012 * breath),
        "neck": _about("x", 0.03 - 0.01 * breath) * _about("y", 0.05 * np.sin(turn + 0.6)),
        "head": _about("y", 0.09 * np.sin(turn + 0.3)) * _about("x", 0.02 * np.sin(2 * turn + 1)),
    }
    for side, sign in _SIDES:
        joints[f"{side}_hip"] = _about("z", -lean + 0.03 * sign)
        joints[f"{side}_ankle"] = _about("z", lean - 0.03 * sign)
        joints[f"{side}_collar"] = _about("z", sign * (-0.08 + 0.012 * breath))
        swing = 0.05 + 0.012 * np.sin(turn + sign)
        joints[f"{side}_shoulder"] = _about("x", swing) * _about("z", sign * (-1.22 - 0.008 * breath))
        joints[f"{side}_elbow"] = _about("y", -sign * (0.28 + 0.02 * np.sin(turn + 2 * sign)))
    return joints, trans


def _curve(knots: tuple[tuple[float, float], ...], phase: F64) -> F64:
    """Return the radians of a periodic curve through (phase, degrees) knots."""
    at, angle = np.array([*knots, (1.0, knots[0][1])]).T
    return np.radians(CubicSpline(at, angle, bc_type="periodic")(phase % 1.0))


def _walk(skeleton: Skeleton, cycle: float = 1.1) -> Motion:
    frames = round(cycle * FPS)
    phase = np.arange(frames) / frames
    beat = 2 * np.pi * phase
    joints: dict[str, Rotation] = {
        "pelvis": _about("y", 0.09 * np.cos(beat)) * _about("z", 0.035 * np.sin(beat)) * _about("x", 0.05 + 0 * beat),
        "spine1": _about("y", -0.06 * np.cos(beat)) * _about("z", -0.02 * np.sin(beat)),
        "spine2": _about("y", -0.06 * np.cos(beat)) * _about("z", -0.015 * np.sin(beat)),
        "spine3": _about("y", -0.06 * np.cos(beat)) * _about("x", -0.02 + 0 * beat),
        "neck": _about("y", 0.04 * np.cos(beat)),
        "head": _about("y", 0.05 * np.cos(beat)) * _about("x", -0.02 + 0.015 * np.cos(2 * beat)),
    }
    for side, sign, offset in (("left", 1.0, 0.0), ("right", -1.0, 0.5)):
        p = phase + offset
        joints[f"{side}_hip"] = _about("x", -_curve(_HIP, p) - 0.05) * _about("z", 0.02 * sign + 0 * p)
        joints[f"{side}_knee"] = _about("x", _curve(_KNEE, p))
        joints[f"{side}_ankle"] = _about("x", -_curve(_ANKLE, p)) * _about("z", -0.02 * sign + 0 * p)
        lift = np.clip(np.sin(4 * np.pi * (p - 0.42)), 0, 1) * (np.abs((p % 1) - 0.545) < 0.125)
        joints[f"{side}_foot"] = _about("x", -0.35 * lift)  # toes stay down while the heel rises
        swing = -0.36 * np.cos(2 * np.pi * p + 0.25) + 0.06  # backwards with the leg of its own side in front
        joints[f"{side}_shoulder"] = _about("x", -swing) * _about("z", -1.31 * sign + 0 * p)
        joints[f"{side}_elbow"] = _about("y", -sign * (0.38 + 0.16 * (swing + 0.3)))
    motion = _motion(frames, _base(frames, joints), np.zeros((frames, 3)))
    return Motion(FPS, motion.rotations, _planted(motion, skeleton))


def _planted(motion: Motion, skeleton: Skeleton) -> F64:
    """Return translations [T, 3] that put the lower foot on the floor in each frame, smoothed over the loop."""
    feet = [_INDEX[f"{side}_{name}"] for side in ("left", "right") for name in ("ankle", "foot")]
    rest = skeleton.joints[feet, 1]
    height = np.array([(skeleton.forward(r)[feet, 1, 3] - rest).min() for r in motion.rotations])
    spectrum = np.fft.rfft(height)
    spectrum[5:] = 0
    trans = np.zeros((len(height), 3))
    trans[:, 1] = -np.fft.irfft(spectrum, len(height))
    return trans


def _wave_and_turn(seconds: float = 8.0) -> Motion:
    """Return a motion that waves with the right hand, then turns once around with small steps."""
    frames = round(seconds * FPS)
    time = np.arange(frames) / FPS
    joints, trans = _standing(2 * np.pi * np.arange(frames) / frames)
    joints = _base(frames, joints)
    up = _ease(time, 0.3, 1.0) * (1 - _ease(time, 3.0, 3.8))
    beat = np.sin(2 * np.pi * 1.9 * (time - 0.9)) * _ease(time, 0.8, 1.2) * (1 - _ease(time, 2.6, 3.1))
    blend = {
        "right_collar": _about("z", -0.14 + 0 * beat) * _about("x", -0.25 + 0 * beat),  # takes part of the twist
        "right_shoulder": _about("y", 0.3) * _about("z", 0.02 - 0.04 * beat) * _about("x", -0.85 + 0 * beat),
        "right_elbow": _about("y", 1.75 + 0.38 * beat),
        "right_wrist": _about("y", 0.12 * beat),
    }
    for finger in ("index", "middle", "ring", "pinky"):
        for i in (1, 2, 3):
            blend[f"right_{finger}{i}"] = _about("z", 0.05 + 0 * beat)
    for name, goal in blend.items():
        start = joints[name]
        path = (start.inv() * goal).as_rotvec()
        joints[name] = start * Rotation.from_rotvec(path * up[:, None])
    joints["head"] = joints["head"] * _about("z", 0.1 * up) * _about("x", -0.04 * up)
    joints["spine3"] = joints["spine3"] * _about("z", 0.05 * up)

    # the turn: eight steps, the feet lifted in turn
    part = np.clip((time - 4.0) / 3.6, 0, 1)
    angle = 2 * np.pi * _ease(time, 4.0, 7.6)
    moving = _ease(time, 3.9, 4.3) * (1 - _ease(time, 7.3, 7.7))
    joints["pelvis"] = _about("y", angle)
    for k, side in enumerate(("left", "right")):
        lift = np.clip(np.sin(2 * np.pi * 4 * part + k * np.pi), 0, None) ** 1.5 * moving
        joints[f"{side}_hip"] = _about("x", -0.34 * lift) * joints[f"{side}_hip"]
        joints[f"{side}_knee"] = _about("x", 0.62 * lift)
        joints[f"{side}_ankle"] = _about("x", -0.24 * lift) * joints[f"{side}_ankle"]
        swing = 0.1 * np.sin(2 * np.pi * 4 * part + k * np.pi) * moving * (1 - up if side == "right" else 1)
        joints[f"{side}_shoulder"] = _about("x", swing) * joints[f"{side}_shoulder"]
    joints["head"] = joints["head"] * _about("y", 0.25 * moving)
    trans = np.stack([trans[:, 0] * (1 - moving), trans[:, 1], trans[:, 2] * (1 - moving)], axis=1)
    return _motion(frames, joints, trans)


def _ease(time: F64, start: float, end: float) -> F64:
    """Return 0 before ``start``, 1 after ``end``, and between them a curve with continuous second derivative."""
    x = np.clip((time - start) / (end - start), 0, 1)
    return x**3 * (x * (6 * x - 15) + 10)


if __name__ == "__main__":
    body = default_avatar().skeleton
    for name, motion in library(body).items():
        Path(__file__).parents[2].joinpath("glsplat", "data", f"{name}.json").write_text(to_json(motion, body))
