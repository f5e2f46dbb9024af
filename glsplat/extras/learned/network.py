"""The network: a layer, a gated recurrent unit, two layers; its inputs and outputs, and its checked file.

Inputs and outputs are in the head's yaw frame and in eye heights; training and run time share this code. No number
depends on the position or direction in the room. Lengths are in units of the body's eye height divided by 1.6 (metres
of a person whose eyes are at 1.6 m), so that one network serves bodies of every size. Arrays have a leading axis N:
frames of a clip in training, one frame at run time.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.errors import FormatError
from glsplat.extras.formats.npz import read_arrays

RATE_HZ = 30.0  # of the network, whatever the samples' rate
TICK_S = 1 / RATE_HZ
MEAN_S = (0.3, 1.0, 3.0)  # time constants of the running means of the head's position
HAND_INPUTS = 13  # tracked, position, two axes, velocity

INPUTS = 1 + 6 + 3 + 1 + 2 * len(MEAN_S) + 2 * HAND_INPUTS
"""Numbers in: eye height, two axes of the head, its velocity, its turning, its recent positions, two hands."""

POINTS = ("pelvis", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_foot", "right_foot")
OUTPUTS = 3 * len(POINTS) + 12 + 12 + 2
"""Numbers out: POINTS, ankles and feet one tick ahead, two axes of pelvis and chest, logits of both feet's contact."""

VERSION = 1  # version of the file and of the network's inputs and outputs; others are refused

MAX_WIDTH = 1024  # of layers and state


@dataclass(slots=True)
class TrackedFrames:
    """Head and hands in N frames, in the world, metres; rotations are those of the joints (SMPL-X rest frames)."""

    eye: F32  # [N, 3] between the eyes, the ground at y = 0
    yaw: F32  # [N] heading of the head, radians about y
    head: F32  # [N, 3, 3]
    at: F32  # [N, 2, 3] wrists, left and right; anything where not tracked
    hand: F32  # [N, 2, 3, 3]
    tracked: F32  # [N, 2] 0 or 1


@dataclass(slots=True)
class NetworkOutput:
    """The estimated body in N frames, in the head's yaw frame: origin below the eyes, metres."""

    points: F32  # [N, 7, 3] POINTS
    ahead: F32  # [N, 4, 3] ankles and feet one tick later, in the present yaw frame
    pelvis: F32  # [N, 3, 2] x and z axes of the pelvis, columns; not quite orthonormal
    chest: F32  # [N, 3, 2]
    contact: F32  # [N, 2] logits: above 0 the foot stands

    @classmethod
    def of(cls, numbers: F32, unit: float) -> NetworkOutput:
        """Return the parts of [N, OUTPUTS]."""
        n = len(numbers)
        points = numbers[:, :21].reshape(n, 7, 3) * unit
        ahead = numbers[:, 21:33].reshape(n, 4, 3) * unit
        axes = numbers[:, 33:45].reshape(n, 2, 3, 2)
        return cls(points, ahead, axes[:, 0], axes[:, 1], numbers[:, 45:])


def unit_of(eye_height: float) -> float:
    """Return the network's unit of length in metres."""
    return eye_height / 1.6


def in_yaw_frame(vectors: F32, yaw: F32) -> F32:
    """Transform world vectors [N, ..., 3] to the frames turned by ``yaw`` [N] about y."""
    shape = (-1,) + (1,) * (vectors.ndim - 2)
    c, s = np.cos(yaw).reshape(shape), np.sin(yaw).reshape(shape)
    x, z = vectors[..., 0], vectors[..., 2]
    return np.stack((x * c - z * s, vectors[..., 1], x * s + z * c), -1)


def yaw_of(head: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the headings [N] of rotations [N, 3, 3]: their twist about y; undefined upside down."""
    return np.arctan2(head[..., 0, 2] - head[..., 2, 0], head[..., 0, 0] + head[..., 2, 2])


def updated_means(means: F32, eye: F32) -> F32:
    """Update running means [..., 3, 2] of the head's position over the ground by one tick with ``eye`` [..., 3]."""
    k = np.array([1 - np.exp(-TICK_S / tau) for tau in MEAN_S], np.float32)[:, None]
    return means + (eye[..., None, [0, 2]] - means) * k


def network_inputs(now: TrackedFrames, before: TrackedFrames, means: F32, unit: float) -> F32:
    """Return inputs [N, INPUTS] of these frames, those one tick earlier, and the running means [N, 3, 2]."""
    n, yaw = len(now.yaw), now.yaw
    k = 1 / unit
    turned = (yaw - before.yaw + np.pi) % (2 * np.pi) - np.pi
    velocity = in_yaw_frame(now.eye - before.eye, yaw) * (k * RATE_HZ)
    away = np.zeros((n, len(MEAN_S), 3), np.float32)
    away[..., [0, 2]] = means - now.eye[:, None, [0, 2]]
    axes = in_yaw_frame(now.head[:, :, [1, 2]].transpose(0, 2, 1), yaw)
    mask = now.tracked[..., None]
    place = in_yaw_frame(now.at - now.eye[:, None], yaw) * (k * mask)
    moved = in_yaw_frame(now.at - before.at, yaw) * (k * RATE_HZ * mask * before.tracked[..., None])
    hands = in_yaw_frame(now.hand[..., [1, 2]].transpose(0, 1, 3, 2).reshape(n, 4, 3), yaw).reshape(n, 2, 6) * mask
    return np.concatenate(
        (
            now.eye[:, 1:2] * k,
            axes.reshape(n, 6),
            velocity,
            turned[:, None] * RATE_HZ * 0.2,
            in_yaw_frame(away, yaw)[..., [0, 2]].reshape(n, -1) * k,
            np.concatenate((mask, place, hands, moved * 0.5), -1).reshape(n, -1),
        ),
        -1,
        dtype=np.float32,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PoseNetwork:
    """Weights, float32, for inputs of ``network_inputs``; the first layer includes the normalisation.

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
