"""Head and hand tracking to a full-body pose: filter, calibrate, inverse kinematics. Plain numbers and numpy only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.tracking.calibration import Calibration, calibrate
    from glsplat.tracking.config import TrackerConfig
    from glsplat.tracking.recording import embedded_recording, record, replay
    from glsplat.tracking.sample import Sample
    from glsplat.tracking.solve.body import Body
    from glsplat.tracking.solve.solution import Solution, Solver, Targets
    from glsplat.tracking.solve.solver import AnalyticSolver
    from glsplat.tracking.tracker import Tracker

__all__ = [
    "AnalyticSolver",
    "Body",
    "Calibration",
    "Sample",
    "Solution",
    "Solver",
    "Targets",
    "Tracker",
    "TrackerConfig",
    "calibrate",
    "embedded_recording",
    "record",
    "replay",
]

_HOME = {
    "AnalyticSolver": "solve.solver",
    "Body": "solve.body",
    "Calibration": "calibration",
    "Sample": "sample",
    "Solution": "solve.solution",
    "Solver": "solve.solution",
    "Targets": "solve.solution",
    "Tracker": "tracker",
    "TrackerConfig": "config",
    "calibrate": "calibration",
    "embedded_recording": "recording",
    "record": "recording",
    "replay": "recording",
}

__getattr__ = on_demand(__name__, _HOME)
