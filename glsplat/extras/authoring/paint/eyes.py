"""Eyeballs: iris, pupil and white in the colours that the picture has, so that eyes can turn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.eyes import EyeLook, eyeball, iris_angle
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.view_sample import FittedPicture

__all__ = ["eye_colours"]

F64 = NDArray[np.float64]

_PUPIL = np.array([12.0, 10.0, 10.0])  # of 255
_SMALL, _LARGE = 3.0, 9.0  # pixels of an iris's radius: all of its colours are mixed with the lids', and none is
_DULL = 150.0  # of 255: whites are at least as bright
_SCLERA = np.array([1.02, 0.99, 0.97])  # a white is nearly grey
_DARKER = 0.7  # of an iris's mixed colour
_RIM = 0.55  # brightness of the iris's own rim against its middle


def eye_colours(
    body: Body, shot: FittedPicture, looks: Mapping[str, EyeLook], points: SurfacePoints
) -> tuple[NDArray[np.bool_], F64]:
    """[M] which points lie on an eyeball, and the sRGB colours [K, 3] in [0, 1] of those; ``shot`` is the front."""
    chosen = np.zeros(len(points.corners), bool)
    colours = np.zeros((len(points.corners), 3))
    where = points.at(shot.mesh.vertices)
    metre = shot.focal / shot.view.joints[15, 2]  # the head
    for side, look in looks.items():
        ball = eyeball(body, side)
        mine = np.isin(points.corners[:, 0], ball.vertices)
        now, first = shot.mesh.vertices[ball.vertices], body.vertices[ball.vertices]
        size = np.linalg.norm(now - now.mean(axis=0)) / np.linalg.norm(first - first.mean(axis=0))
        there = (where[mine] - now.mean(axis=0)) / size + first.mean(axis=0)
        rim = iris_angle(looks, ball, metre * size)
        zone, outer = ball.zones(there, rim), ball.angles(there) / rim
        iris_colour, white = _cleared(look)
        iris = iris_colour * np.where(outer > 0.85, _RIM, 1.0)[:, None]
        colours[mine] = np.choose(zone[:, None], [white, iris, _PUPIL]) / 255
        chosen |= mine
    return chosen, colours[chosen]


def _cleared(look: EyeLook) -> tuple[F64, F64]:
    """[3] each of 255: the colours of iris and white without the lids that a small eye's pixels have mixed in."""
    clear = 0.0 if not np.isfinite(look.radius) else float(np.clip((look.radius - _SMALL) / (_LARGE - _SMALL), 0, 1))
    grey = float(look.white_colour.mean())
    white = max(grey, _DULL) * _SCLERA
    dark = look.iris_colour * _DARKER
    return clear * look.iris_colour + (1 - clear) * dark, clear * look.white_colour + (1 - clear) * white
