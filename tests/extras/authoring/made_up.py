"""A made-up person: the open body in a random shape and pose, and what a camera and the networks would say of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from glsplat.extras.authoring.body.open_body import BETAS, open_body
from glsplat.extras.authoring.fit import prior
from glsplat.extras.authoring.fit.kinematics import PosedBody, projected
from glsplat.extras.authoring.fit.landmarks import LANDMARK_COUNT, landmarks
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.solver import BodySolver
from glsplat.extras.authoring.fit.view import View

__all__ = ["FOCAL", "SIZE", "made", "posed_view", "slope_error"]

SIZE, FOCAL = (480, 320), 640.0


def made(side: str = "front", *, tilt: float = 0.08, seed: int = 3) -> tuple[View, np.ndarray, float]:
    """A view of a made-up person from ``tilt`` radians above, their joints in the camera, and their stature."""
    view, posed, solver = posed_view(side, tilt=tilt, seed=seed)
    size, grows = open_body().stature
    return view, posed.joints, float(size + grows @ solver.betas)


def posed_view(
    side: str = "front",
    *,
    tilt: float = 0.08,
    seed: int = 3,
    turn: float | None = None,
    told: float | None = None,
    bent: Mapping[tuple[str, int], float] | None = None,
) -> tuple[View, PosedBody, BodySolver]:
    """The same with the posed body and the solver that holds its numbers.

    With a ``turn`` in degrees they stand that way, and the view says that it were ``told``. ``bent`` are angles in
    radians by joint and axis, in place of the mean pose's.
    """
    rng = np.random.default_rng(seed)
    body = open_body()
    blank = View(np.ones((480, 320), bool), np.full((LANDMARK_COUNT, 2), 160.0), np.ones(LANDMARK_COUNT), FOCAL)
    view = View(blank.mask, blank.landmarks, blank.visibility, FOCAL, side=side, turn=turn)
    solver = BodySolver(body, landmarks(), [view], 1.7)
    solver.x[1:BETAS] = rng.normal(0, 0.7, BETAS - 1)
    place = [0.05, 0.1, 3.0, tilt, 0.1, 0.02]
    solver.x[BETAS:] = np.concatenate([place, prior.MEAN + rng.normal(0, 0.4, len(prior.MEAN)) * prior.SPREAD])
    for hinge, angle in (bent or {}).items():
        solver.angles(0)[prior.HINGES.names.index(hinge)] = angle
    posed = solver.posed(0)
    pixels = projected(posed.points(body.points(np.arange(len(body.vertices)))), FOCAL, view.centre)[0]
    marks = np.zeros((LANDMARK_COUNT, 2))
    table = landmarks()
    where = posed.points(table.points(body))
    marks[table.numbers] = projected(where, FOCAL, view.centre)[0]
    world = np.zeros((LANDMARK_COUNT, 3))
    world[table.numbers] = where - where[np.isin(table.numbers, (23, 24))].mean(axis=0)
    mask = projected_mask(pixels, body.faces, SIZE)
    said = turn if told is None else told
    seen = View(mask, marks, np.ones(LANDMARK_COUNT), FOCAL, side=side, turn=said, world=world)
    return seen, posed, solver


def slope_error(solver: BodySolver, rng: np.random.Generator) -> float:
    """How far the derivatives of all equations are from differences, as a share of the largest."""
    x = solver.x + rng.normal(0, 0.05, len(solver.x))
    jacobian = solver._rows(x, True)[1]
    steps = 1e-6 * np.eye(len(x))
    both = [(solver._rows(x + step, False)[0] - solver._rows(x - step, False)[0]) / 2e-6 for step in steps]
    return float(np.abs(jacobian - np.stack(both, axis=-1)).max() / np.abs(jacobian).max())
