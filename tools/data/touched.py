"""Textures of MakeHuman's people, mended: pale palms of dark skins, and what looks torn or blurred on splats."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]
Scalar = TypeVar("Scalar", np.uint8, np.float64)

_HANDS = (0.80, 1.0, 0.34, 0.78)  # rows and columns of the skin's texture that hands lie in, shares
_ARM = (0.145, 0.20, 0.02, 0.12)  # an upper arm, whose colour the skin has
_PALE = 0.35  # of the difference to the arm that palms keep
_PRINT = (0.10, 0.24, 0.48, 0.64)  # the figure on the chest, which stays
_CLOTH = np.array([38, 92, 98])  # sRGB of a shirt without its dots
_CALM = 0.35  # of the difference to the colours around


def darker_palms(texture: U8) -> U8:
    """[H, W, 4] palms that are a little lighter than the arm, instead of pink."""
    out, colour = texture.copy(), texture[..., :3].astype(np.float64)
    skin = np.median(_part(colour, _ARM).reshape(-1, 3), axis=0)
    hands = _part(colour, _HANDS)
    lighter = np.clip((hands.mean(axis=2) / skin.mean() - 1.05) / 0.3, 0, 1)[..., None]
    toned = skin * np.clip((1 - _PALE) + _PALE * hands.mean(axis=2, keepdims=True) / skin.mean(), 0, 2)
    _part(out, _HANDS)[..., :3] = np.rint(hands * (1 - lighter) + toned * lighter).clip(0, 255)
    return out


def plain_sleeves(texture: U8) -> U8:
    """[H, W, 4] a shirt without its orange stripes, but for the print: on splats they looked like tears."""
    hue, saturation, _ = cv2.split(cv2.cvtColor(np.ascontiguousarray(texture[..., :3]), cv2.COLOR_RGB2HSV))
    orange = ((hue < 25) & (saturation > 90)).astype(np.uint8)
    half = texture.shape[0] // 2  # jeans have orange seams below
    orange[int(0.42 * 2 * half) :, : int(0.66 * texture.shape[1])] = 0
    _part(orange, _PRINT)[:] = 0
    mask = cv2.dilate(orange, np.ones((7, 7), np.uint8))
    out = texture.copy()
    out[..., :3] = cv2.inpaint(np.ascontiguousarray(texture[..., :3]), mask, 5, cv2.INPAINT_TELEA)
    return out


def without_dots(texture: U8) -> U8:
    """[H, W, 4] a shirt of one colour, shaded as cloth is: its dots are stretched and blurred at the collar."""
    height, width = texture.shape[:2]
    rng = np.random.default_rng(0)
    shade = np.zeros((height, width))
    for cells, strength in ((6, 0.04), (30, 0.035), (160, 0.02)):  # drapes, creases and the weave
        noise = rng.normal(0, strength, (cells, cells)).astype(np.float32)
        shade += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    out = texture.copy()
    out[..., :3] = np.rint(_CLOTH * np.clip(1 + shade, 0.6, 1.5)[..., None]).clip(0, 255)
    return out


def fair_ends(texture: U8) -> U8:
    """[H, W, 4] hair that is nowhere darker than three quarters of its own colour: dark ends look like a rim."""
    colour = texture[..., :3].astype(np.float64)
    light = colour.mean(axis=2)
    shown = texture[..., 3] > 128
    usual = float(np.quantile(light[shown], 0.75))
    own = np.median(colour[shown & (np.abs(light - usual) < 0.1 * usual)], axis=0)
    fair = own * (0.72 + 0.28 * light / usual)[..., None]
    dark = np.clip((0.85 - light / usual) / 0.25, 0, 1)[..., None]
    out = texture.copy()
    out[..., :3] = np.rint(colour * (1 - dark) + fair * dark).clip(0, 255)
    return out


def toned(colour: tuple[int, int, int], solid: float) -> Callable[[U8], U8]:
    """A touch that gives brows one sRGB colour, and that share of their alpha."""

    def touch(texture: U8) -> U8:
        out = texture.copy()
        out[..., :3] = colour
        out[..., 3] = np.rint(texture[..., 3] * solid)
        return out

    return touch


def calmer(texture: U8) -> U8:
    """[H, W, 4] a checked shirt with a third of its contrast: few splats cannot hold so many bright lines."""
    colour = texture[..., :3].astype(np.float64)
    even = cv2.GaussianBlur(colour, (0, 0), texture.shape[0] / 40)
    out = texture.copy()
    out[..., :3] = np.rint(even + _CALM * (colour - even)).clip(0, 255)
    return out


def _part(image: NDArray[Scalar], box: tuple[float, float, float, float]) -> NDArray[Scalar]:
    height, width = image.shape[:2]
    return image[int(box[0] * height) : int(box[1] * height), int(box[2] * width) : int(box[3] * width)]
