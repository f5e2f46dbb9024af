"""Encode a chain of convolutions as the bytes of an ONNX model for OpenCV's dnn, which cannot take layers as arrays.

Messages and field numbers are those of onnx.proto3 (ONNX 1.8, operators of set 13): a message is a sequence of fields,
each a number and a kind, then a varint or a length and bytes.
"""

from __future__ import annotations

import numpy as np

from .weights import Backbone, Weights

_FLOAT, _INTS = 1, 7  # TensorProto.FLOAT, AttributeProto.INTS


def output(convolution: int) -> str:
    """Return the name of a convolution's output, after its ReLU."""
    return f"seen{convolution}"


def model(weights: Weights, backbone: Backbone) -> bytes:
    """Return the bytes of the model of a backbone, with the input "picture" [1, 3, H, W]."""
    parts, last = [], "picture"
    for index, (kernel, bias) in enumerate(zip(weights.kernels, weights.biases, strict=True)):
        if index in backbone.pooled:
            parts.append(_node("MaxPool", [last], "pooled", index, [backbone.pool] * 2, [2, 2], [0] * 4))
            last = f"pooled{index}"
        stride = 1 if index else backbone.stride
        values = [f"kernel{index}", f"bias{index}"]
        padding = [backbone.padding[index]] * 4
        parts.append(_node("Conv", [last, *values], "sum", index, [len(kernel)] * 2, [stride] * 2, padding))
        parts.append(_field(1, _field(1, f"sum{index}") + _field(2, output(index)) + _field(4, "Relu")))
        parts += [_tensor(values[0], kernel.transpose(3, 2, 0, 1)), _tensor(values[1], bias)]
        last = output(index)
    least = (1, 3, backbone.least, backbone.least)  # OpenCV accepts other sizes, too
    parts += [_field(2, backbone.key), _value(11, "picture", least)]
    parts += [_value(12, output(index)) for index in backbone.seen]
    return _field(1, 8) + _field(8, _field(2, 13)) + _field(7, b"".join(parts))


def _node(
    kind: str, inputs: list[str], name: str, index: int, side: list[int], steps: list[int], pads: list[int]
) -> bytes:
    body = b"".join(_field(1, one) for one in inputs) + _field(2, f"{name}{index}") + _field(4, kind)
    for key, values in (("kernel_shape", side), ("strides", steps), ("pads", pads)):
        body += _field(5, _field(1, key) + b"".join(_field(8, value) for value in values) + _field(20, _INTS))
    return _field(1, body)


def _tensor(name: str, values: np.ndarray) -> bytes:
    dims = b"".join(_field(1, extent) for extent in values.shape)
    return _field(5, dims + _field(2, _FLOAT) + _field(8, name) + _field(9, values.astype("<f4").tobytes()))


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
