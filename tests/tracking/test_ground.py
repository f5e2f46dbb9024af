"""Heights that a standing body does not have: steps and ladders, a user too tall, and what looks like one of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.evaluate.tracking_score import score
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Sample, Tracker
from glsplat.tracking.batch import forward_all
from glsplat.tracking.derive import derive, truth_from_motion
from glsplat.tracking.solve.body import FEET, HEAD, Body
from glsplat.tracking.solvers import SOLVERS, SolverName
from tests.motion.captured import captured
from tests.tracking.moves import Stage, Track, seconds

EACH = pytest.mark.parametrize("solver", SOLVERS)


def climbing(stage: Stage, to: float, speed: float = 0.6, stays: float = 2.0, down: bool = True) -> list[Sample]:
    """A second on the floor, steps of 0.2 m, one every 0.8 s, and down again; the hands keep to the head."""
    x, y, z = stage.eye
    samples = []
    for i, t in enumerate([0.0] * 72 + seconds(9.0)):
        up = min(to, 0.2 * (t // 0.8) + min(0.2, speed * (t % 0.8)))
        rises = to / 0.2 * 0.8 + stays
        if down and t > rises:
            up = max(0.0, to - speed * (t - rises))
        places = {side: stage.hand(side) for side in ("left", "right")}
        hands = {side: (at[0], at[1] + up, at[2]) for side, at in places.items()}
        samples.append(stage.sample(i / 72, head=(x, y + up, z), **hands))
    return samples


@EACH
def test_who_climbs_stands_on_something(stage: Stage, track: Track, solver: SolverName) -> None:
    """1 m up and down again: head and hands stay exact to the end, legs straight, feet a metre up."""
    samples = climbing(stage, 1.0)
    result = track(samples, solver=solver)
    top = slice(int(6.0 * 72), int(6.8 * 72))
    sole = stage.body.sole
    assert all("raised" in flags and "head_out_of_reach" not in flags for flags in result.flags[top])
    assert np.abs(result.joints[top][:, list(FEET), 1] - sole - 1.0).max() < 0.12
    heads = np.array([s.head[1] for s in samples if s.head is not None])
    ours = result.joints[:, HEAD, 1] - result.joints[0, HEAD, 1]
    assert np.abs(ours - (heads - heads[0]))[top].max() < 0.01
    assert max(e for reach in result.reach[top] for e in reach if e is not None) < 0.005
    assert "raised" not in result.flags[-1] and result.joints[-1, list(FEET), 1].max() < sole + 0.02
    assert np.abs(np.diff(result.joints[:, list(FEET), 1], axis=0)).max() * 72 < 8.0  # m/s: as of a step


@EACH
@pytest.mark.parametrize("taller", [0.15, 0.4])
def test_a_taller_user_stands_on_the_floor(stage: Stage, track: Track, solver: SolverName, taller: float) -> None:
    x, y, z = stage.eye
    result = track([stage.sample(t, head=(x, y + taller, z), left=None, right=None) for t in seconds(4)], solver=solver)
    assert "raised" not in result.flags[-1] and "head_out_of_reach" in result.flags[-1]
    assert result.joints[-1, list(FEET), 1].max() < stage.body.sole + 0.02


@EACH
def test_a_new_user_begins_on_the_floor(stage: Stage, skeleton: Skeleton, solver: SolverName) -> None:
    tracker = Tracker(skeleton, solver=solver)
    for sample in climbing(stage, 1.0, down=False):
        tracker.update(sample)
    assert "raised" in tracker.flags
    tracker.reset()
    joints = tracker.joints(tracker.update(stage.sample(0.0)))
    assert "raised" not in tracker.flags and joints[list(FEET), 1].max() < stage.body.sole + 0.1


@pytest.mark.check
@pytest.mark.shared
@EACH
def test_captured_climbs(skeleton: Skeleton, shared_data: Path, solver: SolverName) -> None:
    """Steps and a ladder of the CMU database, by somebody on whom neither solver was developed but for the ground:
    28 to 35 cm off without it.
    """
    body = Body.of(skeleton)
    for name in ("14_21", "14_33"):
        motion = captured(shared_data / "mocap_cmu", f"cmu_{name}.npz", skeleton)
        truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, 72.0)
        tracker = Tracker(skeleton, solver=solver)
        poses = [tracker.update(s) for s in derive(skeleton, truth, fingers=False)[:860]]
        rotations, trans = (np.stack([getattr(p, a) for p in poses]) for a in ("rotations", "trans"))
        found, _ = forward_all(skeleton, rotations, trans)
        assert score(found, truth.positions[:860], 72.0, body.sole).mpjpe < 11
