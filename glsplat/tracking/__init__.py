"""Head and hand tracking to a full-body pose: filter, calibrate, inverse kinematics. Plain numbers and numpy only."""

from __future__ import annotations

from glsplat.tracking.calibration import Calibration, calibrate
from glsplat.tracking.recording import record, replay
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.solution import Solution, Solver, Targets
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.tracker import Tracker, TrackerConfig

__all__ = [
    "AnalyticSolver",
    "Calibration",
    "Sample",
    "Solution",
    "Solver",
    "Targets",
    "Tracker",
    "TrackerConfig",
    "calibrate",
    "record",
    "replay",
]
