"""Write ONNX models: OpenCV's dnn takes no layers from memory.

Messages and field numbers are those of onnx.proto3 (ONNX 1.8, operators of set 13): a message is a sequence of fields,
each a number and a kind, then a varint or a length and bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32

_FLOAT, _INT, _STRING, _INTS = 1, 2, 3, 7  # TensorProto.FLOAT, and kinds of attributes


class Graph:
    """A network, layer by layer, from "picture" [1, 3, H, W] on. Layers return the name of their output."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._count = 0

    def add(self, kind: str, inputs: Sequence[str], **attributes: int | str | Sequence[int]) -> str:
        """Add a layer of ONNX's operator ``kind``."""
        self._count += 1
        name = f"layer{self._count}"
        body = b"".join(_field(1, one) for one in inputs) + _field(2, name) + _field(4, kind)
        for key, value in attributes.items():
            if isinstance(value, int):
                content = _field(3, value) + _field(20, _INT)
            elif isinstance(value, str):
                content = _field(4, value) + _field(20, _STRING)
            else:
                content = b"".join(_field(8, one) for one in value) + _field(20, _INTS)
            body += _field(5, _field(1, key) + content)
        self._parts.append(_field(1, body))
        return name

    def tensor(self, values: NDArray[np.floating]) -> str:
        """Add constants and return their name."""
        self._count += 1
        name = f"tensor{self._count}"
        dims = b"".join(_field(1, extent) for extent in values.shape)
        self._parts.append(
            _field(5, dims + _field(2, _FLOAT) + _field(8, name) + _field(9, values.astype("<f4").tobytes()))
        )
        return name

    def conv(self, picture: str, kernel: F32, bias: F32, stride: int = 1, padding: int = 0, relu: bool = False) -> str:
        """Add a convolution: ``kernel`` [out, in, k, k], ``bias`` [out]; ``relu`` cuts negative values off."""
        constants = self.tensor(kernel), self.tensor(bias)
        side, steps, pads = [kernel.shape[2]] * 2, [stride] * 2, [padding] * 4
        found = self.add("Conv", [picture, *constants], kernel_shape=side, strides=steps, pads=pads)
        return self.add("Relu", [found]) if relu else found

    def max_pool(self, picture: str, side: int, padding: int = 0) -> str:
        """Take the largest values of squares, two pixels apart."""
        return self.add("MaxPool", [picture], kernel_shape=[side] * 2, strides=[2] * 2, pads=[padding] * 4)

    def network(self, shape: tuple[int, int], outputs: Sequence[str]) -> cv2.dnn.Net:
        """Return the network in OpenCV for pictures of ``shape`` (H, W)."""
        graph = b"".join(self._parts) + _field(2, "glsplat") + _value(11, "picture", (1, 3, *shape))
        graph += b"".join(_value(12, name) for name in outputs)
        model = _field(1, 8) + _field(8, _field(2, 13)) + _field(7, graph)
        engine = [cv2.dnn.ENGINE_CLASSIC] if hasattr(cv2.dnn, "ENGINE_CLASSIC") else []  # the one of OpenCV 4
        return cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8), *engine)


def _value(number: int, name: str, shape: tuple[int, ...] = ()) -> bytes:
    dims = b"".join(_field(1, _field(1, extent)) for extent in shape)
    return _field(number, _field(1, name) + _field(2, _field(1, _field(1, _FLOAT) + _field(2, dims))))


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes(out) + bytes([number])
