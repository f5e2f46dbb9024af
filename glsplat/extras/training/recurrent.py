"""Train the network: forward over sequences, backward through time, and a step of AdamW; numpy alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from glsplat.arrays import F32
from glsplat.extras.learned.network import ARRAYS

Weights = dict[str, F32]

DROP = 0.1  # dropout before and after the recurrent layer
DECAY, CLIP = 0.02, 1.0  # weight decay in a step of rate 1; largest norm of the gradient
MEAN, SQUARE = 0.9, 0.999  # decay of the running means of gradients and of their squares


def started(rng: np.random.Generator, inputs: int, width: int, units: int, outputs: int) -> Weights:
    """Return initial weights, uniform within 1 / sqrt(fan in) (He et al. 2015); biases are 0."""
    shapes = ((width, inputs), (3 * units, width), (3 * units, units), (width, units), (outputs, width))
    out: Weights = {}
    for name, shape in zip(ARRAYS[::2], shapes, strict=True):
        out[name] = (rng.uniform(-1, 1, shape) / sqrt(shape[1])).astype(np.float32)
        out[f"{name}_bias"] = np.zeros(shape[0], np.float32)
    return out


@dataclass(slots=True)
class Learner:
    """Weights as in ``PoseNetwork``, with AdamW's running means (Loshchilov & Hutter 2019)."""

    weights: Weights
    means: Weights = field(default_factory=dict)
    squares: Weights = field(default_factory=dict)
    steps: int = 0
    _kept: tuple[F32, ...] = ()

    def say(self, x: F32, rng: np.random.Generator | None = None) -> F32:
        """Return outputs [T, B, OUTPUTS] for inputs [T, B, INPUTS]; ``rng`` enables dropout, for training."""
        w, (t, b, _) = self.weights, x.shape
        u = w["cell"].shape[1]
        front = np.maximum(x.reshape(t * b, -1) @ w["front"].T + w["front_bias"], 0)
        keep = _kept(rng, front)
        heard = front * keep
        into = (heard @ w["cell_in"].T + w["cell_in_bias"]).reshape(t, b, 3 * u)
        states = np.zeros((t + 1, b, u), np.float32)
        gates, new, held = (
            np.empty((t, b, 2 * u), np.float32),
            np.empty((t, b, u), np.float32),
            np.empty_like(states[1:]),
        )
        cell, bias = np.ascontiguousarray(w["cell"].T), w["cell_bias"]
        for i in range(t):
            own = states[i] @ cell + bias
            gates[i] = 0.5 + 0.5 * np.tanh(0.5 * (into[i][:, : 2 * u] + own[:, : 2 * u]))
            held[i] = own[:, 2 * u :]
            new[i] = np.tanh(into[i][:, 2 * u :] + gates[i][:, :u] * held[i])
            states[i + 1] = new[i] + gates[i][:, u:] * (states[i] - new[i])
        state = states[1:].reshape(t * b, u)
        keep_state = _kept(rng, state)
        told = state * keep_state
        skip = np.maximum(told @ w["skip"].T + w["skip_bias"], 0)
        self._kept = (x, front, keep, heard, gates, held, new, states, keep_state, told, skip)
        return np.asarray((skip @ w["back"].T + w["back_bias"]).reshape(t, b, -1), np.float32)

    def gradient(self, off: F32) -> Weights:
        """Return the gradient of the weights for that of the last outputs, ``off`` [T, B, OUTPUTS]."""
        w = self.weights
        x, front, keep, heard, gates, held, new, states, keep_state, told, skip = self._kept
        t, b, u = new.shape
        flat = off.reshape(t * b, -1)
        of_skip = (flat @ w["back"]) * (skip > 0)
        of_state = ((of_skip @ w["skip"]) * keep_state).reshape(t, b, u)
        of_into, of_own = np.empty((t, b, 3 * u), np.float32), np.empty((t, b, 3 * u), np.float32)
        later = np.zeros((b, u), np.float32)
        for i in range(t - 1, -1, -1):
            later = later + of_state[i]
            reset, update = gates[i][:, :u], gates[i][:, u:]
            of_new = later * (1 - update) * (1 - new[i] * new[i])
            of_update = later * (states[i] - new[i]) * update * (1 - update)
            of_reset = of_new * held[i] * reset * (1 - reset)
            of_into[i] = np.concatenate((of_reset, of_update, of_new), 1)
            of_own[i] = np.concatenate((of_reset, of_update, of_new * reset), 1)
            later = later * update + of_own[i] @ w["cell"]
        into, own = of_into.reshape(t * b, 3 * u), of_own.reshape(t * b, 3 * u)
        of_front = (into @ w["cell_in"]) * keep * (front > 0)
        pairs = (
            (of_front, x.reshape(t * b, -1)),
            (into, heard),
            (own, states[:-1].reshape(t * b, u)),
            (of_skip, told),
            (flat, skip),
        )
        out: Weights = {}
        for name, (behind, before) in zip(ARRAYS[::2], pairs, strict=True):
            out[name], out[f"{name}_bias"] = behind.T @ before, behind.sum(0)
        return out

    def learn(self, gradient: Weights, rate: float) -> None:
        """Take one step of AdamW against the gradient, whose norm is clipped."""
        length = sqrt(sum(float((g * g).sum()) for g in gradient.values()))
        clip = np.float32(min(1.0, CLIP / (length + 1e-6)))
        self.steps += 1
        if not self.means:
            self.means = {name: np.zeros_like(g) for name, g in gradient.items()}
            self.squares = {name: np.zeros_like(g) for name, g in gradient.items()}
        f = np.float32
        for name, g in gradient.items():
            mean, square, weights = self.means[name], self.squares[name], self.weights[name]
            mean += f(1 - MEAN) * (g * clip - mean)
            square += f(1 - SQUARE) * (np.square(g * clip) - square)
            pace = mean / f(1 - MEAN**self.steps) / (np.sqrt(square / f(1 - SQUARE**self.steps)) + f(1e-8))
            self.weights[name] = weights - f(rate) * (pace + f(DECAY) * weights)


def _kept(rng: np.random.Generator | None, like: F32) -> F32:
    """Return a dropout mask, scaled by 1 / (1 - DROP); 1 without ``rng``."""
    if rng is None:
        return np.ones((1, 1), np.float32)
    return np.asarray((rng.random(like.shape, np.float32) > DROP) / np.float32(1 - DROP), np.float32)
