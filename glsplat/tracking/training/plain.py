"""What the analytic solver says of a whole sequence: the network hears it beside what is seen."""

from __future__ import annotations

import numpy as np

from glsplat.rotations import matrix_quaternions
from glsplat.tracking.learned.frames import TICK, PlainFrames, TrackedFrames
from glsplat.tracking.learned.plain import plain_frames
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.quat import Quat, Vec
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.solver import AnalyticSolver

__all__ = ["plain_body"]


def plain_body(seen: TrackedFrames, body: Body) -> PlainFrames:
    """Of moments [T] one TICK apart, from their first."""
    solver, out = AnalyticSolver(body), []
    for targets in _targets(seen):
        targets = solver.ground.bring(targets, solver.legs.slack, solver.legs.clearance.tiptoe, TICK)
        torso = solver.torso(targets, TICK)
        solver.stepped(targets, torso, TICK, shown=False)
        out.append(plain_frames(solver, torso, targets.eye))
    return PlainFrames(*[np.concatenate([getattr(one, name) for one in out]) for name in PlainFrames.__slots__])


def _targets(seen: TrackedFrames) -> list[Targets]:
    heads = matrix_quaternions(seen.head.astype(np.float64)).tolist()
    hands = matrix_quaternions(seen.hand.astype(np.float64)).tolist()
    moments = zip(seen.eye.tolist(), heads, seen.at.tolist(), hands, seen.tracked.tolist(), strict=True)
    out = []
    for eye, head, at, hand, tracked in moments:
        targets = Targets(_vec(eye), _quat(head))
        if tracked[0]:
            targets.left, targets.left_hand = _vec(at[0]), _quat(hand[0])
        if tracked[1]:
            targets.right, targets.right_hand = _vec(at[1]), _quat(hand[1])
        out.append(targets)
    return out


def _vec(v: list[float]) -> Vec:
    return (v[0], v[1], v[2])


def _quat(q: list[float]) -> Quat:
    return (q[0], q[1], q[2], q[3])
