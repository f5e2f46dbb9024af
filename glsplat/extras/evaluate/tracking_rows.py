"""Run the tracker and the baselines on head and hands of a true motion: scores and times of a clip."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from glsplat.extras.evaluate.baseline import baseline
from glsplat.extras.evaluate.tracking_score import TrackingScore, score, windows
from glsplat.extras.learned.network import PoseNetwork, embedded_network
from glsplat.extras.learned.solver import LearnedSolver
from glsplat.extras.motions.batch import forward_all
from glsplat.extras.motions.derive import derive, truth_from_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.tracker import Tracker

BASELINES = ("glued", "naive", "naive, untold")
SOLVERS = (*BASELINES, "analytic", "learned", "learned, head only")


@dataclass(frozen=True)
class Row:
    """Results of one solver on one clip at one rate."""

    clip: str
    rate: float
    solver: str
    score: TrackingScore
    milliseconds: float  # median per sample; NaN: not timed
    windows: tuple[float, ...]  # MPJPE of each ten seconds, cm
    said: float = float("nan")  # mean error of body joints in cm that the solver itself expects; NaN: unknown


def rows_of(
    name: str,
    motion: Motion,
    rate: float,
    skeleton: Skeleton,
    config: TrackerConfig,
    network: PoseNetwork | None = None,
) -> list[Row]:
    """Return a row per solver for one clip at one rate; ``network``: of the learned solver (default: embedded)."""
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, rate)
    body = Body.of(skeleton)
    sole = body.sole
    nan = float("nan")
    rows = []
    shown = (baseline(truth, "glued"), baseline(truth, "naive"), baseline(truth, "naive", body))
    for kind, estimate in zip(BASELINES, shown, strict=True):
        result = score(estimate, truth.positions, rate, sole)
        rows.append(Row(name, rate, kind, result, nan, windows(estimate, truth.positions, rate)))
    samples = derive(skeleton, truth)
    network = network or embedded_network()
    for name_of in SOLVERS[len(BASELINES) :]:
        solver = AnalyticSolver(body) if name_of == "analytic" else LearnedSolver(body, network)
        tracker = Tracker(skeleton, config=config, head_only=name_of == SOLVERS[-1], solver=solver)
        rotations, trans, spent = np.empty_like(truth.rotations), np.empty_like(truth.trans), []
        said: list[float] = []
        for i, sample in enumerate(samples):
            start = time.perf_counter()
            pose = tracker.update(sample)
            spent.append(time.perf_counter() - start)
            rotations[i], trans[i] = pose.rotations, pose.trans
            said += tracker.expected_error
        positions, _ = forward_all(skeleton, rotations, trans)
        result = score(positions, truth.positions, rate, sole, rotations, truth.rotations)
        worst = windows(positions, truth.positions, rate)
        doubt = float(np.mean(said)) * 100 if said else nan
        rows.append(Row(name, rate, name_of, result, float(np.median(spent)) * 1e3, worst, doubt))
    return rows
