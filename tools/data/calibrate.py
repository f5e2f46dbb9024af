"""Where the networks put their landmarks on body, hands and face, measured on people whose joints or skin are known.

A landmark called "hip" is not the joint: it lies where the people who marked the network's pictures put it. Each is
given a point in its joint's frame, or a spot of the face, the same left and right; that is the one that explains the
landmarks of all pictures best, by medians, because the landmarks of a single person may be wrong.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.face import FacePlaces
from glsplat.extras.authoring.fit.hands import CARRIERS, HandPlaces
from glsplat.extras.authoring.fit.kinematics import projected
from glsplat.extras.authoring.fit.landmarks import LANDMARKS, Landmarks, twin
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = [
    "KnownFace",
    "KnownHand",
    "KnownPicture",
    "calibrate",
    "calibrate_face",
    "calibrate_hands",
    "write_face_table",
    "write_hand_table",
    "write_table",
]

F64 = NDArray[np.float64]

_MIRROR = np.array([-1.0, 1.0, 1.0])
_ROUNDS = 20
_DEPTH_DOUBT = 1e-3  # of the squares' mean: fronts say little of depth, and what they do not say stays zero
_HAND_DOUBT = 1e-2  # of that, for hands, which are turned more alike

_FACE = 0.72, 0.0  # metres of y and z in the zero pose, above and before which lies the face
_SEEN = 0.75  # of the people, on whom a landmark has to lie on the face
_MOST_STRAY = 0.003  # metres; landmarks that stray more are left out
_APART = 0.010  # metres; of landmarks closer together the best is enough
_CORNERS = 16  # spots tried along a triangle's side


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
        offset, stray = _middle(matrix, wanted, trust, _DEPTH_DOUBT)
        offsets[row], offsets[other] = offset, offset * (_MIRROR if other != row else 1.0)
        strays[row] = strays[other] = stray
    return Landmarks(np.array(list(numbers), np.intp), joints, offsets, strays)


@dataclass(frozen=True, eq=False)
class KnownHand:
    """A hand in a picture of a person whose pose is known; OpenCV camera axes."""

    joints: F64  # [55, 3] metres, in camera axes
    frames: F64  # [55, 3, 3] the joints' axes in the camera's
    landmarks: F64  # [21, 2] pixels, as the network gives them
    side: str  # left or right
    size: float  # metres, ``hand_size`` of the person
    focal: float  # pixels
    centre: F64  # [2] pixels
    weight: float = 1.0  # how much the picture counts


def calibrate_hands(hands: Sequence[KnownHand]) -> HandPlaces:
    """The offsets that explain the landmarks of all ``hands``, right ones mirrored, with the least sum of distances."""
    offsets, strays = np.zeros((len(CARRIERS), 3)), np.zeros(len(CARRIERS))
    trust = np.array([hand.weight for hand in hands])
    for number, name in enumerate(CARRIERS):
        pieces = []
        for hand in hands:
            joint = JOINT_NAMES.index(f"{hand.side}_{name}")
            mirror = np.ones(3) if hand.side == "left" else _MIRROR
            seen = (hand.landmarks[number] - hand.centre) / hand.focal
            pieces.append(_equation(hand.joints[joint], hand.frames[joint] * mirror, seen, hand.size))
        matrix, wanted = np.stack([a for a, _ in pieces]), np.stack([b for _, b in pieces])
        offsets[number], strays[number] = _middle(matrix, wanted, trust, _HAND_DOUBT)
    return HandPlaces(offsets, strays)


@dataclass(frozen=True, eq=False)
class KnownFace:
    """A face whose skin is known, in a picture; OpenCV camera axes."""

    vertices: F64  # [V, 3] metres, the open body's vertices in camera axes; NaN where one is not known
    landmarks: F64  # [468, 2] pixels, as the network gives them
    focal: float  # pixels
    centre: F64  # [2] pixels


def calibrate_face(body: Body, people: Sequence[KnownFace]) -> FacePlaces:
    """Where the landmarks lie on the body's face, by the median over all ``people`` and their mirror pictures.

    Landmarks that many people's hair hides or that stray far are left out, and such as lie close to a better one.
    """
    front = body.skin & (body.vertices[:, 1] > _FACE[0]) & (body.vertices[:, 2] > _FACE[1])
    triangles = np.flatnonzero(front[body.faces].all(axis=1))
    found = np.stack([_spots(body, triangles, person) for person in people])  # [P, 468, 3] in the zero pose and shape
    often = np.flatnonzero(np.isfinite(found[..., 0]).mean(axis=0) >= _SEEN)
    found = found[:, often]
    middle = np.nanmedian(found, axis=0)
    apart = cdist(middle, middle * _MIRROR)
    twins = linear_sum_assignment(apart + apart.T)[1]
    found = np.concatenate([found, found[:, twins] * _MIRROR])
    middle = np.nanmedian(found, axis=0)
    strays = np.nanmedian(np.linalg.norm((found - middle)[..., :2], axis=-1), axis=0)
    kept: list[int] = []
    for row in np.argsort(strays, kind="stable"):
        far = np.linalg.norm(middle[kept] - middle[row], axis=1)
        if strays[row] <= _MOST_STRAY and (far > _APART).all():
            kept.append(int(row))
    kept.sort()
    faces, weights = _on_surface(body, triangles, middle[kept])
    return FacePlaces(often[kept], faces, weights, strays[kept])


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
    _write(path, head, rows)


def write_hand_table(table: HandPlaces, path: Path, made_from: str) -> None:
    """Save as the JSON that hands.py reads; ``made_from`` says which pictures it was measured on."""
    rows = [
        {"landmark": number, "offset": [round(float(v), 4) for v in offset], "stray": round(float(stray), 4)}
        for number, (offset, stray) in enumerate(zip(table.offsets, table.strays, strict=True))
    ]
    head = {
        "what": "offset from the joint in the left hand's rest frame (x along the arm, y up, z to the front) and "
        "median distance in the picture, in shares of wrist to middle knuckle",
        "made_from": made_from,
    }
    _write(path, head, rows)


def write_face_table(table: FacePlaces, path: Path, made_from: str) -> None:
    """Save as the JSON that face.py reads; ``made_from`` says which pictures it was measured on."""
    rows = [
        {
            "landmark": int(number),
            "face": int(face),
            "weights": [round(float(w), 3) for w in weights],
            "stray": round(float(stray), 5),
        }
        for number, face, weights, stray in zip(table.numbers, table.faces, table.weights, table.strays, strict=True)
    ]
    head = {
        "what": "triangle of the open body and weights of its corners, and median distance in the picture in metres",
        "made_from": made_from,
    }
    _write(path, head, rows)


def _write(path: Path, head: dict[str, str], rows: Sequence[dict[str, object]]) -> None:
    lines = ",\n".join(f"    {json.dumps(row)}" for row in rows)
    text = json.dumps(head, indent=2)[:-2] + f',\n  "landmarks": [\n{lines}\n  ]\n}}\n'
    path.write_text(text, encoding="utf-8")


def _equations(picture: KnownPicture, number: int, joint: np.intp, mirror: F64) -> tuple[F64, F64]:
    """[2, 3] and [2]: matrix @ offset is where the landmark should be from the joint, in shares of the stature."""
    seen = (picture.landmarks[number] - picture.centre) / picture.focal
    return _equation(picture.joints[joint], picture.frames[joint] * mirror, seen, picture.stature)


def _equation(where: F64, frame: F64, seen: F64, size: float) -> tuple[F64, F64]:
    """[2, 3] and [2], as of _equations: a joint [3] and its ``frame`` [3, 3], x/z and y/z [2] of a landmark."""
    ratio = where[:2] / where[2]
    return frame[:2] - np.outer(ratio, frame[2]), (seen - ratio) * where[2] / size


def _middle(matrix: F64, wanted: F64, trust: F64, doubt: float) -> tuple[F64, float]:
    """The offset [3] with the least trusted sum of distances of matrix [N, 2, 3] @ offset from ``wanted`` [N, 2].

    And the median distance. ``doubt`` keeps what no picture shows at zero.
    """
    weights, offset, far = trust, np.zeros(3), np.zeros(len(wanted))
    for _ in range(_ROUNDS):
        normal = np.einsum("n,nij,nik->jk", weights, matrix, matrix)
        right = np.einsum("n,nij,ni->j", weights, matrix, wanted)
        offset = np.linalg.solve(normal + doubt * weights.sum() * np.eye(3), right)
        far = np.linalg.norm(matrix @ offset - wanted, axis=1)
        weights = trust / np.maximum(far, 1e-3)
    return offset, float(np.median(far))


def _spots(body: Body, triangles: NDArray[np.intp], person: KnownFace) -> F64:
    """[468, 3] where the landmarks lie on the body's own face in the zero pose; NaN beside the known skin."""
    known = triangles[np.isfinite(person.vertices[body.faces[triangles]]).all(axis=(1, 2))]
    corners = body.faces[known]
    pixels = projected(person.vertices, person.focal, person.centre)[0]
    (ax, ay), (bx, by), (cx, cy) = (pixels[corners[:, k]].T for k in range(3))
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    depth = person.vertices[corners, 2].mean(axis=1)
    spots = np.full((len(person.landmarks), 3), np.nan)
    for number, (x, y) in enumerate(person.landmarks):
        second = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
        third = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
        hit = np.flatnonzero((second >= 0) & (third >= 0) & (second + third <= 1) & (area < 0))
        if len(hit):
            near = hit[depth[hit].argmin()]
            weights = np.array([1 - second[near] - third[near], second[near], third[near]])
            spots[number] = weights @ body.vertices[corners[near]]
    return spots


def _on_surface(body: Body, triangles: NDArray[np.intp], points: F64) -> tuple[NDArray[np.intp], F64]:
    """[L] triangles and [L, 3] weights of their corners, nearest to ``points`` [L, 3] on a fine grid."""
    steps = np.arange(_CORNERS + 1) / _CORNERS
    grid = np.array([(1 - a - b, a, b) for a in steps for b in steps if a + b <= 1])
    corners = body.vertices[body.faces[triangles]]
    faces, weights = np.zeros(len(points), np.intp), np.zeros((len(points), 3))
    for row, point in enumerate(points):
        close = np.argsort(np.linalg.norm(corners.mean(axis=1) - point, axis=1), kind="stable")[:24]
        far = np.linalg.norm(np.einsum("gk,fkc->fgc", grid, corners[close]) - point, axis=2)
        face, spot = np.unravel_index(int(far.argmin()), far.shape)
        faces[row], weights[row] = triangles[close[face]], grid[spot]
    return faces, weights
