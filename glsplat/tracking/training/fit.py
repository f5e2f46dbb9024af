"""The fit itself, in PyTorch: sequences drawn at random, disturbed, and a loss of distances. Seeded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.tracking.learned.frames import INPUTS, OUTPUTS, TrackedFrames, inputs_of, slower
from glsplat.tracking.learned.network import PoseNetwork
from glsplat.tracking.training.clips import TrainingClip, targets_of
from glsplat.tracking.training.disturbed import disturbed

__all__ = ["TrainingConfig", "evaluate", "fit", "network_of", "shares_of"]

F32 = NDArray[np.float32]

WEIGHTS = (1.0, 1.0, 1.0, 1.3, 1.3, 1.3, 1.3)  # of the points
AHEAD, AXES, CONTACT, SMOOTH = 0.35, 0.25, 0.04, 1.0  # of the other parts of the loss


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingConfig:
    """What is fitted, and for how long."""

    width: int = 128  # of the layer in front
    units: int = 320  # of the recurrent layer
    steps: int = 3200
    batch: int = 48
    length: int = 200  # ticks of a sequence
    rate: float = 2e-3  # of learning, at its highest
    seed: int = 0


MADE = 0.35  # of the sequences that are of clips made of parts of several
ALIKE = 0.5  # power of a group's hours by which it is drawn: 1 would draw every hour alike, 0 everybody


def _torch() -> Any:
    try:
        import torch
    except ImportError:
        raise GlsplatError("training needs PyTorch; install it with: pip install 'glsplat[train]'") from None
    return torch


def module(config: TrainingConfig) -> Any:
    """The network as PyTorch has it."""
    torch = _torch()

    class Net(torch.nn.Module):  # type: ignore[name-defined, misc]
        def __init__(self) -> None:
            super().__init__()
            self.front = torch.nn.Linear(INPUTS, config.width)
            self.cell = torch.nn.GRU(config.width, config.units, batch_first=True)
            self.skip = torch.nn.Linear(config.units, config.width)
            self.back = torch.nn.Linear(config.width, OUTPUTS)
            self.drop = torch.nn.Dropout(0.1)

        def forward(self, x: Any) -> Any:
            out, _ = self.cell(self.drop(torch.relu(self.front(x))))
            return self.back(torch.relu(self.skip(self.drop(out))))

    return Net()


def features(seen: TrackedFrames, unit: float) -> F32:
    """[B, T, INPUTS] of sequences [B, T] that begin with their first moment."""
    b, t = seen.yaw.shape
    back = np.maximum(np.arange(t) - 1, 0)
    means = np.empty((b, t, 3, 2), np.float32)
    now = np.repeat(seen.eye[:, :1, [0, 2]], 3, 1).astype(np.float32)
    for i in range(t):
        means[:, i] = now = slower(now, seen.eye[:, i])
    flat = {name: getattr(seen, name) for name in TrackedFrames.__slots__}
    one = TrackedFrames(**{name: a.reshape(b * t, *a.shape[2:]) for name, a in flat.items()})
    before = TrackedFrames(**{name: a[:, back].reshape(b * t, *a.shape[2:]) for name, a in flat.items()})
    return inputs_of(one, before, means.reshape(b * t, 3, 2), unit).reshape(b, t, INPUTS)


def _alone(seen: TrackedFrames) -> TrackedFrames:
    return TrackedFrames(*[getattr(seen, name)[None] for name in TrackedFrames.__slots__])


def fit(
    clips: Sequence[TrainingClip],
    unit: float,
    config: TrainingConfig,
    progress: Callable[[int, float], None] | None = None,
) -> tuple[Any, F32, F32]:
    """The network, and mean and spread [INPUTS] by which its inputs are normalised."""
    torch = _torch()

    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    mean, spread = _normal(clips, unit)
    truths = [targets_of(clip, unit) for clip in clips]
    share = shares_of(clips)
    net = module(config)
    best = torch.optim.AdamW(net.parameters(), lr=config.rate, weight_decay=0.02)
    plan = torch.optim.lr_scheduler.OneCycleLR(best, config.rate, total_steps=config.steps, pct_start=0.1)
    net.train()
    for step in range(config.steps):
        drawn = []
        y = np.zeros((config.batch, config.length, OUTPUTS), np.float32)
        known = np.zeros((config.batch, config.length), np.float32)
        for b, i in enumerate(rng.choice(len(clips), config.batch, p=share)):
            seen, whole = clips[i].seen, len(clips[i].points)
            size = min(config.length, whole)
            first = int(rng.integers(0, whole - size + 1))
            part = slice(first, first + size)
            cut = TrackedFrames(*[getattr(seen, name)[part] for name in TrackedFrames.__slots__])
            odd = disturbed(cut, rng)
            drawn.append(odd)
            y[b, :size] = _seen_from(truths[i][part], cut, odd, unit)
            known[b, :size] = 1
            known[b, size - 1] = 0  # what is ahead of the last moment is not known
        x = (features(_stacked(drawn, config.length), unit) - mean) / spread
        loss = _loss(net(torch.from_numpy(x)), torch.from_numpy(y), torch.from_numpy(known))
        best.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        best.step()
        plan.step()
        if progress:
            progress(step, float(loss.detach()))
    return net.eval(), mean, spread


def shares_of(clips: Sequence[TrainingClip]) -> NDArray[np.float64]:
    """How often each clip is drawn: by its length, its group's, and whether it is made of several; sum 1."""
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


