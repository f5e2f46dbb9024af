"""Convert pictures: premultiplied to straight alpha, sRGB to linear light and back."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import colour
from glsplat.errors import GlsplatError

__all__ = ["lifted", "straight", "to_linear", "to_srgb"]

Depth = TypeVar("Depth", np.uint8, np.float32)
Float = TypeVar("Float", np.float32, np.float64)


def straight(image: NDArray[Depth], background: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[Depth]:
    """Return a copy of the picture with straight alpha, as PNG files and image libraries expect it.

    ``image`` is [..., 4] RGBA as ``render()`` returns it, uint8 or float32: colour times alpha, plus the camera's
    ``background`` [3] (0 to 1) times 1 - alpha. The background is subtracted and the rest divided by alpha, so that
    compositing the result over the same background restores the picture. Alpha is unchanged; where it is 0, RGB is 0.
    uint8 is rounded and clamped to 0..255, float32 is neither. Raises GlsplatError for other arrays.

    >>> glsplat.straight(np.array([[100, 50, 0, 128]], np.uint8)).tolist()
    [[199, 100, 0, 128]]
    """
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.float32) or image.shape[-1:] != (4,):
        found = f"{image.dtype} of {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise GlsplatError(f"straight() takes uint8 or float32 pictures [..., 4] as render() returns them, not {found}")
    behind = np.array(colour(background, "a background", GlsplatError))
    alpha, full = image[..., 3:], 1.0
    if image.dtype == np.uint8:
        # float64, so that halves round exactly
        alpha, full = alpha.astype(np.float64), 255.0
    with np.errstate(all="ignore"):
        rgb = (image[..., :3] - (behind * (full - alpha)).astype(alpha.dtype)) * full / alpha
    if image.dtype == np.uint8:
        rgb = np.clip(np.floor(rgb + 0.5), 0, 255)
    out = np.empty_like(image, order="C")
    out[..., :3] = np.where(alpha > 0, rgb, 0)
    out[..., 3] = image[..., 3]
    return out


def lifted(image: NDArray[Float], background: tuple[float, float, float]) -> NDArray[Float]:
    """Return a picture [H, W, 4] with its opacity compensated for culled hidden splats (lift.glsl).

    Hidden splats add about A^3 of the same colour behind alpha A: A' = 1 - (1 - A) (1 - A^3).
    """
    alpha = image[..., 3:]
    more = alpha * alpha * (1 - alpha)
    return image * (1 + more) - more * np.asarray((*background, 0), image.dtype)


def to_linear(srgb: NDArray[Float]) -> NDArray[Float]:
    """Return linear light of sRGB values from 0 to 1, any shape (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sRGB of linear light, clipped to [0, 1]."""
    light = np.clip(linear, 0.0, 1.0)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
