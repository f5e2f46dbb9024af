"""Encoding of drawn pictures, in the server or in the worker."""

from __future__ import annotations

from glsplat.net.backend import Rendered
from glsplat.net.codec.encode import Encoded, Encoder
from glsplat.net.fields import PictureOptions

__all__ = ["encode"]


def encode(encoder: Encoder, rendered: Rendered, options: PictureOptions) -> Encoded:
    """Return the JPEGs of ``rendered``. Call it on an encoding thread."""
    return encoder.encode(rendered.images, options.quality, options.crop, rendered.covered, options.alpha)
