"""Tell skin from other colours, and find the face's colour."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.eyes import EYE_SIDES, eyeball
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_srgb
from glsplat.rotations import lengths

F64 = NDArray[np.float64]

_MIN_VISIBILITY, _MIN_VERTICES = 0.6, 60
_CHEEKS_M = -0.04, -0.01  # heights above the eyes: a face between fringe and beard or mask
_BRIGHT_QUANTILE = 0.4  # of the cheeks' brightness: above shadows and rims of glasses
_HUES = 14.0, 9.0  # distances in CIELAB without L: surely other, and the same
_DARK, _LIGHT = (0.2, 0.4), (2.2, 1.6)  # brightness over the tone's: surely other, and the same


def lab(linear: F64) -> F64:
    """Return CIELAB [M, 3] of linear colours [M, 3]."""
    rgb = to_srgb(np.maximum(linear, 0)).clip(0, 1).astype(np.float32).reshape(-1, 1, 3)
    if not len(rgb):
        return np.zeros((0, 3))
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB).reshape(-1, 3).astype(np.float64)


def likeness(linear: F64, tone: F64) -> F64:
    """Return [M] from 0 to 1: how surely linear colours [M, 3] are ``tone`` [M or 1, 3] in more or less light."""
    ratio = linear.sum(axis=1) / np.maximum(tone.sum(axis=1), 1e-6)
    even = linear / np.maximum(ratio, 1e-6)[:, None]  # at the tone's brightness: dark colours have little chroma
    hue = lengths((lab(even) - lab(tone))[:, 1:])
    return np.asarray(ramp(hue, *_HUES) * ramp(ratio, *_DARK) * ramp(ratio, *_LIGHT))


def unlit(shot: FittedPicture, light: Lamp, some: NDArray[np.bool_]) -> F64:
    """Return [K, 3] the picture's linear colours at ``some`` [V] vertices, without ``light``."""
    shade = light.shade(shot.normals[some])
    return shot.sample(shot.view.pixels[some], shot.layer[some]) / shade[:, None]


def face_colour(body: Body, shot: FittedPicture, light: Lamp) -> F64 | None:
    """Return [3] the linear colour of the cheeks' skin without ``light``; None where it is hardly visible."""
    height = body.vertices[:, 1] - eyeball(body, EYE_SIDES[0]).centre[1]
    cheeks = face_vertices(body) & (height > _CHEEKS_M[0]) & (height < _CHEEKS_M[1])
    cheeks &= shot.visibility > _MIN_VISIBILITY
    if cheeks.sum() < _MIN_VERTICES:
        return None
    colours = unlit(shot, light, cheeks)
    bright = colours.sum(axis=1)
    return np.asarray(np.median(colours[bright >= np.quantile(bright, _BRIGHT_QUANTILE)], axis=0))
