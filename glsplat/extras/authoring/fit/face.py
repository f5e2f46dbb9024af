"""The face: the head turned, and its features moved to where the face network sees them in the picture.

A table says which spot of the body's face each landmark marks. What the head's turn leaves of the distances is taken
for a difference between the faces: a smooth field in the head's own frontal plane, the likeliest one of a Gaussian
process whose left and right are nearly mirrored. So a half under hair follows the half that is seen.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist

from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.extras.authoring.compute.levenberg import least_squares
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.eyes import EYE_SIDES, eyeball
from glsplat.extras.authoring.fit.kinematics import column, fully_posed, projected
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.face import Face
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["FacePlaces", "face_places", "face_turn", "fit_face"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_TURNED = ("neck", "head")
_TURN_DOUBT: F64 = np.repeat([0.08, 0.12], 3)  # radians; people look ahead for a picture
_OTHERNESS = 0.010  # metres that features lie elsewhere than the body has them, one standard deviation
_SCALES = (1.0, 0.09), (0.5, 0.025)  # share of that, and over how many metres it is about the same
_ALIKE = 0.9  # correlation of the two halves of a face
_MIRRORED = -1.0, 1.0  # what a mirror makes of the field's x and y
_MOST, _MOST_ODD = 0.02, 0.05  # metres; nothing is moved farther; and of a face where the body's landmarks had none
_BACK, _FRONT = 0.0, 0.06  # metres of z in the zero pose: where the field has faded, and where it begins to
_SURE = 0.5  # presence of a face that is there
_TURN_SURE = 0.9  # of one that says where the person is turned
_STRANGE, _ODD = 0.02, 0.03  # metres; landmarks that lie farther off by the median are not of this head; the same
_OUTLIER = 2.0  # strays; a landmark that the field misses by this much counts half
_ROUNDS = 3  # landmarks weighed anew


@dataclass(frozen=True, eq=False)
class FacePlaces:
    """Where landmarks of the face network lie on the body: a triangle each, and a spot in it."""

    numbers: Indices  # [L] in the network's order
    faces: Indices  # [L] of the body's triangles
    weights: F64  # [L, 3] of the triangle's corners, rows sum to one
    strays: F64  # [L] metres, typical distance in the picture between the spot and where the network puts it

    def of(self, body: Body, values: F64) -> F64:
        """[L, ...] the vertices' ``values`` [V, ...] at the spots."""
        return np.asarray(np.einsum("lk,lk...->l...", self.weights, values[body.faces[self.faces]]))

    def points(self, body: Body, rest: F64) -> Points:
        """The spots as points of a body of a known shape, whose vertices rest at ``rest`` [V, 3]."""
        corners = body.faces[self.faces]
        joints = body.skin_joints[corners].reshape(len(corners), -1)
        weights = (self.weights[..., None] * body.skin_weights[corners]).reshape(len(corners), -1)
        shaped = np.zeros((len(corners), 3, BETAS))
        return Points(self.of(body, rest), shaped, joints, weights)


@lru_cache(maxsize=1)
def face_places() -> FacePlaces:
    """Return the embedded table (face_places.json), measured on people whose joints and skin are known."""
    text = (resources.files("glsplat.extras.authoring.fit") / "face_places.json").read_text(encoding="utf-8")
    rows = json.loads(text)["landmarks"]
    weights = np.array([row["weights"] for row in rows], np.float64)
    return FacePlaces(
        numbers=np.array([row["landmark"] for row in rows], np.intp),
        faces=np.array([row["face"] for row in rows], np.intp),
        weights=weights / weights.sum(axis=1, keepdims=True),
        strays=np.array([row["stray"] for row in rows], np.float64),
    )


def face_turn(body: Body, face: Face, focal: float, middle: float) -> float | None:
    """Degrees that a face has turned to the person's own left from facing the camera, None for one that is not sure.

    ``focal`` and ``middle`` are the focal length and the column of the optical axis, both in pixels. The turn is that
    of the affine picture of the places on the body's face that is nearest to the landmarks.
    """
    if face.presence < _TURN_SURE:
        return None
    table = face_places()
    spots, marks = table.of(body, body.vertices), face.points[table.numbers, :2]
    plane = np.linalg.lstsq(spots - spots.mean(axis=0), marks - marks.mean(axis=0), rcond=None)[0].T
    right, down = unit_vectors(plane, 1e-9)
    aside = np.arctan2(marks[:, 0].mean() - middle, focal)  # who looks at the camera from there has turned back by it
    return float(np.degrees(np.arctan2(right[2], -np.cross(right, down)[2]) - aside))