def _stacked(drawn: Sequence[TrackedFrames], length: int) -> TrackedFrames:
    """[B, length] of sequences that may be shorter: the last moment is repeated."""
    keep = [np.minimum(np.arange(length), len(seen.yaw) - 1) for seen in drawn]
    return TrackedFrames(
        *[np.stack([getattr(s, name)[k] for s, k in zip(drawn, keep, strict=True)]) for name in TrackedFrames.__slots__]
    )


def _seen_from(truth: F32, clean: TrackedFrames, odd: TrackedFrames, unit: float) -> F32:
    """Targets in the frame of the clean head, in that of the disturbed one: devices are off, bodies are not."""
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


def _loss(said: Any, truth: Any, known: Any) -> Any:
    torch = _torch()

    b, t = known.shape
    weights = torch.tensor(WEIGHTS)
    off = said[..., :21].reshape(b, t, 7, 3) - truth[..., :21].reshape(b, t, 7, 3)
    far = (off.square().sum(-1) + 1e-6).sqrt()
    later = said[..., 21:33].reshape(b, t, 4, 3) - truth[..., 21:33].reshape(b, t, 4, 3)
    later = (later.square().sum(-1) + 1e-6).sqrt()
    axes = (said[..., 33:45] - truth[..., 33:45]).abs()
    contact = torch.nn.functional.binary_cross_entropy_with_logits(said[..., 45:], truth[..., 45:], reduction="none")
    both = known[:, 1:] * known[:, :-1]
    moved = ((off[:, 1:] - off[:, :-1]).square().sum(-1) + 1e-8).sqrt().mean(-1)
    whole = (far * weights).mean(-1) + AHEAD * later.mean(-1) + AXES * axes.mean(-1) + CONTACT * contact.mean(-1)
    return (whole * known).sum() / known.sum() + SMOOTH * (moved * both).sum() / both.sum()


def _normal(clips: Sequence[TrainingClip], unit: float) -> tuple[F32, F32]:
    every = np.concatenate([features(_alone(clip.seen), unit)[0, ::7] for clip in clips])
    return every.mean(0), np.maximum(every.std(0), 0.05).astype(np.float32)


def evaluate(net: Any, mean: F32, spread: F32, clips: Sequence[TrainingClip], unit: float) -> dict[str, float]:
    """Mean distances in cm of the undisturbed clips, point by point, by what the network alone says."""
    torch = _torch()

    errors, right = [], []
    with torch.no_grad():
        for clip in clips:
            said = net(torch.from_numpy((features(_alone(clip.seen), unit) - mean) / spread))[0].numpy()
            truth = targets_of(clip, unit)
            errors.append(np.linalg.norm((said - truth)[:, :21].reshape(-1, 7, 3), axis=-1) * unit * 100)
            right.append((said[:, 45:] > 0) == (truth[:, 45:] > 0.5))
    far = np.concatenate(errors).mean(0)
    return {
        "pelvis": float(far[0]),
        "knees": float(far[1:3].mean()),
        "ankles": float(far[3:5].mean()),
        "feet": float(far[5:].mean()),
        "contact": float(np.concatenate(right).mean()),
    }


def network_of(net: Any, mean: F32, spread: F32, note: str = "") -> PoseNetwork:
    """What runs without PyTorch; normalising goes into the first layer."""
    w = {key: value.detach().numpy().astype(np.float32) for key, value in net.state_dict().items()}
    front = w["front.weight"] / spread
    return PoseNetwork(
        np.ascontiguousarray(front, np.float32),
        (w["front.bias"] - front @ mean).astype(np.float32),
        w["cell.weight_ih_l0"],
        w["cell.bias_ih_l0"],
        w["cell.weight_hh_l0"],
        w["cell.bias_hh_l0"],
        w["skip.weight"],
        w["skip.bias"],
        w["back.weight"],
        w["back.bias"],
        note,
    )
