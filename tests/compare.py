"""Image comparison: the gates of docs/conventions.md."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

AS_ON_A_GPU = bool(os.environ.get("GLSPLAT_TESTS_AS_ON_A_GPU"))
"""The renderers of fixtures choose as on a GPU: 16F targets, instanced quads, the GPU sorter (test_drivers.py)."""


@dataclass(frozen=True)
class Difference:
    psnr: float
    mean: float
    maximum: float
    beyond: float  # share of pixels with a channel off by more than 1/255

    @classmethod
    def of(cls, image: NDArray[np.floating], expected: NDArray[np.floating]) -> Difference:
        assert image.shape == expected.shape
        error = np.abs(image.astype(np.float64) - expected)
        mse = float((error[..., :3] ** 2).mean())
        return cls(
            psnr=float(-10 * np.log10(max(mse, 1e-30))),
            mean=float(error.mean()),
            maximum=float(error.max()),
            beyond=float((error.max(axis=-1) > 1 / 255).mean()),
        )


def assert_contract(image: NDArray[np.floating], expected: NDArray[np.floating]) -> None:
    """The gate of a 32F target against the float64 contract; as on a GPU that of 16F, its default."""
    d = Difference.of(image, expected)
    if AS_ON_A_GPU:
        assert d.psnr >= 50, d
        return
    assert d.psnr >= 65 and d.mean <= 1e-4 and d.beyond <= 0.003 and d.maximum <= 0.06, d
