"""The eyes: which part of an eyeball is iris and pupil, and what colours the picture gives them.

The body's eyeball has too few vertices to carry an iris, and a picture of a whole person shows an eye with some twenty
pixels, cut by the lids. So eyes are painted: zones by the angle from the eye's axis, in colours that the picture says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.fit.body import Body
from glsplat.authoring.networks.face import Eye, Face, eye_of
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["EYE_SIDES", "EyeLook", "Eyeball", "eyeball", "iris_angle", "look_of_eye", "read_eyes"]

F64 = NDArray[np.float64]

EYE_SIDES = ("left", "right")

_IRIS = 0.34, 0.26, 0.42  # radians: the usual angle between an eye's axis and its iris's rim, the least, the most
_PUPIL = 0.4  # of that angle
_BROWN, _WHITE = (58.0, 42.0, 32.0), (190.0, 182.0, 174.0)  # of 255: where no eye is seen
_OPEN = 0.25  # a seen eye's height in widths
_CONTRAST = 1.9  # brightness of a seen eye's white on both sides of the iris, in that of the iris
_SAMPLES = 4  # a pixel, each way
_RING, _SURROUND = (0.45, 0.9), 1.15  # iris radii: where the iris shows its colour, and where the white begins
_BRIGHTEST = 60  # percent of the white that lids and lashes shade


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


@dataclass(frozen=True, eq=False)
class EyeLook:
    """What a picture says of one eye. The colours are to be used in any case: of an unseen eye they are the other's."""

    seen: bool  # open, and no hair over it
    iris: F64  # [2] pixels, its centre; NaN where it is not seen
    radius: float  # pixels of the iris; NaN where it is not seen
    iris_colour: F64  # [3] RGB of 255
    white_colour: F64  # [3] RGB of 255


def eyeball(body: Body, side: str) -> Eyeball:
    """The body's ``left`` or ``right`` eyeball."""
    vertices = np.flatnonzero(~body.skin & (body.part == JOINT_NAMES.index(f"{side}_eye_smplhf")))
    points = body.vertices[vertices]
    columns = np.column_stack([2 * points, np.ones(len(points))])  # |p|^2 = 2 c.p + r^2 - |c|^2
    solved = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)[0]
    return Eyeball(vertices, solved[:3], float(np.sqrt(solved[3] + solved[:3] @ solved[:3])))


def read_eyes(picture: NDArray[np.uint8], face: Face) -> dict[str, EyeLook]:
    """Both eyes of a face in an RGB picture; an eye that is not seen has the other's colours, else usual ones."""
    looks = {side: look_of_eye(picture, eye_of(picture, face, side)) for side in EYE_SIDES}
    for side, other in zip(EYE_SIDES, reversed(EYE_SIDES), strict=True):
        if not looks[side].seen and looks[other].seen:
            nothing = np.full(2, np.nan)
            looks[side] = EyeLook(False, nothing, np.nan, looks[other].iris_colour, looks[other].white_colour)
    return looks


def look_of_eye(picture: NDArray[np.uint8], eye: Eye) -> EyeLook:
    """One eye alone. It is seen where its lids are apart and a dark iris lies between brighter whites."""
    outline, centre = eye.lids[:16], eye.iris[0]
    radius = float(np.linalg.norm(eye.iris[1:] - centre, axis=1).mean())
    hidden = EyeLook(False, np.full(2, np.nan), np.nan, np.array(_BROWN), np.array(_WHITE))
    low, high = outline.min(axis=0), outline.max(axis=0)
    if not np.isfinite(outline).all() or high[1] - low[1] < _OPEN * (high[0] - low[0]) or radius < 1:
        return hidden
    columns, rows = (np.arange(low[k], high[k], 1 / _SAMPLES) for k in (0, 1))
    x, y = np.meshgrid(columns, rows)
    colours = cv2.remap(picture, (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32), cv2.INTER_LINEAR)
    colours = colours.astype(np.float64)
    lids = np.zeros(x.shape, np.uint8)
    cv2.fillConvexPoly(lids, cv2.convexHull(np.round((outline - low) * _SAMPLES).astype(np.int32)), 1)
    far = np.hypot(x - centre[0], y - centre[1]) / radius
    white, ring = (lids > 0) & (far > _SURROUND), (lids > 0) & (far > _RING[0]) & (far < _RING[1])
    dark = (lids > 0) & (far < _RING[1])
    sides = white & (x < centre[0]), white & (x >= centre[0])
    if min(side.sum() for side in (*sides, ring)) < _SAMPLES**2:
        return hidden
    light = colours @ (0.299, 0.587, 0.114)
    whites = min(float(np.percentile(light[side], 80)) for side in sides)
    if whites < _CONTRAST * max(float(np.percentile(light[dark], 25)), 1.0):
        return hidden
    bright = white & (light >= np.percentile(light[white], _BRIGHTEST))
    return EyeLook(True, centre, radius, np.median(colours[ring], axis=0), np.median(colours[bright], axis=0))


def iris_angle(looks: Mapping[str, EyeLook], ball: Eyeball, metre: float) -> float:
    """Radians between an eyeball's axis and its iris's rim, such that irises look as large as they were seen.

    ``metre``: pixels of a metre at the face. The usual angle where no eye was seen.
    """
    seen = [look.radius / metre / ball.radius for look in looks.values() if look.seen]
    return float(np.arcsin(np.clip(np.mean(seen), *np.sin(_IRIS[1:])))) if seen else _IRIS[0]
