"""The unknowns and equations of a fit over all views: landmarks, outlines and priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.extras.authoring.compute.solvers import least_squares
from glsplat.extras.authoring.fit import prior
from glsplat.extras.authoring.fit.kinematics import PLACE, PosedBody, projected
from glsplat.extras.authoring.fit.landmarks import Landmarks
from glsplat.extras.authoring.fit.outline import Rim
from glsplat.extras.authoring.fit.view import View

_POSE_CHANGE_SD_RAD = 0.06  # between two pictures of one session
_OUTLIER_FACTOR = 3.0  # typical errors at which a landmark has a quarter of the weight
_MIN_VISIBILITY = 0.1  # hidden landmarks keep a little weight
_FRONT_ERROR_FACTOR, _BACK_ERROR_FACTOR, _SIDE_ERROR_FACTOR = 1.0, 1.5, 3.0  # of the errors measured on fronts
_HEIGHT_SD_M = 0.01  # of the height that people give
_MIN_SIDED_COSINE = 0.8  # of the turn of a front or a back, where left and right are known
_KNOWN_SHAPE_SD = 1e-3
_DEPTH_SD_M, _DEPTH_WEIGHT = 0.01, 12.0  # of forearms behind the trunk; the weight in measurements
_ARM_ANGLES = np.array([any(part in name for part in ("shoulder", "elbow")) for name, _ in prior.HINGES.names], float)
_BONE_SD = np.array([1.0, 1.0, 0.4])  # of unit vectors; landmarks determine x and y better
_CAMERA_CHANGE_SD_FRACTION = 0.01  # of the stature, for the height of a fixed camera


@dataclass(frozen=True, slots=True, eq=False)
class KnownShape:
    """Results of a fit to other pictures of the same recording."""

    betas: F64  # [BETAS] the shape
    angles: F64  # [D] approximate pose, radians
    camera_height: float  # above the soles, in fractions of the stature


class BodySolver:
    """Solve for one vector: the shape [BETAS], then place and pose [6 + D] of each view.

    ``height`` is the stature in metres, if given; ``known`` is the result of an earlier fit; ``stance`` is the prior
    of the pose without one. Residuals are in standard deviations.
    """

    def __init__(
        self,
        body: Body,
        table: Landmarks,
        views: Sequence[View],
        height: float | None,
        known: KnownShape | None = None,
        stance: prior.PosePrior = prior.POSED,
    ) -> None:
        self.body, self.table, self.views = body, table, tuple(views)
        self._height, self._known, self._stance = height, known, stance
        self._marks = table.points(body)
        self._ends = body.points_of_joints([name for bone in prior.ARM_BONES for name in bone])
        self._block = PLACE + len(prior.MEAN)
        self._rims: list[tuple[Rim, Points, F64] | None] = [None] * len(views)
        self._in_front: list[tuple[Points, F64] | None] = [None] * len(views)
        self._trust = [np.ones(len(table.numbers)) for _ in views]
        self.x: F64 = self._start()
        self._poses = [self._stance.near(self.angles(index)) for index in range(len(views))]
        self._targets = [self._landmarks_by_side(index) for index in range(len(views))]

    @property
    def sleeve(self) -> float:
        """Scale of an arm's distance from its outline, as a fraction of the person's height."""
        return self._stance.sleeve

    @property
    def betas(self) -> F64:
        """[BETAS] the shape."""
        return self.x[:BETAS]

    def posed(self, view: int, x: F64 | None = None) -> PosedBody:
        """Return the body in a view."""
        x = self.x if x is None else x
        block = x[BETAS + view * self._block :][: self._block]
        return PosedBody(self.body, prior.HINGES, self.views[view].facing, x[:BETAS], block[:PLACE], block[PLACE:])

    def angles(self, view: int, x: F64 | None = None) -> F64:
        """Return the fitted angles [D] of a view, radians."""
        return (self.x if x is None else x)[BETAS + view * self._block + PLACE :][: len(prior.MEAN)]

    def camera_height(self, view: int) -> float:
        """Return the height of a view's camera above the soles, in fractions of the stature."""
        posed = self.posed(view)
        size, grows = self.body.stature
        hips, rises = self.body.hip_height
        above = hips + rises @ self.betas - posed.frames[0][:, 1] @ posed.joints[0]
        return float(above / (size + grows @ self.betas))

    def weigh_landmarks(self) -> None:
        """Weigh landmarks down by their current errors, and choose the arms' nearest components of the prior."""
        for index in range(len(self.views)):
            self._poses[index] = self._stance.near(self.angles(index))
            far = np.linalg.norm(self.landmark_errors(index), axis=1)
            self._trust[index] = 1 / (1 + (far / _OUTLIER_FACTOR) ** 2)

    def landmark_errors(self, index: int, *, pixels: bool = False) -> F64:
        """Return the distances [L, 2] of the body's landmarks from the network's, in typical errors or in pixels."""
        view = self.views[index]
        at = projected(self.posed(index).points(self._marks), view.focal, view.centre)[0]
        away = at - self._targets[index]
        return away if pixels else away / (self.table.errors * view.figure * _error_factor(view))[:, None]

    def set_outline(self, view: int, rim: Rim, moved: F64 | None, weights: F64) -> None:
        """Pull the rim's vertices to the mask's edge along their normals in later solves.

        ``weights`` [K] scale pixels to standard deviations; ``moved`` [V, 3] metres is the surface's offset at rest.
        """
        self._rims[view] = rim, self.body.points(rim.vertices, moved), weights

    def keep_in_front(self, view: int, vertices: NDArray[np.intp], depths: F64) -> None:
        """Push the bare body's ``vertices`` [K] to ``depths`` [K] metres, if they are deeper, in later solves."""
        self._in_front[view] = (self.body.points(vertices), depths) if len(vertices) else None

    def solve(self, steps: int) -> None:
        """Improve all unknowns by at most so many ``steps``."""
        self.x = least_squares(self._rows, self.x, steps)

    def _start(self) -> F64:
        """Return a person of the given height in the stance's pose, at the hips' landmarks and as large as the mask."""
        x = np.zeros(BETAS + self._block * len(self.views))
        size, grows = self.body.stature
        height = prior.STATURE_M[0] if self._height is None else self._height
        x[0] = np.clip((height - size) / grows[0], -3, 3)
        if self._known is not None:
            x[:BETAS] = self._known.betas
            height = float(size + grows @ x[:BETAS])
        for index, view in enumerate(self.views):
            block = x[BETAS + index * self._block :][: self._block]
            depth = view.focal * height / view.figure
            hips = view.landmarks[[23, 24]].mean(axis=0)
            block[:2] = (hips - view.centre) * depth / view.focal
            block[2] = depth
            block[4] = self._stance.turn
            block[PLACE:] = self._stance.initial() if self._known is None else self._known.angles
        return x

    def _landmarks_by_side(self, index: int) -> F64:
        """Return the landmarks [L, 2], exchanged where the network took a front for a back or a back for a front.

        In fronts and backs the view's side determines which landmark of a pair is on the left.
        """
        view = self.views[index]
        marks = view.landmarks[self.table.numbers].copy()
        if abs(np.cos(np.radians(view.turn))) > _MIN_SIDED_COSINE:
            at = projected(self.posed(index).points(self._marks), view.focal, view.centre)[0]
            wrong = (at[:, 0] - at[self.table.mirror_rows, 0]) * (marks[:, 0] - marks[self.table.mirror_rows, 0]) < 0
            marks[wrong] = marks[self.table.mirror_rows[wrong]]
        return marks

    def _rows(self, x: F64, derive: bool) -> tuple[F64, F64]:
        """Return all residuals [R] and, if asked, their derivatives [R, P]."""
        parts: list[tuple[F64, F64, int | None, F64 | None]] = [(*self._shape_rows(x), None, None)]
        for index, view in enumerate(self.views):
            posed = self.posed(index, x)
            parts.append((*self._landmark_rows(index, view, posed, derive), index, None))
            parts.append((*self._pose_rows(index, x), index, None))
            if index:
                parts.append((*self._tie_rows(index, x), index, self._tie_slope()))
            parts.append((*self._camera_rows(index, posed, x), index, None))
            if self._stance.bones is not None and not index:
                parts.append((*self._bone_rows(posed, self._stance.bones, derive), index, None))
            if self._rims[index] is not None:
                parts.append((*self._rim_rows(index, view, posed, derive), index, None))
            if self._in_front[index] is not None:
                parts.append((*self._depth_rows(index, posed, derive), index, None))
        residual = np.concatenate([row for row, *_ in parts])
        if not derive:
            return residual, np.zeros((0, 0))
        jacobian = np.zeros((len(residual), len(x)))
        first = 0
        for row, moves, view_index, ties in parts:
            rows = slice(first, first + len(row))
            jacobian[rows, :BETAS] = moves[:, :BETAS]
            if view_index is not None:
                start = BETAS + view_index * self._block
                jacobian[rows, start : start + self._block] = moves[:, BETAS:]
                if ties is not None:
                    jacobian[rows, BETAS : BETAS + self._block] = ties
            first += len(row)
        return residual, jacobian

    def _shape_rows(self, x: F64) -> tuple[F64, F64]:
        """Return the equations of the shape's prior and the stature."""
        if self._known is not None:
            return (x[:BETAS] - self._known.betas) / _KNOWN_SHAPE_SD, np.eye(BETAS) / _KNOWN_SHAPE_SD
        size, grows = self.body.stature
        mean, sd = prior.STATURE_M if self._height is None else (self._height, _HEIGHT_SD_M)
        shape_sd = self._stance.shape_sd
        residual = np.concatenate([x[1:BETAS] / shape_sd, [(size + grows @ x[:BETAS] - mean) / sd]])
        return residual, np.vstack([np.eye(BETAS)[1:] / shape_sd, grows / sd])

    def _landmark_rows(self, index: int, view: View, posed: PosedBody, derive: bool) -> tuple[F64, F64]:
        trust = view.visibility[self.table.numbers].clip(_MIN_VISIBILITY) * self._trust[index]
        weight = np.sqrt(trust) / (self.table.errors * view.figure * _error_factor(view))
        pixels, moves = _project(posed, self._marks, view, derive)
        residual = (pixels - self._targets[index]) * weight[:, None]
        return residual.ravel(), (moves * weight[:, None, None]).reshape(residual.size, -1)

    def _rim_rows(self, index: int, view: View, posed: PosedBody, derive: bool) -> tuple[F64, F64]:
        outline = self._rims[index]
        assert outline is not None
        rim, points, weights = outline
        pixels, moves = _project(posed, points, view, derive)
        residual = (((pixels - rim.pixels) * rim.normals).sum(axis=1) - rim.gaps) * weights
        return residual, np.einsum("kcp,kc->kp", moves, rim.normals * weights[:, None])

    def _depth_rows(self, index: int, posed: PosedBody, derive: bool) -> tuple[F64, F64]:
        """Return equations that keep points in front of the trunk; only arms move, so that the body does not lean."""
        limited = self._in_front[index]
        assert limited is not None
        points, depths = limited
        where, moves = posed.derivatives(points) if derive else (posed.points(points), np.zeros((len(depths), 3, 0)))
        weight = np.sqrt(_DEPTH_WEIGHT / len(depths)) / _DEPTH_SD_M
        deeper = where[:, 2] > depths
        slope = moves[:, 2] * (deeper * weight)[:, None]
        if derive:
            slope *= np.concatenate([np.zeros(BETAS + PLACE), _ARM_ANGLES])
        return (where[:, 2] - depths).clip(0) * weight, slope

    def _pose_rows(self, index: int, x: F64) -> tuple[F64, F64]:
        """Return the equations of the pose's prior."""
        count = len(prior.MEAN)
        moves = np.zeros((count, BETAS + self._block))
        mean, factor = self._poses[index]
        if self._known is not None:
            mean, factor = self._known.angles, np.diag(1 / np.minimum(self._stance.spread, _POSE_CHANGE_SD_RAD))
        moves[:, BETAS + PLACE :] = factor
        return factor @ (self.angles(index, x) - mean), moves

    def _bone_rows(self, posed: PosedBody, bones: F64, derive: bool) -> tuple[F64, F64]:
        """Return the equations of arms that point along a network's ``bones`` [4, 3], unit vectors."""
        nothing = np.zeros((len(self._ends.rest), 3, 0))
        where, moves = posed.derivatives(self._ends) if derive else (posed.points(self._ends), nothing)
        bone, change = where[1::2] - where[::2], moves[1::2] - moves[::2]
        length = np.linalg.norm(bone, axis=1)[:, None]
        unit = bone / length
        along = np.einsum("bc,bcp->bp", unit, change)
        slope = (change - unit[..., None] * along[:, None]) / length[..., None] / _BONE_SD[:, None]
        return ((unit - bones) / _BONE_SD).ravel(), slope.reshape(3 * len(bone), -1)

    def _tie_rows(self, index: int, x: F64) -> tuple[F64, F64]:
        """Return the equations of a small change of pose from the first view to a further one."""
        count = len(prior.MEAN)
        moves = np.zeros((count, BETAS + self._block))
        moves[:, BETAS + PLACE :] = np.eye(count) / _POSE_CHANGE_SD_RAD
        return (self.angles(index, x) - self.angles(0, x)) / _POSE_CHANGE_SD_RAD, moves

    def _tie_slope(self) -> F64:
        """Return the derivatives [D, 6 + D] of ``_tie_rows`` by the first view's unknowns."""
        count = len(prior.MEAN)
        return np.concatenate([np.zeros((count, PLACE)), -np.eye(count) / _POSE_CHANGE_SD_RAD], axis=1)

    def _camera_rows(self, index: int, posed: PosedBody, x: F64) -> tuple[F64, F64]:
        """Return the equations of turn, roll and the camera's height above the soles along the body's upright."""
        block = x[BETAS + index * self._block :][:PLACE]
        size, grows = self.body.stature
        stature = size + grows @ x[:BETAS]
        known_height = None if self._known is None else (self._known.camera_height, _CAMERA_CHANGE_SD_FRACTION)
        mean, sd = known_height or prior.CAMERA_HEIGHT
        up = posed.frames[0][:, 1]  # the body's upright in camera axes
        hips, rises = self.body.hip_height
        turn_sd, roll_sd = self._stance.turn_sd, prior.ROLL_SD_RAD
        height = hips + rises @ x[:BETAS] - up @ block[:3]  # the camera is at the origin of its axes
        turn = block[4] - self._stance.turn
        residual = np.array([turn / turn_sd, block[5] / roll_sd, (height / stature - mean) / sd])
        moves = np.zeros((3, BETAS + self._block))
        moves[0, BETAS + 4], moves[1, BETAS + 5] = 1 / turn_sd, 1 / roll_sd
        moves[2, :BETAS] = (rises / stature - height / stature**2 * grows) / sd
        moves[2, BETAS : BETAS + 3] = -up / (stature * sd)
        moves[2, BETAS + 3 : BETAS + PLACE] = -(posed.axis_derivatives(up) @ block[:3]) / (stature * sd)
        return residual, moves


def _error_factor(view: View) -> float:
    """Return the factor of the landmarks' errors relative to a picture from the front."""
    cos = float(np.cos(np.radians(view.turn)))
    straight = _FRONT_ERROR_FACTOR if cos > 0 else _BACK_ERROR_FACTOR
    return float(_SIDE_ERROR_FACTOR + (straight - _SIDE_ERROR_FACTOR) * np.round(cos, 15) ** 2)


def _project(posed: PosedBody, points: Points, view: View, derive: bool) -> tuple[F64, F64]:
    """Return pixels [K, 2] of points and, if asked, their derivatives [K, 2, BETAS + 6 + D]."""
    where, moves = posed.derivatives(points) if derive else (posed.points(points), None)
    return projected(where, view.focal, view.centre, moves)
