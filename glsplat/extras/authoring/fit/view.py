"""One picture of the person as input of the fit: mask, landmarks, camera and side."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64, own
from glsplat.errors import FormatError
from glsplat.extras.authoring.fit.landmarks import LANDMARK_COUNT
from glsplat.extras.authoring.networks.people import SIDES, degrees_between

_MIN_FIGURE_PX = 64


def facing(turn: float) -> F64:
    """Return the body's left, up and front after a ``turn`` in degrees, columns [3, 3] in camera axes (z away)."""
    cos, sin = np.round([np.cos(np.radians(turn)), np.sin(np.radians(turn))], 15)
    return np.array([[cos, 0.0, sin], [0.0, -1.0, 0.0], [sin, 0.0, -cos]])


@dataclass(frozen=True, eq=False, init=False)
class View:
    """A checked picture: ``mask`` [H, W] true on the person, ``landmarks`` [33, 2] pixels with ``visibility`` [33].

    ``focal`` is in pixels, ``centre`` [2] the pixel of the optical axis (default: the picture's middle; pixel centres
    at +0.5). ``side`` is the visible side of the person (front, back, left or right), or ``turn`` their approximate
    angle in degrees from facing the camera to their own left. ``world`` [33, 3] are the network's landmarks in rough
    metres from the hips, x right, y down, z away; ``face`` is the face's turn in degrees. Raises FormatError.
    """

    mask: NDArray[np.bool_] = field(repr=False)
    landmarks: F64 = field(repr=False)
    visibility: F64 = field(repr=False)
    focal: float
    centre: F64
    side: str
    turn: float  # degrees
    world: F64 | None = field(repr=False)
    face: float | None  # degrees
    figure: float  # pixels from the mask's top to its bottom

    def __init__(
        self,
        mask: ArrayLike,
        landmarks: ArrayLike,
        visibility: ArrayLike,
        focal: float,
        centre: ArrayLike | None = None,
        side: str = "front",
        turn: float | None = None,
        world: ArrayLike | None = None,
        face: float | None = None,
    ) -> None:
        person = np.asarray(mask)
        if person.ndim != 2 or person.dtype != np.bool_:
            raise FormatError(f"a mask needs booleans of shape (H, W), not {person.dtype} {person.shape}")
        rows = np.flatnonzero(person.any(axis=1))
        figure = float(rows[-1] - rows[0] + 1) if len(rows) else 0.0
        if figure < _MIN_FIGURE_PX:
            raise FormatError(f"a mask needs a person at least {_MIN_FIGURE_PX} pixels high, found {figure:.0f}")
        where = own(landmarks, np.float64, "landmarks")
        sure = own(visibility, np.float64, "visibility")
        if where.shape != (LANDMARK_COUNT, 2) or sure.shape != (LANDMARK_COUNT,):
            raise FormatError(
                f"a view needs landmarks ({LANDMARK_COUNT}, 2) and visibility ({LANDMARK_COUNT},), "
                f"not {where.shape} and {sure.shape}"
            )
        metres = None if world is None else own(world, np.float64, "world landmarks")
        if metres is not None and (metres.shape != (LANDMARK_COUNT, 3) or not np.isfinite(metres).all()):
            raise FormatError(f"world landmarks need finite numbers ({LANDMARK_COUNT}, 3), not {metres.shape}")
        middle = own(np.array(person.shape[::-1]) / 2 if centre is None else centre, np.float64, "centre")
        finite = np.isfinite(where).all() and np.isfinite(sure).all() and np.isfinite(middle).all()
        if not finite or middle.shape != (2,):
            raise FormatError("landmarks, visibility and centre [2] of a view need finite numbers")
        if not (np.isfinite(focal) and focal > 0):
            raise FormatError(f"a focal length needs pixels above zero, not {focal}")
        if side not in SIDES:
            raise FormatError(f'a view shows {", ".join(SIDES)}, not "{side}"')
        if turn is not None:
            if not np.isfinite(turn):
                raise FormatError(f"a view's turn needs degrees, not {turn}")
            side = min(SIDES, key=lambda name: degrees_between(turn, SIDES[name]))
        if face is not None and not np.isfinite(face):
            raise FormatError(f"a face's turn needs degrees, not {face}")
        set_field = object.__setattr__
        set_field(self, "mask", person)
        set_field(self, "landmarks", where)
        set_field(self, "visibility", sure.clip(0.0, 1.0))
        set_field(self, "focal", float(focal))
        set_field(self, "centre", middle)
        set_field(self, "side", side)
        set_field(self, "turn", SIDES[side] if turn is None else float(turn))
        set_field(self, "world", metres)
        set_field(self, "face", None if face is None else float(face))
        set_field(self, "figure", figure)

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
