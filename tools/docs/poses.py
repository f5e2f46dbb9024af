"""Everyday poses, solved for each body so that no hand is inside it."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import Capture

_SIDES = {"left": 1.0, "right": -1.0}
_ARM = ("collar", "shoulder", "elbow", "wrist", "index", "middle", "pinky", "ring", "thumb")

# place of the wrist: across (in half widths of the hips, towards the arm's side), up (0: hips, 1: shoulders), metres
# before (negative: behind) the body's surface; then the elbow's direction
_Reach = tuple[float, float, float, tuple[float, float, float]]
_HIP: _Reach = (1.30, 0.13, 0.0, (1.0, 0.0, -0.35))
_POCKET: _Reach = (1.0, -0.12, 0.045, (0.7, 0.0, -0.8))
POSES: dict[str, tuple[dict[str, _Reach], float]] = {
    "arms at 3 degrees": ({}, 0.0),
    "crossed": ({"left": (-0.55, 0.52, 0.10, (0.8, -0.5, 0.1)), "right": (-0.55, 0.42, 0.05, (0.8, -0.5, 0.1))}, 0.0),
    "hands on hips": ({"left": _HIP, "right": _HIP}, 0.0),
    "hands at the pockets": ({"left": _POCKET, "right": _POCKET}, 0.0),
    "a hand on the belly": ({"left": (0.1, 0.25, 0.05, (1.0, -0.3, -0.2))}, 0.0),
    "a hand behind the back": ({"right": (0.2, 0.15, -0.06, (1.0, 0.0, -0.6))}, 0.0),
    "turned by 30": ({}, 30.0),
    "turned by 45, a hand on the belly": ({"right": (0.1, 0.25, 0.05, (1.0, -0.3, -0.2))}, -45.0),
}
"""Reach of arms by side, and degrees that the person has turned to their own left, by name. Other arms hang."""

_HANGING = 3.0  # degrees from vertical
_BESIDE = 0.045  # metres between a hanging wrist and the hips


def standing(person: Capture, name: str) -> Pose:
    """Return the pose ``name`` of POSES for a person's body."""
    reaches, turn = POSES[name]
    skeleton = person.mesh.skeleton
    rotations = np.zeros_like(person.pose)
    rest = skeleton.forward(rotations)[:, :3, 3]
    surface = _trunk(person)

    def at(joint: str) -> int:
        return skeleton.names.index(joint)

    for side, out in _SIDES.items():
        numbers = [at(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist")]
        shoulder, elbow, wrist = rest[numbers]
        length = np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)
        hips, middle = rest[at(f"{side}_hip")], rest[at("pelvis")]
        if side in reaches:
            across, up, before, looks = reaches[side]
            half = abs(surface[abs(surface[:, 1] - middle[1]) < 0.04, 0]).max()
            y = middle[1] + up * (shoulder[1] - middle[1])
            x = out * across * half
            near = surface[(abs(surface[:, 0] - x) < 0.06) & (abs(surface[:, 1] - y) < 0.08), 2]
            depth = hips[2] if not len(near) or before == 0 else (near.max() if before > 0 else near.min()) + before
            goal, hint = np.array([x, y, depth]), np.array(looks) * (out, 1, 1)
        else:
            low = shoulder[1] - 0.99 * length
            beside = abs(surface[abs(surface[:, 1] - low - 0.05) < 0.15, 0]).max() + _BESIDE
            x = max(abs(shoulder[0]) + length * np.sin(np.radians(_HANGING)), beside)
            goal, hint = np.array([out * x, low, shoulder[2] + 0.02]), np.array([0.5 * out, 0.0, -1.0])
        rotations[numbers[:2]] = _reaching(person, numbers, goal, hint, out)
    rotations[0] = (0.0, np.radians(turn), 0.0)
    return Pose(rotations, person.trans)


def _trunk(person: Capture) -> np.ndarray:
    """Return the dressed surface [N, 3] in the zero pose, without arms and head."""
    mesh = person.mesh
    owner = np.take_along_axis(mesh.joints, mesh.weights.argmax(axis=1)[:, None], 1)[:, 0]
    arms = np.array([any(part in name for part in (*_ARM, "neck", "head")) for name in mesh.skeleton.names])
    return mesh.posed(Pose(np.zeros_like(person.pose), np.zeros(3)))[~arms[owner]]


def _reaching(person: Capture, numbers: list[int], goal: np.ndarray, hint: np.ndarray, out: float) -> np.ndarray:
    """Return rotations [2, 3] of shoulder and elbow that bring the wrist to ``goal``, the elbow towards ``hint``."""
    skeleton, hint = person.mesh.skeleton, hint / np.linalg.norm(hint)

    def away(x: np.ndarray) -> np.ndarray:
        rotations = np.zeros_like(person.pose)
        rotations[numbers[0]], rotations[numbers[1], 1] = x[:3], x[3]
        shoulder, elbow, wrist = skeleton.forward(rotations)[numbers, :3, 3]
        bend = elbow - (shoulder + wrist) / 2
        return np.concatenate([(wrist - goal) * 100, 0.3 * (bend - (bend @ bend) ** 0.5 * hint) * 30, 0.1 * x[:3]])

    start = np.array([0.0, 0.0, -1.2 * out, -0.6 * out])
    limits = np.array([2.5, 2.5, 2.5, 2.6])
    low, high = -limits, limits.copy()
    low[3], high[3] = (-2.6, 0.0) if out > 0 else (0.0, 2.6)
    x = least_squares(away, start, bounds=(low, high), max_nfev=60).x
    return np.array([x[:3], [0.0, x[3], 0.0]])
