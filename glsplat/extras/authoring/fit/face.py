"""Turn the head and move the face's features to the face network's landmarks.

A table has the point of the body's face for each landmark. Distances that remain after the head's turn are explained
by a smooth field of offsets in the head's frontal plane: the most likely one of a Gaussian process that is nearly
symmetric. A half under hair therefore follows the visible half.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.extras.authoring.compute.solvers import least_squares
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.eyes import EYE_SIDES, eyeball
from glsplat.extras.authoring.fit.kinematics import derivative_column, fully_posed, projected
from glsplat.extras.authoring.fit.landmarks import read_table
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.face import Face
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

Indices = NDArray[np.intp]

_TURNED_JOINTS = ("neck", "head")
_TURN_SD_RAD: F64 = np.repeat([0.08, 0.12], 3)  # people look ahead for a picture
_FIELD_SD_M = 0.010  # offsets of features from the body's
_FIELD_SCALES = (1.0, 0.09), (0.5, 0.025)  # fraction of the standard deviation, and correlation length in metres
_SYMMETRY = 0.9  # correlation of the two halves of a face
_MIRROR_SIGNS = -1.0, 1.0  # of the field's x and y
_MAX_OFFSET_M, _MAX_DISPLACED_OFFSET_M = 0.02, 0.05  # the second for a face beside the body's landmarks
_FADE_END_Z_M, _FADE_START_Z_M = 0.0, 0.06  # in the zero pose; the field fades towards the back
_MIN_PRESENCE = 0.5  # of the face
_MIN_TURN_PRESENCE = 0.9  # of a face whose turn is used
_MAX_MEDIAN_M, _MAX_DISPLACED_MEDIAN_M = 0.02, 0.03  # between landmarks and head; the second for a displaced face
_OUTLIER_FACTOR = 2.0  # typical errors at which a landmark has half the weight
_WEIGHT_ROUNDS = 3  # updates of the landmarks' weights


@dataclass(frozen=True, eq=False)
class FacePlaces:
    """Points on the body for landmarks of the face network: a triangle and barycentric weights for each."""

    numbers: Indices  # [L] in the network's order
    faces: Indices  # [L] triangles of the body
    weights: F64  # [L, 3] of the triangle's corners, rows sum to one
    errors: F64  # [L] metres, typical distance in the picture between the point and the network's landmark

    def of(self, body: Body, values: F64) -> F64:
        """Return the vertices' ``values`` [V, ...] at the points, [L, ...]."""
        return np.asarray(np.einsum("lk,lk...->l...", self.weights, values[body.faces[self.faces]]))

    def points(self, body: Body, rest: F64) -> Points:
        """Return the points on a body of a known shape with vertices ``rest`` [V, 3] in the zero pose."""
        corners = body.faces[self.faces]
        joints = body.skin_joints[corners].reshape(len(corners), -1)
        weights = (self.weights[..., None] * body.skin_weights[corners]).reshape(len(corners), -1)
        shaped = np.zeros((len(corners), 3, BETAS))
        return Points(self.of(body, rest), shaped, joints, weights)


@lru_cache(maxsize=1)
def face_places() -> FacePlaces:
    """Return the embedded table (face_places.json), measured on people whose joints and skin are known."""
    rows = read_table("face_places.json")
    weights = np.array([row["weights"] for row in rows], np.float64)
    return FacePlaces(
        numbers=np.array([row["landmark"] for row in rows], np.intp),
        faces=np.array([row["face"] for row in rows], np.intp),
        weights=weights / weights.sum(axis=1, keepdims=True),
        errors=np.array([row["stray"] for row in rows], np.float64),
    )


def face_turn(body: Body, face: Face, focal: float, middle: float) -> float | None:
    """Return the turn of a face in degrees from facing the camera to the person's own left, or None if it is unsure.

    ``focal`` and ``middle`` are the focal length and the column of the optical axis, both in pixels. The turn is that
    of the affine projection of the body's face that fits the landmarks best.
    """
    if face.presence < _MIN_TURN_PRESENCE:
        return None
    table = face_places()
    spots, marks = table.of(body, body.vertices), face.points[table.numbers, :2]
    plane = np.linalg.lstsq(spots - spots.mean(axis=0), marks - marks.mean(axis=0), rcond=None)[0].T
    right, down = unit_vectors(plane, 1e-9)
    bearing = np.arctan2(marks[:, 0].mean() - middle, focal)  # facing the camera from there is a turn by this angle
    return float(np.degrees(np.arctan2(right[2], -np.cross(right, down)[2]) - bearing))


