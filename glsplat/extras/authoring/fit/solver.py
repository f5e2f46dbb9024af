"""The unknowns of a fit and their equations: landmarks, outlines and what is known before, all views together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.extras.authoring.compute.levenberg import least_squares
from glsplat.extras.authoring.fit import prior
from glsplat.extras.authoring.fit.kinematics import PLACE, PosedBody, projected
from glsplat.extras.authoring.fit.landmarks import Landmarks
from glsplat.extras.authoring.fit.outline import Rim
from glsplat.extras.authoring.fit.view import View

__all__ = ["BodySolver", "KnownShape"]

F64 = NDArray[np.float64]

_SAME_POSE = 0.06  # radians; how much a person moves between two pictures of one session
_OUTLIER = 3.0  # strays; a landmark this far off counts a quarter
_LEAST_SURE = 0.1  # a landmark that is not seen still says a little
_FRONT_DOUBT, _BACK_DOUBT, _SIDE_DOUBT = 1.0, 1.5, 3.0  # the offsets were measured on fronts
_HEIGHT_DOUBT = 0.01  # metres; how well people know their height
_PLAIN_SIDE = 0.8  # cosine of the turn; from there on left and right are where they are in a front or a back
_SAME_SHAPE = 1e-3  # standard deviations of a shape that is known
_BEFORE, _BEFORE_WORTH = 0.01, 12.0  # metres that a limb may lie too deep; as many measurements as that is
_ARMS = np.array([any(part in name for part in ("shoulder", "elbow")) for name, _ in prior.HINGES.names], float)
_BONE_DOUBT = np.array([1.0, 1.0, 0.4])  # of unit vectors: landmarks know the rest better
_SAME_CAMERA = 0.01  # shares of the stature that the height of a standing camera may seem to change


@dataclass(frozen=True, slots=True, eq=False)
class KnownShape:
    """What other pictures of the same minute have told."""

    betas: F64  # [BETAS] the shape
    angles: F64  # [D] about the pose, in radians
    camera_height: float  # above the soles, in shares of the stature


class BodySolver:
    """Shape, and of each view the place and the pose, as one vector: [BETAS], then [6 + D] a view.

    ``height`` is the stature in metres, None where nobody gave one; ``known`` is what need not be found out, or hardly.
    ``stance`` is how the person may stand, where that is not known. Residuals are in standard deviations.
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
        self._before: list[tuple[Points, F64] | None] = [None] * len(views)
        self._trust = [np.ones(len(table.numbers)) for _ in views]
        self.x: F64 = self._start()
        self._poses = [self._stance.about(self.angles(index)) for index in range(len(views))]
        self._seen = [self._sided(index) for index in range(len(views))]

    @property
    def sleeve(self) -> float:
        """Share of the figure: an arm's outline that lies farther off the bare arm says little of it."""
        return self._stance.sleeve

    @property
    def betas(self) -> F64:
        """[BETAS] the shape."""
        return self.x[:BETAS]

    def posed(self, view: int, x: F64 | None = None) -> PosedBody:
        """The body as a view shows it."""
        x = self.x if x is None else x
        block = x[BETAS + view * self._block :][: self._block]
        return PosedBody(self.body, prior.HINGES, self.views[view].facing, x[:BETAS], block[:PLACE], block[PLACE:])

    def angles(self, view: int) -> F64:
        """[D] the fitted angles of a view in radians."""
        return self.x[BETAS + view * self._block + PLACE :][: len(prior.MEAN)]

    def camera_height(self, view: int) -> float:
        """Of a view's camera above the soles, in shares of the stature."""
        posed = self.posed(view)
        size, grows = self.body.stature
        hips, rises = self.body.hip_height
        above = hips + rises @ self.betas - posed.frames[0][:, 1] @ posed.joints[0]
        return float(above / (size + grows @ self.betas))

    def weigh_landmarks(self) -> None:
        """Trust each landmark by how far it is off now, so that a wrong one does not pull for long.

        And take arms to be of the kind that they are most like now.
        """
        for index in range(len(self.views)):
            self._poses[index] = self._stance.about(self.angles(index))
            far = np.linalg.norm(self.strayed(index), axis=1)
            self._trust[index] = 1 / (1 + (far / _OUTLIER) ** 2)

    def strayed(self, view: int, *, pixels: bool = False) -> F64:
        """[L, 2] how far each landmark is from where the body has it, in strays or pixels."""
        seen = self.views[view]
        at = projected(self.posed(view).points(self._marks), seen.focal, seen.centre)[0]
        away = at - self._seen[view]
        return away if pixels else away / (self.table.strays * seen.figure * _doubt(seen))[:, None]

    def pull_to(self, view: int, rim: Rim, moved: F64 | None, weights: F64) -> None:
        """From now on the rim's vertices are drawn to the mask's edge, each along its normal.

        ``weights`` [K] turn pixels into standard deviations; ``moved`` [V, 3] metres is the surface's offset at rest.
        """
        self._rims[view] = rim, self.body.points(rim.vertices, moved), weights

    def keep_before(self, view: int, vertices: NDArray[np.intp], depths: F64) -> None:
        """From now on the bare body's ``vertices`` [K] are pushed to ``depths`` [K] metres where they are deeper."""
        self._before[view] = (self.body.points(vertices), depths) if len(vertices) else None

    def solve(self, steps: int) -> None:
        """Improve all unknowns."""
        self.x = least_squares(self._rows, self.x, steps)

    def _start(self) -> F64:
        """A person of the height asked for, in the stance's pose, where the hips are and as large as the mask."""
        x = np.zeros(BETAS + self._block * len(self.views))
        size, grows = self.body.stature
        height = prior.STATURE[0] if self._height is None else self._height
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
            block[PLACE:] = self._stance.begun() if self._known is None else self._known.angles
        return x

    def _sided(self, index: int) -> F64:
        """[L, 2] the landmarks in use; those that a network which took front for back put on the wrong side, put right.

        The side that a view shows is known, so in fronts and backs left and right are known before anything is fitted.
        """
        view = self.views[index]
        marks = view.landmarks[self.table.numbers].copy()
        if abs(np.cos(np.radians(view.turn))) > _PLAIN_SIDE:
            at = projected(self.posed(index).points(self._marks), view.focal, view.centre)[0]
            wrong = (at[:, 0] - at[self.table.twins, 0]) * (marks[:, 0] - marks[self.table.twins, 0]) < 0
            marks[wrong] = marks[self.table.twins[wrong]]
        return marks

    def _rows(self, x: F64, derive: bool) -> tuple[F64, F64]:
        """All residuals [R] and, if asked, their derivatives [R, P]."""
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
            if self._before[index] is not None:
                parts.append((*self._before_rows(index, posed, derive), index, None))
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
        """The prior of the shape, and the stature."""
        if self._known is not None:
            return (x[:BETAS] - self._known.betas) / _SAME_SHAPE, np.eye(BETAS) / _SAME_SHAPE
        size, grows = self.body.stature
        wanted, doubt = prior.STATURE if self._height is None else (self._height, _HEIGHT_DOUBT)
        tied = self._stance.shape_doubt
        residual = np.concatenate([x[1:BETAS] / tied, [(size + grows @ x[:BETAS] - wanted) / doubt]])
        return residual, np.vstack([np.eye(BETAS)[1:] / tied, grows / doubt])

    def _landmark_rows(self, index: int, view: View, posed: PosedBody, derive: bool) -> tuple[F64, F64]:
        sure = view.visibility[self.table.numbers].clip(_LEAST_SURE) * self._trust[index]
        weight = np.sqrt(sure) / (self.table.strays * view.figure * _doubt(view))
        if derive:
            pixels, moves = _pixels_and_moves(posed, self._marks, view)
        else:
            pixels, moves = projected(posed.points(self._marks), view.focal, view.centre)
        residual = (pixels - self._seen[index]) * weight[:, None]
        return residual.ravel(), (moves * weight[:, None, None]).reshape(residual.size, -1)

    def _rim_rows(self, index: int, view: View, posed: PosedBody, derive: bool) -> tuple[F64, F64]:
        pulled = self._rims[index]
        assert pulled is not None
        rim, points, weights = pulled
        if derive:
            pixels, moves = _pixels_and_moves(posed, points, view)
        else:
            pixels, moves = projected(posed.points(points), view.focal, view.centre)
        residual = (((pixels - rim.pixels) * rim.normals).sum(axis=1) - rim.gaps) * weights
        return residual, np.einsum("kcp,kc->kp", moves, rim.normals * weights[:, None])

    def _before_rows(self, index: int, posed: PosedBody, derive: bool) -> tuple[F64, F64]:
        """What is seen before the trunk is not in it: arms make way, for a body that does would lean back."""
        pushed = self._before[index]
        assert pushed is not None
        points, depths = pushed
        where, moves = posed.derivatives(points) if derive else (posed.points(points), np.zeros((len(depths), 3, 0)))
        weight = np.sqrt(_BEFORE_WORTH / len(depths)) / _BEFORE
        deeper = where[:, 2] > depths
        slope = moves[:, 2] * (deeper * weight)[:, None]
        if derive:
            slope *= np.concatenate([np.zeros(BETAS + PLACE), _ARMS])
        return (where[:, 2] - depths).clip(0) * weight, slope

    def _pose_rows(self, index: int, x: F64) -> tuple[F64, F64]:
        """The prior of the pose."""
        count = len(prior.MEAN)
        angles = x[BETAS + index * self._block + PLACE :][:count]
        moves = np.zeros((count, BETAS + self._block))
        mean, factor = self._poses[index]
        if self._known is not None:
            mean, factor = self._known.angles, np.diag(1 / np.minimum(self._stance.spread, _SAME_POSE))
        moves[:, BETAS + PLACE :] = factor
        return factor @ (angles - mean), moves

    def _bone_rows(self, posed: PosedBody, said: F64, derive: bool) -> tuple[F64, F64]:
        """Arms point as a network's metres say: roughly, and most roughly in depth."""
        nothing = np.zeros((len(self._ends.rest), 3, 0))
        where, moves = posed.derivatives(self._ends) if derive else (posed.points(self._ends), nothing)
        bone, change = where[1::2] - where[::2], moves[1::2] - moves[::2]
        length = np.linalg.norm(bone, axis=1)[:, None]
        unit = bone / length
        along = np.einsum("bc,bcp->bp", unit, change)
        slope = (change - unit[..., None] * along[:, None]) / length[..., None] / _BONE_DOUBT[:, None]
        return ((unit - said) / _BONE_DOUBT).ravel(), slope.reshape(3 * len(bone), -1)

    def _tie_rows(self, index: int, x: F64) -> tuple[F64, F64]:
        """A further view's pose is the first one's but for a little."""
        count = len(prior.MEAN)
        angles, first = (x[BETAS + view * self._block + PLACE :][:count] for view in (index, 0))
        moves = np.zeros((count, BETAS + self._block))
        moves[:, BETAS + PLACE :] = np.eye(count) / _SAME_POSE
        return (angles - first) / _SAME_POSE, moves

    def _tie_slope(self) -> F64:
        """[D, 6 + D] the ties' derivatives by the first view's unknowns."""
        count = len(prior.MEAN)
        return np.concatenate([np.zeros((count, PLACE)), -np.eye(count) / _SAME_POSE], axis=1)

    def _camera_rows(self, index: int, posed: PosedBody, x: F64) -> tuple[F64, F64]:
        """Turn, roll, and the camera's height above the soles as the body's upright has it."""
        block = x[BETAS + index * self._block :][:PLACE]
        size, grows = self.body.stature
        stature = size + grows @ x[:BETAS]
        mean, doubt = prior.CAMERA_HEIGHT if self._known is None else (self._known.camera_height, _SAME_CAMERA)
        up = posed.frames[0][:, 1]  # the body's upright in camera axes
        hips, rises = self.body.hip_height
        turn, roll = self._stance.turn_doubt, prior.TURN_DOUBT[1]
        height = hips + rises @ x[:BETAS] - up @ block[:3]  # the camera is at the origin of its axes
        residual = np.array([(block[4] - self._stance.turn) / turn, block[5] / roll, (height / stature - mean) / doubt])
        moves = np.zeros((3, BETAS + self._block))
        moves[0, BETAS + 4], moves[1, BETAS + 5] = 1 / turn, 1 / roll
        moves[2, :BETAS] = (rises / stature - height / stature**2 * grows) / doubt
        moves[2, BETAS : BETAS + 3] = -up / (stature * doubt)
        moves[2, BETAS + 3 : BETAS + PLACE] = -(posed.turned(up) @ block[:3]) / (stature * doubt)
        return residual, moves


def _doubt(view: View) -> float:
    """How much farther landmarks stray than in a picture from the front."""
    cos = float(np.cos(np.radians(view.turn)))
    straight = _FRONT_DOUBT if cos > 0 else _BACK_DOUBT
    return float(_SIDE_DOUBT + (straight - _SIDE_DOUBT) * np.round(cos, 15) ** 2)


def _pixels_and_moves(posed: PosedBody, points: Points, view: View) -> tuple[F64, F64]:
    where, moves = posed.derivatives(points)
    return projected(where, view.focal, view.centre, moves)
