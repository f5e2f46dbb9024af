"""The open body fitted to many pictures of somebody who turns: some of them tell the shape, the others what is left.

All unknowns of thirty views at once would be thousands of numbers. So eight views from around are solved as one, and
tell shape, pose and camera; each other view starts from the nearest one that is solved, with the shape held. Then the
surface is dressed by all outlines, and every view is posed anew to the dressed one, whose outline clothes do not shift.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import BETAS, Body, open_body
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

__all__ = ["fit_turning", "key_views"]

F64 = NDArray[np.float64]

_KEYS = 8  # views that tell the shape
_DRESSED = 2  # times that the views are posed to the dressed body and it is dressed anew


def key_views(turns: Sequence[float], count: int = _KEYS) -> list[int]:
    """Numbers of at most ``count`` of the views with these turns in degrees that look from all around, front first."""
    keys: list[int] = []
    for wanted in np.arange(count) * 360.0 / count:
        best = min(range(len(turns)), key=lambda index: (degrees_between(turns[index], float(wanted)), index))
        if best not in keys:
            keys.append(best)
    return keys


def fit_turning(
    views: Sequence[View],
    height: float | None = None,
    body: Body | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> BodyFit:
    """Fit the open body to pictures of one person in about one pose, whose ``turn`` is known to some 20 degrees.

    The camera stands still, or was carried around at one height. ``progress`` is told the share that is done. Raises
    FormatError; a fit that did not converge says so in ``problem``.
    """
    if len(views) < 2:
        raise FormatError("a fit of somebody who turns needs at least two pictures")
    body = body or open_body()
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

    def keep(index: int, solver: BodySolver) -> None:
        poses[index], angles[index] = solver.posed(0), solver.angles(0).copy()
        strays[index] = landmark_errors(solver)[0]

    others = [index for index in range(len(views)) if index not in poses]
    for done, index in enumerate(others):
        near = min(poses, key=lambda known: (degrees_between(small[known].turn, small[index].turn), known))
        solver = BodySolver(body, landmarks(), [small[index]], height, KnownShape(betas, angles[near], camera))
        converge(solver, 2)
        keep(index, solver)
        progress(0.3 + 0.3 * done / len(others))
    bare, joints = body.shaped(betas)
    numbers = range(len(views))
    offsets = fit_clothes(body, bare, [poses[index] for index in numbers], views)
    for turn in range(_DRESSED):
        moved = offsets[:, None] * offset_directions(body, bare)
        about = np.median([angles[index] for index in numbers], axis=0)
        for index in numbers:
            solver = BodySolver(body, landmarks(), [small[index]], height, KnownShape(betas, about, camera))
            solver.x[BETAS:] = np.concatenate([poses[index].place, angles[index]])
            solver.weigh_landmarks()
            follow_outlines(solver, 2, moved)
            keep(index, solver)
            progress(0.6 + 0.4 * (turn + index / len(views)) / _DRESSED)
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
