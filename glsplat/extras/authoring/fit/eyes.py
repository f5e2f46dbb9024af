"""Find iris and pupil of the eyeballs, and read the eyes' colours from a picture.

The body's eyeball has too few vertices for an iris, and a picture of a whole person shows an eye with some twenty
pixels, cut by the lids. Eyes are therefore painted in zones by the angle from the eye's axis, in the picture's colours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.networks.face import EyeLook, Face, eye_of, read_eye
from glsplat.skinning.smplx import JOINT_NAMES

EYE_SIDES = ("left", "right")

_IRIS_RAD, _MIN_IRIS_RAD, _MAX_IRIS_RAD = 0.34, 0.26, 0.42  # between the eye's axis and the rim of the iris
_PUPIL_FRACTION = 0.4  # of the angle of the iris


@dataclass(frozen=True, eq=False)
class Eyeball:
    """One eyeball of the body in the zero pose and shape: a sphere with its axis along +z."""

    vertices: NDArray[np.intp]  # [N] vertices of the body
    centre: F64  # [3] metres
    radius: float  # metres

    def angles(self, points: F64) -> F64:
        """Return the angles [K] in radians between the eye's axis and ``points`` [K, 3]."""
        away = points - self.centre
        return np.asarray(np.arctan2(np.hypot(away[:, 0], away[:, 1]), away[:, 2]))

    def zones(self, points: F64, iris: float = _IRIS_RAD) -> NDArray[np.uint8]:
        """Return the zones [K] of ``points`` [K, 3]: 0 white, 1 iris, 2 pupil; ``iris`` is from ``iris_angle``."""
        angles = self.angles(points)
        return (angles < iris).astype(np.uint8) + (angles < _PUPIL_FRACTION * iris)


def eyeball(body: Body, side: str) -> Eyeball:
    """Return the body's ``left`` or ``right`` eyeball."""
    vertices = np.flatnonzero(~body.skin & (body.part == JOINT_NAMES.index(f"{side}_eye_smplhf")))
    return Eyeball(vertices, *fitted_sphere(body.vertices[vertices]))


def fitted_sphere(points: F64) -> tuple[F64, float]:
    """Return the centre [3] and radius of the sphere that fits ``points`` [N, 3] by least squares."""
    columns = np.column_stack([2 * points, np.ones(len(points))])  # |p|^2 = 2 c.p + r^2 - |c|^2
    solution = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)[0]
    return solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))


def read_eyes(picture: NDArray[np.uint8], face: Face) -> dict[str, EyeLook]:
    """Return both eyes of a face in an RGB picture; an invisible one has the other's colours, or else defaults."""
    looks = {side: read_eye(picture, eye_of(picture, face, side)) for side in EYE_SIDES}
    for side, other in zip(EYE_SIDES, reversed(EYE_SIDES), strict=True):
        if not looks[side].visible and looks[other].visible:
            nothing = np.full(2, np.nan)
            looks[side] = EyeLook(False, nothing, np.nan, looks[other].iris_colour, looks[other].white_colour)
    return looks


def iris_angle(looks: Mapping[str, EyeLook], ball: Eyeball, pixels_per_metre: float) -> float:
    """Return the angle in radians between an eyeball's axis and the rim of the iris, from the visible eyes' radii.

    ``pixels_per_metre`` is the scale at the face. Without a visible eye the angle is a default.
    """
    sines = [look.radius / pixels_per_metre / ball.radius for look in looks.values() if look.visible]
    low, high = np.sin((_MIN_IRIS_RAD, _MAX_IRIS_RAD))
    return float(np.arcsin(np.clip(np.mean(sines), low, high))) if sines else _IRIS_RAD
