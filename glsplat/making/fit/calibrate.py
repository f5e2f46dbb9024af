"""Where a pose network puts its landmarks on the body, measured on people whose joints are known.

A landmark called "hip" is not the joint: it lies where the people who marked the network's pictures put it. Each is
given a point in its joint's frame, the same left and right; the point is the one that explains the landmarks of all
pictures best, by medians, because the landmarks of a single person may be wrong.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.making.fit.landmarks import LANDMARKS, Landmarks, twin
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["KnownPicture", "calibrate", "write_table"]

F64 = NDArray[np.float64]

_MIRROR = np.array([-1.0, 1.0, 1.0])
_ROUNDS = 20
_DEPTH_DOUBT = 1e-3  # of the squares' mean: fronts say little of depth, and what they do not say stays zero


@dataclass(frozen=True, eq=False)
class KnownPicture:
    """A picture of a person whose pose is known; OpenCV camera axes."""

    joints: F64  # [55, 3] metres, in camera axes
    frames: F64  # [55, 3, 3] the joints' axes in the camera's
    landmarks: F64  # [33, 2] pixels, as the network gives them
    focal: float  # pixels
    centre: F64  # [2] pixels
    stature: float  # metres
    weight: float = 1.0  # how much the picture counts


def calibrate(pictures: Sequence[KnownPicture]) -> Landmarks:
    """The offsets that explain the landmarks of all ``pictures`` with the least sum of distances (not squared)."""
    numbers = {number: row for row, (number, _) in enumerate(LANDMARKS)}
    joints = np.array([JOINT_NAMES.index(name) for _, name in LANDMARKS], np.intp)
    offsets, strays = np.zeros((len(LANDMARKS), 3)), np.zeros(len(LANDMARKS))
    for number, row in numbers.items():
        other = numbers[twin(number)]
        if other < row:
            continue
        pieces = [_equations(picture, LANDMARKS[row][0], joints[row], np.ones(3)) for picture in pictures]
        if other != row:
            pieces += [_equations(picture, LANDMARKS[other][0], joints[other], _MIRROR) for picture in pictures]
        matrix, wanted = np.stack([a for a, _ in pieces]), np.stack([b for _, b in pieces])  # [N, 2, 3], [N, 2]
        if other == row:
            matrix[..., 0] = 0.0  # on the middle plane
        trust = np.tile([picture.weight for picture in pictures], 1 if other == row else 2)
        weights = trust
        offset = np.zeros(3)
        for _ in range(_ROUNDS):
            normal = np.einsum("n,nij,nik->jk", weights, matrix, matrix)
            right = np.einsum("n,nij,ni->j", weights, matrix, wanted)
            offset = np.linalg.solve(normal + _DEPTH_DOUBT * weights.sum() * np.eye(3), right)
            far = np.linalg.norm(matrix @ offset - wanted, axis=1)
            weights = trust / np.maximum(far, 1e-3)
        offsets[row], offsets[other] = offset, offset * (_MIRROR if other != row else 1.0)
        strays[row] = strays[other] = np.median(far)
    return Landmarks(np.array(list(numbers), np.intp), joints, offsets, strays)


def write_table(table: Landmarks, path: Path, made_from: str) -> None:
    """Save as the JSON that landmarks.py reads; ``made_from`` says which pictures it was measured on."""
    rows = [
        {
            "landmark": int(number),
            "joint": JOINT_NAMES[joint],
            "offset": [round(float(v), 4) for v in offset],
            "stray": round(float(stray), 4),
        }
        for number, joint, offset, stray in zip(table.numbers, table.joints, table.offsets, table.strays, strict=True)
    ]
    head = {
        "what": "offset from the joint in its rest frame (x the person's left, y up, z to the front) and median "
        "distance in the picture, in shares of the stature",
        "made_from": made_from,
    }
    lines = ",\n".join(f"    {json.dumps(row)}" for row in rows)
    text = json.dumps(head, indent=2)[:-2] + f',\n  "landmarks": [\n{lines}\n  ]\n}}\n'
    path.write_text(text, encoding="utf-8")


def _equations(picture: KnownPicture, number: int, joint: np.intp, mirror: F64) -> tuple[F64, F64]:
    """[2, 3] and [2]: matrix @ offset is where the landmark should be from the joint, in shares of the stature."""
    where = picture.joints[joint]
    ratio = where[:2] / where[2]
    frame = picture.frames[joint] * mirror
    matrix = frame[:2] - np.outer(ratio, frame[2])
    seen = (picture.landmarks[number] - picture.centre) / picture.focal
    return matrix, (seen - ratio) * where[2] / picture.stature
