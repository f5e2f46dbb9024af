"""The network: a layer, a gated recurrent unit, two layers; and its checked file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.arrays import F32
from glsplat.errors import FormatError
from glsplat.extras.formats.npz import read_arrays
from glsplat.extras.learned.frames import INPUTS, OUTPUTS, RATE_HZ

VERSION = 1
"""Version of the file and of the network's inputs and outputs (``frames.py``); others are refused."""

MAX_WIDTH = 1024  # of layers and state


@dataclass(frozen=True, slots=True, eq=False)
class PoseNetwork:
    """Weights, float32, for inputs of ``frames.network_inputs``; the first layer includes the normalisation.

    GRU as in Cho et al. 2014 with the reset gate after the product (PyTorch's and cuDNN's form).
    """

    front: F32  # [W, INPUTS]
    front_bias: F32  # [W]
    cell_in: F32  # [3 U, W] reset, update, new
    cell_in_bias: F32  # [3 U]
    cell: F32  # [3 U, U]
    cell_bias: F32  # [3 U]
    skip: F32  # [W, U]
    skip_bias: F32  # [W]
    back: F32  # [OUTPUTS, W]
    back_bias: F32  # [OUTPUTS]
    note: str = ""  # its training data

    @property
    def units(self) -> int:
        """Size of the state."""
        return self.cell.shape[1]

    def weights(self) -> dict[str, F32]:
        """Return the arrays by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    def start(self) -> F32:
        """Return the first state [U] of a user."""
        return np.zeros(self.units, np.float32)

    def step(self, inputs: F32, state: F32) -> tuple[F32, F32]:
        """Return outputs [OUTPUTS] and the next state, from inputs [INPUTS] and the last state."""
        u = self.units
        x = np.maximum(self.front @ inputs + self.front_bias, 0)
        a, b = self.cell_in @ x + self.cell_in_bias, self.cell @ state + self.cell_bias
        # the logistic function as a tanh: finite for numbers of any size
        gates = 0.5 + 0.5 * np.tanh(0.5 * (a[: 2 * u] + b[: 2 * u]))
        new = np.tanh(a[2 * u :] + gates[:u] * b[2 * u :])
        state = new + gates[u:] * (state - new)
        return self.back @ np.maximum(self.skip @ state + self.skip_bias, 0) + self.back_bias, state


ARRAYS = tuple(name for name in PoseNetwork.__slots__ if name != "note")


def save_network(path: str | PathLike[str], network: PoseNetwork) -> None:
    """Write a model file (.npz)."""
    arrays: dict[str, Any] = {**network.weights()}
    with open(path, "wb") as file:
        np.savez(
            file,
            version=np.array(VERSION),
            rate=np.array(RATE_HZ),
            note=np.array(network.note),
            sha256=np.array(_hash(arrays)),
            **arrays,
        )


@lru_cache(maxsize=1)
def embedded_network() -> PoseNetwork:
    """Return the package's network; docs/tracking.md names its training data.

    Raises FormatError if the file is damaged.
    """
    with resources.as_file(resources.files("glsplat.extras.learned") / "network.npz") as path:
        return load_network(path)


def load_network(path: str | PathLike[str]) -> PoseNetwork:
    """Read and check a model file. Raises FormatError naming the mistake."""
    name = Path(path).name
    try:
        with open(path, "rb") as file:
            known = read_arrays(
                file, f"{name}: a tracking model", ("version", "rate", "sha256", *ARRAYS), optional=("note",)
            )
    except OSError as error:
        raise FormatError(f"{name}: cannot read the tracking model ({error.strerror or error})") from None
    if known["version"].shape or known["version"] != VERSION or known["rate"] != RATE_HZ:
        raise FormatError(f"{name}: a tracking model of version {known['version']}, not {VERSION}; train it again")
    arrays = {key: known[key] for key in ARRAYS}
    if wrong := _misshapen(arrays):
        raise FormatError(f"{name}: a tracking model whose {wrong}; train it again")
    if str(known["sha256"]) != _hash(arrays):
        raise FormatError(f"{name}: the tracking model is damaged (its numbers do not fit its checksum)")
    return PoseNetwork(**arrays, note=str(known.get("note", "")))


def _misshapen(arrays: dict[str, F32]) -> str:
    """Return the first mistake in shapes and types, "" without one."""
    width, units = arrays["front"].shape[:1], arrays["cell"].shape[1:]
    if not (len(width) == len(units) == 1 and 1 <= width[0] <= MAX_WIDTH and 1 <= units[0] <= MAX_WIDTH):
        return f"layers have shapes {arrays['front'].shape} and {arrays['cell'].shape}"
    w, u = width[0], units[0]
    shapes = ((w, INPUTS), (w,), (3 * u, w), (3 * u,), (3 * u, u), (3 * u,), (w, u), (w,), (OUTPUTS, w), (OUTPUTS,))
    for (key, array), shape in zip(arrays.items(), shapes, strict=True):
        if array.shape != shape or array.dtype != np.float32:
            return f"{key} is {array.dtype} {array.shape}, not float32 {shape}"
        if not np.isfinite(array).all():
            return f"{key} is not finite"
    return ""


def _hash(arrays: dict[str, F32]) -> str:
    whole = hashlib.sha256()
    for key in ARRAYS:
        whole.update(key.encode())
        whole.update(np.ascontiguousarray(arrays[key]).astype("<f4", copy=False).tobytes())
    return whole.hexdigest()
