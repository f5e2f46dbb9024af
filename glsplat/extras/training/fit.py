"""Fit the network to sequences from a pool of disturbed clips, with a loss of distances. Seeded; numpy alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.extras.learned.network import (
    ARRAYS,
    INPUTS,
    OUTPUTS,
    PoseNetwork,
    TrackedFrames,
    network_inputs,
    updated_means,
)
from glsplat.extras.training.clips import TrainingClip, disturbed, targets_of

Weights = dict[str, F32]

DROP = 0.1  # dropout before and after the recurrent layer
DECAY, CLIP = 0.02, 1.0  # weight decay in a step of rate 1; largest norm of the gradient
MEAN, SQUARE = 0.9, 0.999  # decay of the running means of gradients and of their squares

WEIGHTS = np.array((1.0, 1.0, 1.0, 1.3, 1.3, 1.3, 1.3), np.float32)  # of the points
AHEAD, AXES, CONTACT, SMOOTH = 0.35, 0.25, 0.04, 1.0  # weights of the other parts of the loss
BEGINS = 0.25  # share of sequences that start with their clip, with an empty memory
WARM, LEAST = 0.1, 0.04  # share of the steps in which the rate rises; the share of its highest at which it starts

MADE = 0.35  # share of sequences from combined clips
ALIKE = 0.5  # power of a group's hours in its sampling weight: 1 weighs hours equally, 0 persons


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
        gates = np.empty((t, b, 2 * u), np.float32)
        new, held = np.empty((2, t, b, u), np.float32)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingConfig:
    """Size of the network and settings of the fit."""

    width: int = 128  # of the first layer
    units: int = 320  # of the recurrent layer
    steps: int = 3200
    batch: int = 64
    length: int = 100  # ticks of a sequence
    rate: float = 2e-3  # highest learning rate
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Lesson:
    """A clip as a device would track it, and the network's target outputs."""

    clip: TrainingClip
    heard: F32  # [T, INPUTS]
    truth: F32  # [T, OUTPUTS]
    clean: bool  # undisturbed


def features(seen: TrackedFrames, unit: float) -> F32:
    """Return inputs [T, INPUTS] of a sequence [T] from its start."""
    t = len(seen.yaw)
    back = np.maximum(np.arange(t) - 1, 0)
    means = np.empty((t, 3, 2), np.float32)
    now = np.repeat(seen.eye[:1, None, [0, 2]], 3, 1)[0].astype(np.float32)
    for i in range(t):
        means[i] = now = updated_means(now, seen.eye[i])
    before = TrackedFrames(*[getattr(seen, name)[back] for name in TrackedFrames.__slots__])
    return network_inputs(seen, before, means, unit)


def lessons_of(clips: Iterable[TrainingClip], unit: float, rng: np.random.Generator) -> list[Lesson]:
    """Return every clip disturbed, and ``plain`` and ``made`` clips also undisturbed."""
    out = []
    for clip in clips:
        odd, truth = disturbed(clip.seen, rng), targets_of(clip, unit)
        out.append(Lesson(clip, features(odd, unit), _seen_from(truth, clip.seen, odd, unit), False))
        if clip.plain or clip.made:
            out.append(Lesson(clip, features(clip.seen, unit), truth, True))
    return out


def fit(
    lessons: Sequence[Lesson],
    config: TrainingConfig,
    start: PoseNetwork | None = None,
    progress: Callable[[int, float], None] | None = None,
    note: str = "",
) -> PoseNetwork:
    """Return the network fitted to the lessons. ``start``: continue from this network, with its size."""
    rng = np.random.default_rng(config.seed)
    some = np.concatenate([lesson.heard[::7] for lesson in lessons])
    mean, spread = some.mean(0), np.maximum(some.std(0), 0.05).astype(np.float32)
    if start is None:
        weights = started(rng, INPUTS, config.width, config.units, OUTPUTS)
    else:
        weights = start.weights()
        weights["front_bias"] = weights["front_bias"] + weights["front"] @ mean
        weights["front"] = weights["front"] * spread
    learner = Learner(weights)
    share = shares_of([lesson.clip for lesson in lessons])
    for step in range(config.steps):
        x = np.zeros((config.length, config.batch, INPUTS), np.float32)
        y = np.zeros((config.length, config.batch, OUTPUTS), np.float32)
        known = np.zeros((config.length, config.batch), np.float32)
        for b, i in enumerate(rng.choice(len(lessons), config.batch, p=share)):
            lesson = lessons[i]
            size = min(config.length, len(lesson.heard))
            first = 0 if rng.random() < BEGINS else int(rng.integers(0, len(lesson.heard) - size + 1))
            x[:size, b] = (lesson.heard[first : first + size] - mean) / spread
            y[:size, b] = lesson.truth[first : first + size]
            known[: size - 1, b] = 1  # the last tick has no next one
        far, off = loss(learner.say(x, rng), y, known)
        learner.learn(learner.gradient(off), config.rate * _pace(step / config.steps))
        if progress:
            progress(step, far)
    out = learner.weights
    front = (out["front"] / spread).astype(np.float32)  # the first layer includes the normalisation
    out = out | {"front": front, "front_bias": (out["front_bias"] - front @ mean).astype(np.float32)}
    return PoseNetwork(**out, note=note)


