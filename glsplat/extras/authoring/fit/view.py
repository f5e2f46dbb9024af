"""One picture of the person as input of the fit: mask, landmarks, camera and side."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.authoring.networks.people import SIDES, degrees_between

_MIN_FIGURE_PX = 64


def facing(turn: float) -> F64:
    """Return the body's left, up and front after a ``turn`` in degrees, columns [3, 3] in camera axes (z away)."""
    cos, sin = np.round([np.cos(np.radians(turn)), np.sin(np.radians(turn))], 15)
    return np.array([[cos, 0.0, sin], [0.0, -1.0, 0.0], [sin, 0.0, -cos]])


class View:
    """A picture: ``mask`` [H, W] true on the person, ``landmarks`` [33, 2] pixels with their ``visibility`` [33].

    ``focal`` is in pixels, ``centre`` [2] the pixel of the optical axis (default: the picture's middle; pixel centres
    at +0.5). ``side`` is the visible side of the person (front, back, left or right), or ``turn`` their approximate
    angle in degrees from facing the camera to their own left. ``world`` [33, 3] are the network's landmarks in rough
    metres from the hips, x right, y down, z away; ``face`` is the face's turn in degrees. ``figure`` is the height of
    the mask's person in pixels. Raises FormatError for a mask without a person.
    """

    def __init__(
        self,
        mask: NDArray[np.bool_],
        landmarks: F64,
        visibility: F64,
        focal: float,
        centre: F64 | None = None,
        side: str = "front",
        turn: float | None = None,
        world: F64 | None = None,
        face: float | None = None,
    ) -> None:
        rows = np.flatnonzero(mask.any(axis=1))
        self.figure = float(rows[-1] - rows[0] + 1) if len(rows) else 0.0
        if self.figure < _MIN_FIGURE_PX:
            raise FormatError(f"a mask needs a person at least {_MIN_FIGURE_PX} pixels high, found {self.figure:.0f}")
        if not 0 < focal < np.inf:
            raise FormatError(f"a focal length needs pixels above zero, not {focal}")
        self.mask, self.landmarks, self.visibility = mask, landmarks, visibility.clip(0.0, 1.0)
        self.focal, self.world, self.face = focal, world, face
        self.centre: F64 = np.array(mask.shape[::-1]) / 2 if centre is None else centre
        self.turn = SIDES[side] if turn is None else turn
        self.side = min(SIDES, key=lambda name: degrees_between(self.turn, SIDES[name]))

    @property
    def facing(self) -> F64:
        """[3, 3] the person's axes in the camera's; see ``facing``."""
        return facing(self.turn)

    def smaller(self, figure: float) -> View:
        """Return the view with the person at most ``figure`` pixels high."""
        scale = figure / self.figure
        if scale >= 1:
            return self
        height, width = self.mask.shape
        size = max(1, round(width * scale)), max(1, round(height * scale))
        factors = np.array(size) / (width, height)
        mask = cv2.resize(self.mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
        focal = self.focal * float(factors.mean())
        marks, centre = self.landmarks * factors, self.centre * factors
        return View(mask, marks, self.visibility, focal, centre, turn=self.turn, world=self.world, face=self.face)
