"""What the two bodies are off by, learned from people whom their network has not seen: the fit of ``Trust``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.learned.signs import SIGNS
from glsplat.tracking.learned.trust import BOUNDS, PARTS, SAID, Trust
from glsplat.tracking.training.fit import torch_or_error

__all__ = ["Watched", "fit_trust", "shares_and_errors"]

F32 = NDArray[np.float32]

HIDDEN, STEPS, BATCH, RATE = 12, 500, 1024, 4e-3
DROP, DECAY, NOISE = 0.1, 0.1, 0.4  # of signs and hidden numbers, of weights, of normalised signs
DOUBT = 0.1  # of the loss: what is expected, beside what comes of it


@dataclass(slots=True)
class Watched:
    """One motion of somebody whom the network has not learned from, tick by tick; metres of eyes at 1.6 m."""

    group: str  # whose it is
    signs: F32  # [T, SIGNS]
    learned: F32  # [T, 3, 3] pelvis, balls of the feet as the network has them
    plain: F32  # [T, 3, 3] as the analytic solver has them
    truth: F32  # [T, 3, 3]


def fit_trust(watched: Sequence[Watched], seed: int = 0) -> Trust:
    """Shares that make the mixture's mean distance least, and the distances that are to be expected. Seeded."""
    torch = torch_or_error()
    torch.manual_seed(seed)
    signs, learned, plain, truth = (
        torch.from_numpy(np.concatenate([getattr(w, name) for w in watched]))
        for name in ("signs", "learned", "plain", "truth")
    )
    mean, spread = signs.mean(0), signs.std(0).clamp_min(0.02)
    signs = (signs - mean) / spread
    sizes: dict[str, int] = {}
    for one in watched:
        sizes[one.group] = sizes.get(one.group, 0) + len(one.signs)
    # everybody counts, whether they were captured for a minute or for ten
    worth = torch.from_numpy(
        np.concatenate([np.full(len(w.signs), sizes[w.group] ** -0.5, np.float32) for w in watched])
    )
    front, back = torch.nn.Linear(SIGNS, HIDDEN), torch.nn.Linear(HIDDEN, SAID)
    drop = torch.nn.Dropout(DROP)
    best = torch.optim.AdamW([*front.parameters(), *back.parameters()], lr=RATE, weight_decay=DECAY)
    plan = torch.optim.lr_scheduler.OneCycleLR(best, RATE, total_steps=STEPS, pct_start=0.1)
    for _ in range(STEPS):
        drawn = torch.multinomial(worth, BATCH, replacement=True)
        seen = signs[drawn] + NOISE * torch.randn(BATCH, SIGNS)
        said = back(drop(torch.tanh(front(seen))))
        loss = _loss(torch, said, learned[drawn], plain[drawn], truth[drawn])
        best.zero_grad()
        loss.backward()
        best.step()
        plan.step()
    w, b = front.weight / spread, front.bias - (front.weight / spread) @ mean
    return Trust(*[a.detach().numpy().astype(np.float32) for a in (w, b, back.weight, back.bias)])


def _loss(torch: Any, said: Any, learned: Any, plain: Any, truth: Any) -> Any:
    whole = 0.0
    for i, part in enumerate((slice(0, 1), slice(1, 3))):
        logit, *expected = said[:, len(said[0]) // len(PARTS) * i :][:, :4].T
        share = (BOUNDS[0] + (BOUNDS[1] - BOUNDS[0]) * torch.sigmoid(logit))[:, None, None]
        a, b, goal = learned[:, part], plain[:, part], truth[:, part]
        off = [(p - goal).norm(dim=-1).mean(-1) for p in (a, b, a + share * (b - a))]
        whole = whole + off[2].mean()
        for far, log in zip(off, expected, strict=True):  # least where exp(log) is the mean of what comes
            whole = whole + DOUBT * (far.detach() * torch.exp(-log) + log).mean()
    return whole


def shares_and_errors(trust: Trust, watched: Watched) -> tuple[F32, F32, F32]:
    """Of PARTS: shares [T, P]; what is off [T, P, 3] by the network, the analytic body and their mixture; expected."""
    said = trust.say(watched.signs).reshape(-1, len(PARTS), 4)
    shares = trust.shares(said[..., 0])
    off = []
    for i, part in enumerate((slice(0, 1), slice(1, 3))):
        a, b, goal = watched.learned[:, part], watched.plain[:, part], watched.truth[:, part]
        bodies = (a, b, a + shares[:, i, None, None] * (b - a))
        off.append(np.stack([np.linalg.norm(p - goal, axis=-1).mean(-1) for p in bodies], -1))
    return shares, np.stack(off, 1), np.exp(said[..., 1:])
