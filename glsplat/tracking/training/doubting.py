"""What a network and the analytic solver are off, learned after the network itself, as a last layer of it.

A generalised linear model: of what is off, distributed exponentially about a mean whose logarithm is linear in what the
network's last layer sees. The likelihood has one maximum; nothing here is random. The network itself does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import matrix_quaternions
from glsplat.tracking.learned.frames import DOUBTED, KNOWN, TICK, Guess, unit_of
from glsplat.tracking.learned.network import Network
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.training.clips import Clip, targets_of
from glsplat.tracking.training.fit import alone, features, shares_of

__all__ = ["doubting"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

LEAST = 0.01  # units: less counts as that
SMOOTHED = 0.003  # of a feature's square that weights are kept small by
ROUNDS = 60  # of the fit; it is still long before
BLIND = 3  # of so many clips one is seen once more without hands


def doubting(network: Network, clips: Sequence[Clip], body: Body) -> Network:
    """The network, with the rows that say what it and the analytic solver are off by.

    ``clips``: those of people it learned from, at RATE; mirrored ones and other speeds add nothing and take time.
    """
    seen, off, weight = [], [], []
    for i, (clip, share) in enumerate(zip(clips, shares_of(clips), strict=True)):
        for blind in (False, True) if i % BLIND == 0 else (False,):
            if blind:
                clip = replace(clip, seen=replace(clip.seen, tracked=np.zeros_like(clip.seen.tracked)))
            hidden, guessed = _guessed(network, clip, body)
            truth = clip.points[:, list(DOUBTED)]
            both = np.stack((guessed, _solved(clip, body)), 1) - truth[:, None].astype(float)
            seen.append(hidden)
            off.append(np.linalg.norm(both, axis=-1).reshape(len(truth), -1) / unit_of(body.eye_height))
            weight.append(np.full(len(truth), share / len(truth)))
    x, every, w = (np.concatenate(part).astype(np.float64) for part in (seen, off, weight))
    layers = [_fitted(x, np.maximum(column, LEAST), w / w.sum()) for column in every.T]
    rows, bias = (np.array(part, np.float32) for part in zip(*layers, strict=True))
    return replace(
        network,
        back=np.concatenate((network.back[:KNOWN], rows)),
        back_bias=np.concatenate((network.back_bias[:KNOWN], bias)),
    )


def _fitted(x: F64, off: F64, weight: F64) -> tuple[F64, float]:
    """Weights [W] and bias of log(mean of ``off``), by Fisher's scoring."""
    middle = weight @ x
    away = x - middle
    gram = away.T @ (weight[:, None] * away)
    gram += np.diag(SMOOTHED * (np.diag(gram) + 1e-6))
    rows, bias = np.zeros(x.shape[1]), float(np.log(weight @ off))
    for _ in range(ROUNDS):
        beyond = off * np.exp(-(away @ rows + bias)) - 1  # less than nothing is off, or more
        step = np.linalg.solve(gram, away.T @ (weight * beyond) - SMOOTHED * np.diag(gram) * rows)
        rows += step / max(1.0, 2 * float(np.abs(away @ step).max()))
        bias += float(np.clip(weight @ beyond, -0.5, 0.5))
    return rows, bias - float(middle @ rows)


def _guessed(network: Network, clip: Clip, body: Body) -> tuple[F32, F32]:
    """What the last layer sees [T, W], and DOUBTED in the world [T, 3, 3], metres."""
    unit = unit_of(body.eye_height)
    inputs = features(alone(clip.seen), unit)[0]
    state, hidden = network.start(), []
    for row in inputs:
        _, state = network.step(row, state)
        hidden.append(np.maximum(network.skip @ state + network.skip_bias, 0))
    last = np.array(hidden)
    said = Guess.of(last @ network.back[:KNOWN].T + network.back_bias[:KNOWN], unit).points[:, list(DOUBTED)]
    truth = Guess.of(targets_of(clip, unit), unit).points[:, list(DOUBTED)]
    # distances are those in the head's frame
    return last, clip.points[:, list(DOUBTED)] + said - truth


def _solved(clip: Clip, body: Body) -> F64:
    """Where the analytic solver has DOUBTED, [T, 3, 3]."""
    solver, seen, out = AnalyticSolver(body), clip.seen, []
    head, hands = matrix_quaternions(seen.head.astype(float)), matrix_quaternions(seen.hand.astype(float))
    for i, eye in enumerate(seen.eye.tolist()):
        targets = Targets(tuple(eye), tuple(head[i].tolist()))
        if seen.tracked[i, 0]:
            targets.left, targets.left_hand = tuple(seen.at[i, 0].tolist()), tuple(hands[i, 0].tolist())
        if seen.tracked[i, 1]:
            targets.right, targets.right_hand = tuple(seen.at[i, 1].tolist()), tuple(hands[i, 1].tolist())
        pelvis = solver.solve(targets, TICK).pelvis
        out.append([pelvis, *[foot.ball for foot in solver.legs.feet]])
    return np.array(out)
