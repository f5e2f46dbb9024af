"""Fit the open body to many pictures of a turning person.

Thirty views have thousands of unknowns. So eight views from around are solved jointly for shape, pose and camera; each
other view starts from the nearest solved one, with the shape fixed. Then all outlines dress the surface, and every view
is posed again to the dressed surface, whose outline clothes do not shift.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from glsplat.extras.authoring.body.open_body import BETAS, open_body
from glsplat.extras.authoring.fit.body_fit import (
    MAX_FIGURE_PX,
    BodyFit,
    assemble_fit,
    converge,
    fit_clothes,
    follow_outlines,
    landmark_errors,
)
from glsplat.extras.authoring.fit.kinematics import PosedBody
from glsplat.extras.authoring.fit.landmarks import landmarks
from glsplat.extras.authoring.fit.offsets import offset_directions
from glsplat.extras.authoring.fit.prior import HINGES
from glsplat.extras.authoring.fit.solver import BodySolver, KnownShape
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import degrees_between

_KEY_VIEWS = 8  # solved jointly
_DRESSING_ROUNDS = 2  # of posing the views to the dressed body and dressing it again


def key_views(turns: Sequence[float], count: int = _KEY_VIEWS) -> list[int]:
    """Return the indices of at most ``count`` views from all around, front first; ``turns`` in degrees."""
    keys: list[int] = []
    for wanted in np.arange(count) * 360.0 / count:
        best = min(range(len(turns)), key=lambda index: (degrees_between(turns[index], float(wanted)), index))
        if best not in keys:
            keys.append(best)
    return keys


def fit_turning(
    views: Sequence[View], height: float | None = None, progress: Callable[[float], None] = lambda done: None
) -> BodyFit:
    """Fit the open body to pictures of one person in about one pose, with ``turn`` known to some 20 degrees.

    The camera stands still or moves around at one height. ``progress`` is called with the fraction done.
    ``problem`` of the fit reports that it did not converge.
    """
    body = open_body()
    small = [view.smaller(MAX_FIGURE_PX) for view in views]
    keys = key_views([view.turn for view in small])
    first = BodySolver(body, landmarks(), [small[key] for key in keys], height)
    converge(first)
    progress(0.3)
    poses: dict[int, PosedBody] = {key: first.posed(index) for index, key in enumerate(keys)}
    angles = {key: first.angles(index).copy() for index, key in enumerate(keys)}
    strays = dict(zip(keys, landmark_errors(first), strict=True))
    camera = float(np.median([first.camera_height(index) for index in range(len(keys))]))
    betas = first.betas.copy()

    def store(index: int, solver: BodySolver) -> None:
        poses[index], angles[index] = solver.posed(0), solver.angles(0).copy()
        strays[index] = landmark_errors(solver)[0]

    others = [index for index in range(len(views)) if index not in poses]
    for done, index in enumerate(others):
        near = min(poses, key=lambda solved: (degrees_between(small[solved].turn, small[index].turn), solved))
        solver = BodySolver(body, landmarks(), [small[index]], height, KnownShape(betas, angles[near], camera))
        converge(solver, 2)
        store(index, solver)
        progress(0.3 + 0.3 * done / len(others))
    bare, joints = body.shaped(betas)
    numbers = range(len(views))
    offsets = fit_clothes(body, bare, [poses[index] for index in numbers], views)
    for turn in range(_DRESSING_ROUNDS):
        moved = offsets[:, None] * offset_directions(body, bare)
        about = np.median([angles[index] for index in numbers], axis=0)
        for index in numbers:
            solver = BodySolver(body, landmarks(), [small[index]], height, KnownShape(betas, about, camera))
            solver.x[BETAS:] = np.concatenate([poses[index].place, angles[index]])
            solver.weigh_landmarks()
            follow_outlines(solver, 2, moved)
            store(index, solver)
            progress(0.6 + 0.4 * (turn + index / len(views)) / _DRESSING_ROUNDS)
        offsets = fit_clothes(body, bare, [poses[index] for index in numbers], views)
    rotations = [HINGES.rotations(angles[index]) for index in numbers]
    return assemble_fit(
        body,
        bare,
        joints,
        offsets,
        [poses[index] for index in numbers],
        rotations,
        views,
        [strays[index] for index in numbers],
    )