def fit_face(body: Body, fit: BodyFit, seen: FittedView, view: View, face: Face) -> tuple[F64, F64] | None:
    """The view's rotations [55, 3] with neck and head turned, and how far vertices move in the zero pose [V, 3] metres.

    Both such that the places meet the face's landmarks; None for a face that is not believed. The turn is the likeliest
    one when the field may be anything that it is likely to be. Eyeballs move as a whole, so that they stay round.
    """
    table = face_places()
    marks, points = face.points[table.numbers, :2], table.points(body, fit.rest)
    spots = table.of(body, body.vertices)
    likely = [_covariance(spots, spots, sign) for sign in _MIRRORED]
    rows = [JOINT_NAMES.index(name) for name in _TURNED]
    columns = [column(name, axis) for name in _TURNED for axis in range(3)]

    def turned(x: F64) -> F64:
        rotations = seen.rotations.copy()
        rotations[rows] = x.reshape(-1, 3)
        return rotations

    def left(x: F64, derive: bool) -> tuple[F64, F64]:
        """[L, 2] metres in the head's frontal plane from the spots to the landmarks, and [L, 2, 6] derivatives."""
        posed = fully_posed(body, fit.betas, seen.root, seen.pelvis, turned(x))
        where, moves = posed.derivatives(points) if derive else (posed.points(points), None)
        at, slopes = projected(where, view.focal, view.centre, None if moves is None else moves[..., columns])
        frame = posed.frames[JOINT_NAMES.index("head")]
        ratio, size = where[:, :2] / where[:, 2:], where[:, 2:, None] / view.focal
        plane = frame[:2, :2] - ratio[:, :, None] * frame[2:, :2]  # from the head's plane to the picture's
        return np.linalg.solve(plane, (marks - at)[..., None] * size)[..., 0], np.linalg.solve(plane, -slopes * size)

    x = seen.rotations[rows].ravel()
    noise = np.ones(len(spots))
    for _ in range(_ROUNDS):
        roots = [cholesky(each + np.diag((table.strays * noise) ** 2), lower=True) for each in likely]

        def equations(x: F64, derive: bool, roots: list[F64] = roots) -> tuple[F64, F64]:
            away, slopes = left(x, derive)
            both = [np.column_stack([away[:, k], slopes[:, k]]) for k in (0, 1)]
            whitened = np.concatenate(
                [solve_triangular(root, each, lower=True) for root, each in zip(roots, both, strict=True)]
            )
            residual = np.concatenate([whitened[:, 0], x / _TURN_DOUBT])
            return residual, np.concatenate([whitened[:, 1:], np.diag(1 / _TURN_DOUBT)]) if derive else whitened[:0, 1:]

        x = least_squares(equations, x, 6)
        away = left(x, False)[0]
        pulls = [_solved(root, away[:, k]) for k, root in enumerate(roots)]
        met = np.stack([each @ pull for each, pull in zip(likely, pulls, strict=True)], axis=1)
        noise = np.sqrt(1 + (np.linalg.norm(away - met, axis=1) / (_OUTLIER * table.strays)) ** 2)
    if face.presence < _SURE or np.median(np.linalg.norm(away, axis=1)) > (_ODD if face.displaced else _STRANGE):
        return None
    return turned(x), _field(body, spots, pulls, _MOST_ODD if face.displaced else _MOST)


def _field(body: Body, spots: F64, pulls: list[F64], most: float) -> F64:
    """[V, 3] metres: the field that ``pulls`` [L] at ``spots`` [L, 3] make of x and y, faded, and at most ``most``."""
    reach = _reach(body)
    near = np.flatnonzero(reach)
    moved = np.zeros_like(body.vertices)
    for k, sign in enumerate(_MIRRORED):
        moved[near, k] = _covariance(body.vertices[near], spots, sign) @ pulls[k]
    size = np.linalg.norm(moved, axis=1, keepdims=True)
    moved *= reach[:, None] * most * np.tanh(size / most) / np.maximum(size, 1e-9)
    for side in EYE_SIDES:
        ball = eyeball(body, side)
        in_sight = ball.vertices[body.vertices[ball.vertices, 2] > ball.centre[2]]
        moved[ball.vertices] = moved[in_sight].mean(axis=0)
    return moved


def _covariance(first: F64, second: F64, sign: float) -> F64:
    """[N, M] of the field's one component at points [N, 3] and [M, 3]; ``sign``: what a mirror makes of it."""
    both = np.zeros((len(first), len(second)))
    for factor, points in ((1.0, second), (sign * _ALIKE, second * (-1, 1, 1))):
        far = cdist(first, points)
        for share, scale in _SCALES:
            ratio = far * (np.sqrt(5) / scale)
            both += factor * share**2 * (1 + ratio + ratio**2 / 3) * np.exp(-ratio)  # Matern's, twice smooth
    return _OTHERNESS**2 * both


def _solved(root: F64, right: F64) -> F64:
    """x with root root^T x = right."""
    return np.asarray(solve_triangular(root, solve_triangular(root, right, lower=True), lower=True, trans="T"))


def _reach(body: Body) -> F64:
    """[V] from 0 to 1: how much a vertex takes part; the neck and the back of the head do not."""
    names = ("head", "jaw", *(f"{side}_eye_smplhf" for side in EYE_SIDES))
    held = (body.skin_weights * np.isin(body.skin_joints, [JOINT_NAMES.index(name) for name in names])).sum(axis=1)
    share = ((body.vertices[:, 2] - _BACK) / (_FRONT - _BACK)).clip(0, 1)
    return np.asarray(held * share**2 * (3 - 2 * share))
