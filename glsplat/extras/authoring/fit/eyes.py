"""The eyes: which part of an eyeball is iris and pupil, and what colours the picture gives them.

The body's eyeball has too few vertices to carry an iris, and a picture of a whole person shows an eye with some twenty
pixels, cut by the lids. So eyes are painted: zones by the angle from the eye's axis, in colours that the picture says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.networks.eye import EyeLook, read_eye
from glsplat.extras.authoring.networks.face import Face, eye_of
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["EYE_SIDES", "EyeLook", "Eyeball", "eyeball", "iris_angle", "read_eyes"]

F64 = NDArray[np.float64]

EYE_SIDES = ("left", "right")

_IRIS = 0.34, 0.26, 0.42  # radians: the usual angle between an eye's axis and its iris's rim, the least, the most
_PUPIL = 0.4  # of that angle


@dataclass(frozen=True, eq=False)
class Eyeball:
    """One eyeball of the body in the zero pose and shape: a sphere that looks along +z."""

    vertices: NDArray[np.intp]  # [N] of the body's
    centre: F64  # [3] metres
    radius: float  # metres

    def angles(self, points: F64) -> F64:
        """[K] radians between the eye's axis and ``points`` [K, 3] on it."""
        away = points - self.centre
        return np.asarray(np.arctan2(np.hypot(away[:, 0], away[:, 1]), away[:, 2]))

    def zones(self, points: F64, iris: float = _IRIS[0]) -> NDArray[np.uint8]:
        """[K] 0 in the white, 1 in the iris, 2 in the pupil; ``points`` [K, 3] on it, ``iris`` as of iris_angle."""
        angles = self.angles(points)
        return (angles < iris).astype(np.uint8) + (angles < _PUPIL * iris)


def eyeball(body: Body, side: str) -> Eyeball:
    """The body's ``left`` or ``right`` eyeball."""
    vertices = np.flatnonzero(~body.skin & (body.part == JOINT_NAMES.index(f"{side}_eye_smplhf")))
    points = body.vertices[vertices]
    columns = np.column_stack([2 * points, np.ones(len(points))])  # |p|^2 = 2 c.p + r^2 - |c|^2
    solved = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)[0]
    return Eyeball(vertices, solved[:3], float(np.sqrt(solved[3] + solved[:3] @ solved[:3])))


def read_eyes(picture: NDArray[np.uint8], face: Face) -> dict[str, EyeLook]:
    """Both eyes of a face in an RGB picture; an eye that is not seen has the other's colours, else usual ones."""
    looks = {side: read_eye(picture, eye_of(picture, face, side)) for side in EYE_SIDES}
    for side, other in zip(EYE_SIDES, reversed(EYE_SIDES), strict=True):
        if not looks[side].visible and looks[other].visible:
            nothing = np.full(2, np.nan)
            looks[side] = EyeLook(False, nothing, np.nan, looks[other].iris_colour, looks[other].white_colour)
    return looks


def iris_angle(looks: Mapping[str, EyeLook], ball: Eyeball, metre: float) -> float:
    """Radians between an eyeball's axis and its iris's rim, such that irises look as large as they were seen.

    ``metre``: pixels of a metre at the face. The usual angle where no eye was seen.
    """
    seen = [look.radius / metre / ball.radius for look in looks.values() if look.visible]
    return float(np.arcsin(np.clip(np.mean(seen), *np.sin(_IRIS[1:])))) if seen else _IRIS[0]
