"""LPIPS v0.1 (Zhang et al. 2018): the distance of two pictures in the features of a recognition network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.models.store import path_of
from glsplat.extras.authoring.networks.onnx import Graph

from .pixels import checked
from .weights import BACKBONES, Backbone, Weights, read_weights

_SHIFT = np.array([-0.030, -0.088, -0.188])  # of pictures in [-1, 1], as the networks were trained
_SCALE = np.array([0.458, 0.448, 0.450])


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
