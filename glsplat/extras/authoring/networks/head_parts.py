"""Tell hair, hat, ears, skin and cloth of a head apart by BiSeNet (Yu et al. 2018), trained on CelebAMask-HQ."""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.extras.authoring.models import catalogue, store

from .face import Face
from .network import Crop
from .onnx import Graph
from .torch_file import read_tensors

MISSING = "hair is found by its colours; 'glsplat models get hair' downloads a network that finds it better"

_INPUT_PX = 512  # side of the network's input
_MEAN, _DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])  # of the training pictures
_NORM_EPSILON = 1e-5
_MIN_PRESENCE = 0.5  # of a face
_CROP_FACES, _CROP_DOWN = 2.7, 0.1  # of the face: side of the input, and its shift down

_lock = Lock()  # a network of OpenCV serves one thread at a time


class HeadPart(IntEnum):
    """Labels of the network that are used here."""

    BACKGROUND = 0
    SKIN = 1
    LEFT_EAR = 7
    RIGHT_EAR = 8
    CLOTH = 16
    HAIR = 17
    HAT = 18


def available() -> bool:
    """Return whether the network is on this machine."""
    return store.state_of(catalogue.HAIR.models[0]) == "here"


def head_parts(picture: NDArray[np.uint8], face: Face) -> NDArray[np.uint8] | None:
    """Return a ``HeadPart`` or another label of the network for each pixel [H, W]; background far from the face.

    None without the network, and without a face.
    """
    if face.presence < _MIN_PRESENCE or not available():
        return None
    eyes = face.points[263, :2] - face.points[33, :2]
    crop = Crop.around(face.points[:, :2], float(np.arctan2(eyes[1], eyes[0])), _CROP_FACES, -_CROP_DOWN)
    values = (crop.cut(picture, _INPUT_PX) / 255 - _MEAN) / _DEVIATION
    with _lock:
        network = _network()
        network.setInput(np.ascontiguousarray(values.astype(np.float32).transpose(2, 0, 1)[None]))
        found: F32 = network.forward()[0]
    large = [cv2.resize(one, (_INPUT_PX, _INPUT_PX), interpolation=cv2.INTER_LINEAR) for one in found]
    labels = np.argmax(large, axis=0).astype(np.float32)
    return crop.paste(labels, picture.shape[:2], cv2.INTER_NEAREST).astype(np.uint8)


@lru_cache(maxsize=1)
def _network() -> Any:
    weights = read_tensors(store.path_of(catalogue.HAIR.models[0].name))
    graph = Graph()

    def conv(picture: str, name: str, norm: str = "", stride: int = 1, relu: bool = False) -> str:
        """Add a convolution without bias, and the normalisation behind it."""
        kernel = weights[f"{name}.weight"]
        bias = np.zeros_like(kernel[:, 0, 0, 0])
        if norm:
            scale = weights[f"{norm}.weight"] / np.sqrt(weights[f"{norm}.running_var"] + _NORM_EPSILON)
            bias = weights[f"{norm}.bias"] - weights[f"{norm}.running_mean"] * scale
            kernel = kernel * scale[:, None, None, None]
        return graph.conv(picture, kernel, bias, stride, kernel.shape[2] // 2, relu)

    def unit(picture: str, name: str) -> str:
        return conv(picture, f"{name}.conv", f"{name}.bn", relu=True)

    def residual(picture: str, name: str, stride: int) -> str:
        inner = conv(picture, f"{name}.conv1", f"{name}.bn1", stride, relu=True)
        inner = conv(inner, f"{name}.conv2", f"{name}.bn2")
        if f"{name}.downsample.0.weight" in weights:
            picture = conv(picture, f"{name}.downsample.0", f"{name}.downsample.1", stride)
        return graph.add("Relu", [graph.add("Add", [picture, inner])])

    def refined(picture: str, name: str) -> str:
        inner = unit(picture, f"{name}.conv")
        weight = conv(graph.add("GlobalAveragePool", [inner]), f"{name}.conv_atten", f"{name}.bn_atten")
        return graph.add("Mul", [inner, graph.add("Sigmoid", [weight])])

    twice = graph.tensor(np.array([1, 1, 2, 2]))

    def enlarged(picture: str) -> str:
        how = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        return graph.add("Resize", [picture, "", twice], **how)

    top = graph.max_pool(conv("picture", "cp.resnet.conv1", "cp.resnet.bn1", 2, relu=True), 3, 1)
    levels = []
    for layer in range(1, 5):
        for number in range(2):
            top = residual(top, f"cp.resnet.layer{layer}.{number}", 2 if layer > 1 and number == 0 else 1)
        levels.append(top)
    whole = unit(graph.add("GlobalAveragePool", [levels[3]]), "cp.conv_avg")
    context = unit(enlarged(graph.add("Add", [refined(levels[3], "cp.arm32"), whole])), "cp.conv_head32")
    context = unit(enlarged(graph.add("Add", [refined(levels[2], "cp.arm16"), context])), "cp.conv_head16")
    fused = unit(graph.add("Concat", [levels[1], context], axis=1), "ffm.convblk")
    weight = conv(graph.add("GlobalAveragePool", [fused]), "ffm.conv1", relu=True)
    weight = graph.add("Sigmoid", [conv(weight, "ffm.conv2")])
    fused = graph.add("Add", [graph.add("Mul", [fused, weight]), fused])
    outcome = conv(unit(fused, "conv_out.conv"), "conv_out.conv_out")
    return graph.network((_INPUT_PX, _INPUT_PX), [outcome])
