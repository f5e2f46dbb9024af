"""Read back: copy targets to arrays on the host, row 0 first (the top row of the image)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.renderer.stats import Box
from glsplat.renderer.targets import ByteTarget, Target

__all__ = ["read_bytes", "read_depth", "read_floats"]


def read_floats(target: Target, out: NDArray[np.float32]) -> None:
    """Copy all layers to ``out`` [V, H, W, 4]."""
    if target.numpy_dtype == out.dtype:
        target.texture.read_into(out)
        return
    pixels = np.empty(target.shape, target.numpy_dtype)
    target.texture.read_into(pixels)
    np.multiply(pixels, 1 / 255 if target.numpy_dtype == np.uint8 else 1, out=out, dtype=np.float32, casting="unsafe")


def read_depth(target: Target) -> NDArray[np.float32]:
    """Return the expected camera z [V, H, W] in metres, 0 where nothing was drawn."""
    assert target.depth is not None
    colour = np.empty(target.shape, np.float32)
    read_floats(target, colour)
    total = np.frombuffer(target.depth.read(), np.float32).reshape(target.shape[:3])
    alpha = colour[..., 3]
    return np.divide(total, alpha, out=np.zeros_like(total), where=alpha > 0)


def read_bytes(target: ByteTarget, out: NDArray[np.uint8], box: Box) -> None:
    """Copy the pixels of ``box`` of every view into ``out`` [V, H, W, 4] and fill the rest with the background.

    The background is taken from the box's rim (sort.covered_box), as the driver rounded it: no seam.
    """
    views, rows, columns, _ = target.shape
    x, y, width, height = box
    if (width, height) == (columns, rows):
        target.framebuffer.read_into(out, components=4)
        return
    part = np.empty((height, width, 4), np.uint8)
    for view in range(views):
        target.framebuffer.read_into(part, viewport=(x, view * rows + y, width, height), components=4)
        background = part[0, 0] if x or y else part[-1, -1]
        out[view].view(np.uint32).fill(background.copy().view(np.uint32)[0])  # whole pixels: 30 times as fast
        out[view, y : y + height, x : x + width] = part