def _pace(done: float) -> float:
    """Return the share of the highest rate after ``done`` of the steps: linear up, cosine down (Smith & Topin 2019)."""
    return LEAST + (1 - LEAST) * done / WARM if done < WARM else 0.5 + 0.5 * cos(pi * (done - WARM) / (1 - WARM))


def shares_of(clips: Sequence[TrainingClip]) -> NDArray[np.float64]:
    """Return sampling probabilities of the clips, by their length, their group's, and whether they are ``made``."""
    sizes = np.array([len(clip.points) for clip in clips], np.float64)
    hours: dict[str, float] = {}
    for clip, size in zip(clips, sizes.tolist(), strict=True):
        hours[clip.group] = hours.get(clip.group, 0.0) + size
    share = sizes * [hours[clip.group] ** (ALIKE - 1) for clip in clips]
    made = np.array([clip.made for clip in clips])
    if made.any() and not made.all():
        share[made] *= MADE / share[made].sum()
        share[~made] *= (1 - MADE) / share[~made].sum()
    return np.asarray(share / share.sum())


def _seen_from(truth: F32, clean: TrackedFrames, odd: TrackedFrames, unit: float) -> F32:
    """Transform targets from the clean head's frame to the disturbed head's, as errors of devices move no body."""
    t = len(truth)
    turn = odd.yaw - clean.yaw
    shift = (odd.eye - clean.eye) * np.array([1, 0, 1], np.float32)
    c, s = np.cos(clean.yaw), np.sin(clean.yaw)
    local = np.stack((shift[:, 0] * c - shift[:, 2] * s, np.zeros(t), shift[:, 0] * s + shift[:, 2] * c), -1) / unit
    out = truth.copy()
    points = truth[:, :33].reshape(t, 11, 3) - local[:, None].astype(np.float32)
    axes = truth[:, 33:45].reshape(t, 2, 3, 2)
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    out[:, :33] = np.stack(
        (points[..., 0] * c - points[..., 2] * s, points[..., 1], points[..., 0] * s + points[..., 2] * c), -1
    ).reshape(t, 33)
    c, s = c[..., None], s[..., None]
    x, z = axes[:, :, 0], axes[:, :, 2]
    out[:, 33:45] = np.stack((x * c - z * s, axes[:, :, 1], x * s + z * c), 2).reshape(t, 12)
    return out


def loss(said: F32, truth: F32, known: F32) -> tuple[float, F32]:
    """Return the loss of outputs ``said`` [T, B, OUTPUTS], and its gradient; ``known`` [T, B]: 1 for known ``truth``.

    It sums distances of points, of predicted points, of axes and contacts, and changes of the points' errors in a tick.
    """
    t, b, _ = said.shape
    share = known / known.sum()
    grad = np.zeros_like(said)
    off = (said - truth)[..., :21].reshape(t, b, 7, 3)
    far = np.sqrt((off * off).sum(-1) + 1e-6)
    later = (said - truth)[..., 21:33].reshape(t, b, 4, 3)
    far_later = np.sqrt((later * later).sum(-1) + 1e-6)
    axes = (said - truth)[..., 33:45]
    logit, stands = said[..., 45:], truth[..., 45:]
    doubt = np.maximum(logit, 0) - logit * stands + np.log1p(np.exp(-np.abs(logit)))
    whole = (far * WEIGHTS).mean(-1) + AHEAD * far_later.mean(-1) + AXES * np.abs(axes).mean(-1)
    total = ((whole + CONTACT * doubt.mean(-1)) * share).sum()
    both = known[1:] * known[:-1]
    both = both / both.sum()
    moved = off[1:] - off[:-1]
    pace = np.sqrt((moved * moved).sum(-1) + 1e-8)
    total += SMOOTH * (pace.mean(-1) * both).sum()
    of_moved = moved * (SMOOTH / 7 * both[..., None] / pace)[..., None]
    of_off = off * (WEIGHTS / 7 * share[..., None] / far)[..., None]
    of_off[1:] += of_moved
    of_off[:-1] -= of_moved
    grad[..., :21] = of_off.reshape(t, b, 21)
    grad[..., 21:33] = (later * (AHEAD / 4 * share[..., None] / far_later)[..., None]).reshape(t, b, 12)
    grad[..., 33:45] = np.sign(axes) * (AXES / 12 * share)[..., None]
    grad[..., 45:] = (0.5 + 0.5 * np.tanh(0.5 * logit) - stands) * (CONTACT / 2 * share)[..., None]
    return float(total), grad


def evaluate(network: PoseNetwork, lessons: Sequence[Lesson], unit: float) -> dict[str, float]:
    """Return mean distances of the network's points, cm, and the share of correct contacts."""
    learner = Learner(network.weights())
    errors, right = [], []
    for lesson in lessons:
        said = learner.say(lesson.heard[:, None])[:, 0]
        errors.append(np.linalg.norm((said - lesson.truth)[:, :21].reshape(-1, 7, 3), axis=-1) * unit * 100)
        right.append((said[:, 45:] > 0) == (lesson.truth[:, 45:] > 0.5))
    far = np.concatenate(errors).mean(0)
    return {
        "pelvis": float(far[0]),
        "knees": float(far[1:3].mean()),
        "ankles": float(far[3:5].mean()),
        "feet": float(far[5:].mean()),
        "contact": float(np.concatenate(right).mean()),
    }
