"""Colour eyeballs with the picture's iris, pupil and white, so that eyes can turn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.eyes import eyeball, iris_angle
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.networks.face import EyeLook
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.view_sample import FittedPicture

F64 = NDArray[np.float64]

_PUPIL_RGB = np.array([12.0, 10.0, 10.0])  # of 255
# an iris this small has pixels mixed with the lids' all over; one this large has clear pixels
_MIXED_IRIS_RADIUS_PX, _CLEAR_IRIS_RADIUS_PX = 3.0, 9.0
_MIN_WHITE = 150.0  # of 255
_SCLERA_TINT = np.array([1.02, 0.99, 0.97])
_MIXED_IRIS_FACTOR = 0.7  # darkens the colour of a small iris
_RIM_FACTOR = 0.55  # brightness of an iris's rim against its middle


def eye_colours(
    body: Body, shot: FittedPicture, looks: Mapping[str, EyeLook], points: SurfacePoints
) -> tuple[NDArray[np.bool_], F64]:
    """Return [M] the points on an eyeball, and their sRGB colours [K, 3] in [0, 1]; ``shot`` is the front."""
    on_eyes = np.zeros(len(points.corners), bool)
    colours = np.zeros((len(points.corners), 3))
    where = points.at(shot.mesh.vertices)
    pixels_per_metre = shot.focal / shot.view.joints[15, 2]  # the head
    for side, look in looks.items():
        ball = eyeball(body, side)
        mine = np.isin(points.corners[:, 0], ball.vertices)
        posed, rest = shot.mesh.vertices[ball.vertices], body.vertices[ball.vertices]
        size = np.linalg.norm(posed - posed.mean(axis=0)) / np.linalg.norm(rest - rest.mean(axis=0))
        at_rest = (where[mine] - posed.mean(axis=0)) / size + rest.mean(axis=0)
        rim = iris_angle(looks, ball, pixels_per_metre * size)
        zone, outer = ball.zones(at_rest, rim), ball.angles(at_rest) / rim
        iris_colour, white = _without_lids(look)
        iris = iris_colour * np.where(outer > 0.85, _RIM_FACTOR, 1.0)[:, None]
        colours[mine] = np.choose(zone[:, None], [white, iris, _PUPIL_RGB]) / 255
        on_eyes |= mine
    return on_eyes, colours[on_eyes]


def _without_lids(look: EyeLook) -> tuple[F64, F64]:
    """Return the colours [3] of iris and white, of 255, with less of the lids that a small eye's pixels mix in."""
    clear = (
        0.0 if not np.isfinite(look.radius) else float(ramp(look.radius, _MIXED_IRIS_RADIUS_PX, _CLEAR_IRIS_RADIUS_PX))
    )
    grey = float(look.white_colour.mean())
    white = max(grey, _MIN_WHITE) * _SCLERA_TINT
    dark = look.iris_colour * _MIXED_IRIS_FACTOR
    return clear * look.iris_colour + (1 - clear) * dark, clear * look.white_colour + (1 - clear) * white
