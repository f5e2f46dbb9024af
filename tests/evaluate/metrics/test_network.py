"""The layers behind LPIPS as books have them, and that leaving out a plain background changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from glsplat.evaluate.metrics import network
from glsplat.evaluate.metrics.layers import Convolution, Layer, Pooling
from glsplat.evaluate.metrics.network import Network


def correlated(picture: np.ndarray, kernel: np.ndarray, bias: np.ndarray, stride: int, padding: int) -> np.ndarray:
    """A convolution as it is written in books, in float64."""
    padded = np.pad(picture.astype(np.float64), ((padding,) * 2, (padding,) * 2, (0, 0)))
    windows = sliding_window_view(padded, kernel.shape[:2], axis=(0, 1))[::stride, ::stride]
    return np.maximum(np.einsum("hwcij,ijco->hwo", windows, kernel.astype(np.float64), optimize=True) + bias, 0)


def convolution(
    rng: np.random.Generator, side: int, inside: int, outside: int, stride: int, padding: int
) -> Convolution:
    kernel = rng.normal(size=(side, side, inside, outside)).astype(np.float32)
    return Convolution(side, stride, padding, kernel, rng.normal(size=outside).astype(np.float32))


@pytest.mark.parametrize(("side", "stride", "padding"), [(3, 1, 1), (5, 1, 2), (11, 4, 2), (1, 1, 0)])
@pytest.mark.parametrize("block", [1 << 20, 2000])
def test_convolution(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, side, stride, padding, block) -> None:
    monkeypatch.setattr("glsplat.evaluate.metrics.layers._BLOCK", block)  # few rows at a time, then all at once
    picture = rng.normal(size=(37, 26, 5)).astype(np.float32)
    layer = convolution(rng, side, 5, 7, stride, padding)
    right = correlated(picture, layer.kernel, layer.bias, stride, padding)
    found = layer(np.pad(picture, ((padding,) * 2, (padding,) * 2, (0, 0))))
    assert found.shape == right.shape and found.dtype == np.float32
    assert found.shape[:2] == (layer.extent(37), layer.extent(26))
    assert found == pytest.approx(right, abs=2e-4)


@pytest.mark.parametrize("side", [2, 3])
def test_pooling(rng: np.random.Generator, side: int) -> None:
    picture = rng.normal(size=(11, 8, 4)).astype(np.float32)
    windows = sliding_window_view(picture, (side, side), axis=(0, 1))[::2, ::2]
    assert (Pooling(side, 2, 0)(picture) == windows.max(axis=(3, 4))).all()


@pytest.mark.parametrize(("side", "stride", "padding"), [(3, 1, 1), (11, 4, 2), (3, 2, 0), (2, 2, 0)])
def test_who_sees_whom(side: int, stride: int, padding: int) -> None:
    """Pixel by pixel along an axis of 23."""
    layer = Layer(side, stride, padding)
    windows = [range(i * stride - padding, i * stride - padding + side) for i in range(layer.extent(23))]
    for first in range(23):
        for last in range(first + 1, 24):
            seeing = [i for i, window in enumerate(windows) if set(window) & set(range(first, last))]
            reach = layer.reach((first, last), 23)
            assert list(range(*reach)) == seeing
            if seeing:
                assert layer.sees(reach) == (windows[seeing[0]][0], windows[seeing[-1]][-1] + 1)


@pytest.mark.parametrize("size", [(64, 64), (61, 50)])
def test_a_plain_background_is_worked_out_once(rng: np.random.Generator, monkeypatch, size) -> None:
    """Things in the middle, at each border and corner, of one pixel and of none, before two colours."""
    layers = [
        convolution(rng, 11, 3, 8, 4, 2),
        Pooling(3, 2, 0),
        convolution(rng, 5, 8, 6, 1, 2),
        Pooling(2, 2, 0),
        convolution(rng, 3, 6, 4, 1, 1),
    ]
    chain = Network(layers, (0, 2, 4))
    calls: list[int] = []
    stages = Network._stages
    monkeypatch.setattr(Network, "_stages", lambda self, picture: (calls.append(1), stages(self, picture))[1])
    height, width = size
    boxes = [(20, 40, 10, 30), (0, 20, 0, 9), (50, height, 30, width), (height - 1, height, 3, 4), (0, height, 20, 25)]
    for colour in (-1.5, 0.25):
        for top, bottom, left, right in [*boxes, (0, 0, 0, 0)]:
            picture = np.full((height, width, 3), colour, np.float32)
            picture[top:bottom, left:right] = rng.normal(size=(bottom - top, right - left, 3))
            picture[0, 0] = colour
            expected = stages(chain, picture)
            found = chain(picture)
            assert len(found) == 3
            for index, values in zip((0, 2, 4), found, strict=True):
                true = expected[index + 1]
                largest = max(100.0, float(abs(true).max()))  # the same sums in another order, single precision
                assert values == pytest.approx(true, abs=1e-6 * largest)
            for values in found:
                values[:] = np.nan  # they are the caller's own
    assert len(calls) == 2
    everywhere = rng.normal(size=(height, width, 3)).astype(np.float32)
    assert (chain(everywhere)[2] == stages(chain, everywhere)[5]).all() and len(calls) == 3
    monkeypatch.setattr(network, "_WORTH", 2.0)
    assert chain(everywhere)[2] == pytest.approx(stages(chain, everywhere)[5], abs=1e-4) and len(calls) == 4
