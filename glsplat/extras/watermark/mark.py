"""Watermark: a step of a renderer's resolve pass (``Renderer.step``), as a value. No OpenGL and no OpenCV here."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.extras.watermark.code import Payload, encode
from glsplat.extras.watermark.pattern import TILE, pattern_of

KEY_BYTES = 16
"""Least length of a key."""

LEVELS = (1.0, 2.3)
"""Strength of a mark on black and on white, linear in between: root mean square in levels of 255."""

LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in luma (ITU-R BT.601, as in JPEG)."""


@dataclass(frozen=True, slots=True)
class Watermark:
    """Ids of a server (16 bits) and a session (32 bits), and a key of at least 16 bytes. Raises GlsplatError."""

    server: int
    session: int
    key: bytes = field(repr=False)

    def __post_init__(self) -> None:
        for name, bits in (("server", 16), ("session", 32)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << bits:
                raise GlsplatError(f"a mark's {name} is a whole number of {bits} bits, not {value!r:.40}")
        if not isinstance(self.key, bytes) or len(self.key) < KEY_BYTES:
            found = f"{len(self.key)}" if isinstance(self.key, bytes) else type(self.key).__name__
            raise GlsplatError(f"a mark's key is at least {KEY_BYTES} bytes, not {found}")

    @property
    def source(self) -> str:
        """GLSL of the step."""
        return _source()

    def tile(self) -> NDArray[np.float32]:
        """Return the tile [TILE, TILE] of mean 0 and variance 1, repeated from the picture's top left pixel."""
        return pattern_of(self.key).tile(encode(Payload(self.server, self.session)))


@dataclass(frozen=True, slots=True)
class WatermarkKey:
    """Id and key of a server, checked as those of a Watermark."""

    server: int
    key: bytes = field(repr=False)

    def __post_init__(self) -> None:
        Watermark(self.server, 0, self.key)

    def new_mark(self) -> Watermark:
        """Return the mark of a new session, with a random id that reveals no other one."""
        return Watermark(self.server, secrets.randbits(32), self.key)


@cache
def _source() -> str:
    low, high = (level / 255 for level in LEVELS)
    text = (resources.files("glsplat.extras.watermark") / "mark.glsl").read_text(encoding="utf-8")
    return f"const vec2 LEVELS = vec2({low!r}, {high!r});\n{text}"


def marked(image: NDArray[np.float32], mark: Watermark) -> NDArray[np.float32]:
    """Return marked copies of a renderer's float pictures [..., H, W, 4]. Twin of mark.glsl.

    Each view has the mark at the same place of the screen. Pixels of alpha 0 do not change and no colour exceeds its
    alpha. Colours may be below 0 until they are rounded to bytes.
    """
    height, width = image.shape[-3:-1]
    tile = mark.tile()[np.arange(height)[:, None] % TILE, np.arange(width) % TILE]
    rgb, alpha = image[..., :3], image[..., 3]
    low, high = LEVELS
    luma = np.minimum(rgb @ np.array(LUMA, np.float32), alpha)
    change = tile * (low * alpha + (high - low) * luma) / 255
    out = image.copy()
    most = np.maximum(rgb, alpha[..., None])
    out[..., :3] = np.minimum(rgb + change[..., None], most)
    return out
