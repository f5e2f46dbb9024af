"""One picture of the person, as the fit takes it: mask, landmarks, camera, and from which side it shows them."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import own
from glsplat.errors import FormatError
from glsplat.extras.authoring.fit.landmarks import LANDMARK_COUNT
from glsplat.extras.authoring.networks.people import SIDES, degrees_between

__all__ = ["View", "facing"]

F64 = NDArray[np.float64]

_LEAST_FIGURE = 64  # pixels


def facing(turn: float) -> F64:
    """[3, 3] left, up and front of somebody who has turned by so many degrees: columns, in camera axes (z away)."""
    cos, sin = np.round([np.cos(np.radians(turn)), np.sin(np.radians(turn))], 15)
    return np.array([[cos, 0.0, sin], [0.0, -1.0, 0.0], [sin, 0.0, -cos]])


@dataclass(frozen=True, eq=False, init=False)
class View:
    """A picture, checked: ``mask`` [H, W] true on the person, ``landmarks`` [33, 2] pixels with ``visibility`` [33].

    ``focal`` in pixels, ``centre`` [2] the pixel of the optical axis (default: the picture's middle; pixel centres at
    +0.5), ``side`` the side of the person that is seen: front, back, left or right; or ``turn``, about how many degrees
    they have turned to their own left from facing the camera. ``world`` [33, 3] are the landmarks as rough metres about
    the hips, x right, y down, z away, where a network gave them; ``face`` is how many degrees a face that is seen has
    turned likewise. Raises FormatError.
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
        seen = np.asarray(mask)
        if seen.ndim != 2 or seen.dtype != np.bool_:
            raise FormatError(f"a mask needs booleans of shape (H, W), not {seen.dtype} {seen.shape}")
        rows = np.flatnonzero(seen.any(axis=1))
        figure = float(rows[-1] - rows[0] + 1) if len(rows) else 0.0
        if figure < _LEAST_FIGURE:
            raise FormatError(f"a mask needs a person at least {_LEAST_FIGURE} pixels high, found {figure:.0f}")
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
        middle = own(np.array(seen.shape[::-1]) / 2 if centre is None else centre, np.float64, "centre")
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
        keep = object.__setattr__
        keep(self, "mask", seen)
        keep(self, "landmarks", where)
        keep(self, "visibility", sure.clip(0.0, 1.0))
        keep(self, "focal", float(focal))
        keep(self, "centre", middle)
        keep(self, "side", side)
        keep(self, "turn", SIDES[side] if turn is None else float(turn))
        keep(self, "world", metres)
        keep(self, "face", None if face is None else float(face))
        keep(self, "figure", figure)

    @property
    def facing(self) -> F64:
        """[3, 3] how the person stands; see ``facing``."""
        return facing(self.turn)

    def smaller(self, figure: float) -> View:
        """The same view with the person ``figure`` pixels high; itself where they are smaller already."""
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
