"""Read and check users' masks, which are picture files or arrays."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.photo.photo_file import Photo, read_photo

MaskSource = str | os.PathLike[str] | NDArray[np.bool_]
"""A picture file, or a mask [H, W] of the pixels of ``Photo.picture``."""

_MIN_FRACTION, _MAX_FRACTION = 0.002, 0.95  # of the picture that a person covers


def read_mask(source: MaskSource, photo: Photo) -> NDArray[np.bool_]:
    """Return the mask [H, W] of ``photo.picture``, true on the person.

    A file is white or opaque on the person, black or transparent elsewhere, and has the photograph's upright size.
    Raises FormatError, one line.
    """
    if isinstance(source, np.ndarray):
        return _checked(_array(source, photo), "the mask")
    drawn = read_photo(source, max(photo.picture.shape[:2]))
    if drawn.size != photo.size:
        raise FormatError(
            f"{source}: the mask has {drawn.size[0]} x {drawn.size[1]} pixels, its picture {photo.size[0]} x "
            f"{photo.size[1]} (upright); draw it over the picture, at the same size"
        )
    values = drawn.picture.max(axis=2) if drawn.alpha is None else drawn.alpha
    return _checked(values > 127, str(source))


def _array(mask: NDArray[np.bool_], photo: Photo) -> NDArray[np.bool_]:
    if mask.dtype != np.bool_ or mask.shape != photo.picture.shape[:2]:
        raise FormatError(
            f"a mask needs booleans {photo.picture.shape[:2]}, one for each pixel, not {mask.dtype} {mask.shape}"
        )
    return mask


def _checked(mask: NDArray[np.bool_], name: str) -> NDArray[np.bool_]:
    share = float(mask.mean())
    if not _MIN_FRACTION <= share <= _MAX_FRACTION:
        raise FormatError(
            f"{name}: {share:.1%} of the mask are white, which is not a person; make the person white, all else black"
        )
    return mask
