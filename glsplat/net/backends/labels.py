"""Words in a picture: the label over a person's head, and notices. What they say and where they stand.

A label is a board that stands in the room and faces who looks, so both eyes see it at its distance. It is never hidden
by what is in front of it: it has to be read. What a client asks for cannot leave it out. lettering.py draws them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera

__all__ = ["HEIGHT", "Label", "driven_by", "notice"]

HEIGHT = 0.045
"""Metres from the lower to the upper edge of a label at least."""
_NOTICE_DISTANCE = 1.5  # metres from the eyes
_NOTICE_PLACE = 0.8  # of the way from the middle of the picture to its lower edge
_NOTICE_SHARE = 0.03  # of the picture's height


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """Words at a place: ``place`` [3] is the middle of the board, in metres; ``height`` metres, at least."""

    text: str
    place: NDArray[np.float64]
    height: float = HEIGHT
    opacity: float = 1.0


def driven_by(name: str, notice: str = "") -> str:
    """What stands over the head of a person who is not there in the flesh, and what else has to be said of them."""
    return ", ".join([f"driven by {name or 'somebody'}", "synthetic", *([notice] if notice else [])])


def notice(text: str, cameras: Sequence[Camera]) -> Label:
    """Words at the lower edge of a picture, in front of everything."""
    first = cameras[0]
    fy, cy = float(first.K[1, 1]), float(first.K[1, 2])
    down = (_NOTICE_PLACE * (first.height - cy)) / fy
    eyes = np.mean([camera.position for camera in cameras], axis=0)
    place = eyes + _NOTICE_DISTANCE * (first.viewmat[2, :3] + down * first.viewmat[1, :3])
    return Label(text, place, _NOTICE_SHARE * first.height / fy * _NOTICE_DISTANCE)
