"""How far off the network and the analytic solver are to be expected, and what share of the body that gives each."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.npz import read_arrays
from glsplat.tracking.learned.frames import TICK
from glsplat.tracking.learned.signs import SIGNS
from glsplat.tracking.solve.quat import clamp

__all__ = ["PARTS", "SAID", "Share", "Trust", "Weigher", "load_trust", "save_trust"]

F32 = NDArray[np.float32]

PARTS = ("pelvis", "legs")
SAID = 4 * len(PARTS)
"""Numbers out: for each part the logit of the analytic body's share, and logarithms of the distances (metres of a
person whose eyes are at 1.6 m) that the network, the analytic body and the mixture are off by in the mean."""

VERSION = 1
BOUNDS = (0.3, 0.7)  # of a share: errors of two kinds cancel, whoever is believed more
SMOOTH = 0.25  # seconds in which shares follow what is said


@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """A small network of one layer, float32; normalising is part of the layer."""

    front: F32  # [H, SIGNS]
    front_bias: F32  # [H]
    back: F32  # [SAID, H]
    back_bias: F32  # [SAID]

    @staticmethod
    def shares(logits: F32) -> F32:
        """Of the analytic body."""
        low, high = BOUNDS
        return low + (high - low) * (0.5 + 0.5 * np.tanh(0.5 * logits))

    def say(self, signs: F32) -> F32:
        """[..., SAID] from signs [..., SIGNS]."""
        hidden = np.tanh(signs @ self.front.T + self.front_bias)
        return hidden @ self.back.T + self.back_bias


ARRAYS = tuple(Trust.__slots__)


def save_trust(path: str | PathLike[str], trust: Trust) -> None:
    """Write a file (.npz)."""
    with open(path, "wb") as file:
        np.savez(file, version=np.array(VERSION), **{name: getattr(trust, name) for name in ARRAYS})


def load_trust(path: str | PathLike[str]) -> Trust:
    """Read a file and check it whole. Raises FormatError that says what is wrong with it."""
    name = Path(path).name
    try:
        with open(path, "rb") as file:
            known = read_arrays(file, f"{name}: the trust of a tracking model", ("version", *ARRAYS))
    except OSError as error:
        raise FormatError(f"{name}: cannot read the trust of a tracking model ({error.strerror or error})") from None
    if known["version"].shape or known["version"] != VERSION:
        raise FormatError(f"{name}: a trust of version {known['version']}, not {VERSION}; fit it again")
    units = len(known["front_bias"])
    shapes = ((units, SIGNS), (units,), (SAID, units), (SAID,))
    for key, shape in zip(ARRAYS, shapes, strict=True):
        array = known[key]
        if array.shape != shape or array.dtype != np.float32 or not np.isfinite(array).all():
            raise FormatError(f"{name}: {key} is {array.dtype} {array.shape}, not finite float32 {shape}; fit it again")
    return Trust(**{key: known[key] for key in ARRAYS})


@dataclass(slots=True)
class Share:
    """Of one part of the body, at one moment."""

    plain: float  # 0 all of it is the network's .. 1 all of it is the analytic solver's
    expected: float  # metres of a person whose eyes are at 1.6 m that the mixture is off by, in the mean


class Weigher:
    """Shares at the network's rate, smooth in time: no moment flips from one body to the other."""

    def __init__(self, trust: Trust) -> None:
        self.trust = trust
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._since = TICK
        self._at: list[float] = []
        self._goal: list[float] = []
        self.expected = [0.0] * len(PARTS)

    def due(self, dt: float) -> bool:
        """Whether new signs are wanted, ``dt`` seconds after the last moment."""
        self._since += dt
        return self._since >= TICK - 1e-6

    def update(self, signs: list[float] | None, dt: float) -> list[Share]:
        """The shares of PARTS; ``signs`` where they are ``due``."""
        if signs is not None:
            self._since = min(self._since - TICK, TICK)
            said = self.trust.say(np.array(signs, np.float32))
            self._goal = self.trust.shares(said[::4]).tolist()
            self.expected = [exp(clamp(v, -9.0, 3.0)) for v in said[3::4].tolist()]
        if not self._at:
            self._at = self._goal
        k = 1 - exp(-dt / SMOOTH)
        self._at = [a + (goal - a) * k for a, goal in zip(self._at, self._goal, strict=True)]
        return [Share(a, e) for a, e in zip(self._at, self.expected, strict=True)]