def fit_face(body: Body, fit: BodyFit, fitted: FittedView, view: View, face: Face) -> tuple[F64, F64] | None:
    """Return the view's rotations [55, 3] with neck and head turned, and offsets [V, 3] in metres in the zero pose.

    Both move the body's face to the landmarks; None if the face is not credible. The turn is the most likely one over
    all fields of offsets. Eyeballs move as a whole, to stay round.
    """
    table = face_places()
    marks, points = face.points[table.numbers, :2], table.points(body, fit.rest)
    spots = table.of(body, body.vertices)
    covariances = [_covariance(spots, spots, sign) for sign in _MIRROR_SIGNS]
    rows = [JOINT_NAMES.index(name) for name in _TURNED_JOINTS]
    columns = [derivative_column(name, axis) for name in _TURNED_JOINTS for axis in range(3)]

    def turned(x: F64) -> F64:
        rotations = fitted.rotations.copy()
        rotations[rows] = x.reshape(-1, 3)
        return rotations

    def residuals(x: F64, derive: bool) -> tuple[F64, F64]:
        """Return metres [L, 2] in the head's frontal plane from points to landmarks, and derivatives [L, 2, 6]."""
        posed = fully_posed(body, fit.betas, fitted.root, fitted.pelvis, turned(x))
        where, moves = posed.derivatives(points) if derive else (posed.points(points), None)
        at, slopes = projected(where, view.focal, view.centre, None if moves is None else moves[..., columns])
        frame = posed.frames[JOINT_NAMES.index("head")]
        ratio, size = where[:, :2] / where[:, 2:], where[:, 2:, None] / view.focal
        plane = frame[:2, :2] - ratio[:, :, None] * frame[2:, :2]  # from the head's plane to the picture's
        return np.linalg.solve(plane, (marks - at)[..., None] * size)[..., 0], np.linalg.solve(plane, -slopes * size)

    x = fitted.rotations[rows].ravel()
    noise = np.ones(len(spots))
    for _ in range(_WEIGHT_ROUNDS):
        roots = [cholesky(each + np.diag((table.errors * noise) ** 2), lower=True) for each in covariances]

        def equations(x: F64, derive: bool, roots: list[F64] = roots) -> tuple[F64, F64]:
            away, slopes = residuals(x, derive)
            both = [np.column_stack([away[:, k], slopes[:, k]]) for k in (0, 1)]
            whitened = np.concatenate(
                [solve_triangular(root, each, lower=True) for root, each in zip(roots, both, strict=True)]
            )
            residual = np.concatenate([whitened[:, 0], x / _TURN_SD_RAD])
            if not derive:
                return residual, np.zeros((0, 0))
            return residual, np.concatenate([whitened[:, 1:], np.diag(1 / _TURN_SD_RAD)])

        x = least_squares(equations, x, 6)
        away = residuals(x, False)[0]
        pulls = [_cholesky_solve(root, away[:, k]) for k, root in enumerate(roots)]
        met = np.stack([each @ pull for each, pull in zip(covariances, pulls, strict=True)], axis=1)
        noise = np.sqrt(1 + (np.linalg.norm(away - met, axis=1) / (_OUTLIER_FACTOR * table.errors)) ** 2)
    limit = _MAX_DISPLACED_MEDIAN_M if face.displaced else _MAX_MEDIAN_M
    if face.presence < _MIN_PRESENCE or np.median(np.linalg.norm(away, axis=1)) > limit:
        return None
    return turned(x), _field(body, spots, pulls, _MAX_DISPLACED_OFFSET_M if face.displaced else _MAX_OFFSET_M)


def _field(body: Body, spots: F64, pulls: list[F64], most: float) -> F64:
    """Return offsets [V, 3] in metres from ``pulls`` [L] (x, y) at ``spots`` [L, 3], faded and limited to ``most``."""
    reach = _face_weights(body)
    near = np.flatnonzero(reach)
    moved = np.zeros_like(body.vertices)
    for k, sign in enumerate(_MIRROR_SIGNS):
        moved[near, k] = _covariance(body.vertices[near], spots, sign) @ pulls[k]
    size = np.linalg.norm(moved, axis=1, keepdims=True)
    moved *= reach[:, None] * most * np.tanh(size / most) / np.maximum(size, 1e-9)
    for side in EYE_SIDES:
        ball = eyeball(body, side)
        front = ball.vertices[body.vertices[ball.vertices, 2] > ball.centre[2]]
        moved[ball.vertices] = moved[front].mean(axis=0)
    return moved


def _covariance(first: F64, second: F64, sign: float) -> F64:
    """Return the covariance [N, M] of a component of the field at points [N, 3] and [M, 3]; ``sign`` of its mirror."""
    both = np.zeros((len(first), len(second)))
    for factor, points in ((1.0, second), (sign * _SYMMETRY, second * (-1, 1, 1))):
        far = cdist(first, points)
        for share, scale in _FIELD_SCALES:
            ratio = far * (np.sqrt(5) / scale)
            both += factor * share**2 * (1 + ratio + ratio**2 / 3) * np.exp(-ratio)  # Matern kernel, nu = 5/2
    return _FIELD_SD_M**2 * both


def _cholesky_solve(root: F64, right: F64) -> F64:
    """Return x with root root^T x = right."""
    return np.asarray(solve_triangular(root, solve_triangular(root, right, lower=True), lower=True, trans="T"))


def _face_weights(body: Body) -> F64:
    """Return weights [V] of the field, 1 in the face to 0 on the neck and the back of the head."""
    names = ("head", "jaw", *(f"{side}_eye_smplhf" for side in EYE_SIDES))
    weights = (body.skin_weights * np.isin(body.skin_joints, [JOINT_NAMES.index(name) for name in names])).sum(axis=1)
    share = ((body.vertices[:, 2] - _FADE_END_Z_M) / (_FADE_START_Z_M - _FADE_END_Z_M)).clip(0, 1)
    return np.asarray(weights * share**2 * (3 - 2 * share))
