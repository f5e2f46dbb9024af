"""The analytic solver's body as the network takes it."""

from __future__ import annotations

import numpy as np

from glsplat.tracking.learned.frames import PlainFrames
from glsplat.tracking.solve.quat import Vec, swing_twist_y
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.solve.spine import Torso

__all__ = ["plain_frames"]


def plain_frames(solver: AnalyticSolver, torso: Torso, eye: Vec) -> PlainFrames:
    """One moment of a solver whose newest torso is ``torso``, under eyes at ``eye``."""
    x, _, z = eye
    left, right = solver.legs.feet
    places = [(px - x, py, pz - z) for px, py, pz in (torso.pelvis_at, left.ball, right.ball)]
    return PlainFrames(
        np.array([places], np.float32),
        np.array([swing_twist_y(torso.pelvis) or 0.0], np.float32),
        np.array([[left.planted, right.planted]], np.float32),
        np.array([solver.walks], np.float32),
    )
