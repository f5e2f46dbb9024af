"""``glsplat serve`` that fits splats of photographs in few steps, also in the process that makes them."""

from __future__ import annotations

import sys

from apps.cli import main as glsplat
from apps.serve import photos
from glsplat.avatar import Avatar
from glsplat.extras.uploads.job import Order, Progress

__all__ = ["main", "make_avatar"]

_FROM_PHOTO = photos.make_avatar


def make_avatar(order: Order, progress: Progress) -> Avatar:
    """As that of photos.py."""
    from glsplat.extras.authoring.reconstruct import Options

    Options.__init__.__kwdefaults__["steps"] = 12
    return _FROM_PHOTO(order, progress)


def main() -> None:
    """With the arguments of the command line."""
    photos.make_avatar = make_avatar
    sys.exit(glsplat(sys.argv[1:]))
