"""Estimate the light of a picture, so that unseen sides are as dark as they would be.

The model is a soft lamp and a room: an ambient part that grows from the floor to the ceiling, and a lamp that wraps
around the form. Its direction and strength are fitted to the brightness of the visible surface; clothes are separated
by their chromaticity, each with an albedo of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from glsplat.extras.authoring.compute.solvers import least_squares

F64 = NDArray[np.float64]

_FLOOR_FRACTION, _CEILING_FRACTION = 0.7, 1.3  # ambient light from below and from above, over its mean
_WRAP = 0.15  # of a cosine: the lamp reaches this far beyond the terminator
_USUAL_DIRECTION = np.array([0.3, 0.7, 0.65])  # left, up, towards the camera
_USUAL_LOG_STRENGTH = np.log(1.4)  # of the lamp, over the ambient light
_PRIOR_SIGMAS = 0.45, 0.35  # of the lamp's direction (tangents) and log strength
_MATERIALS = 8  # separated by chromaticity
_MAX_POINTS, _MIN_POINTS = 3000, 100
_MIN_VISIBILITY = 0.3
_TEXTURE_SIGMA = 0.25  # of the logarithm of brightness within a material
_FIT_STEPS = 12
_DATA_WEIGHT = 60  # of all points together against the prior


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A lamp in a room; ``shade`` gives the brightness of a surface against one in ambient light only."""

    direction: F64  # [3] unit, towards the lamp, in the axes of the fitted normals
    up: F64  # [3] unit, in the same axes
    strength: float  # of the lamp over the ambient light

    def shade(self, normals: F64) -> F64:
        """Return [M] the relative brightness of surfaces with unit normals [M, 3]."""
        return _shade(normals, self.direction, self.up, self.strength)


def find_light(
    normals: F64,
    linear: F64,
    visibility: F64,
    up: F64,
    towards: F64,
    prior_sigmas: tuple[float, float] = _PRIOR_SIGMAS,
) -> Lamp:
    """Return the light that explains visible points: unit ``normals`` [M, 3] and ``linear`` colours [M, 3].

    ``visibility`` [M] selects the points. ``up`` [3] and ``towards`` [3] (from the person to the camera) are unit
    vectors in the same axes. ``prior_sigmas`` are of the direction (tangents) and of the log strength. Without enough
    points it is the usual light, from above and ahead.
    """
    some = np.flatnonzero(visibility > _MIN_VISIBILITY)
    some = some[:: max(1, len(some) // _MAX_POINTS)]
    left = np.cross(up, towards)
    axes = np.stack([left / np.linalg.norm(left), up, np.cross(left / np.linalg.norm(left), up)])
    usual = _USUAL_DIRECTION / np.linalg.norm(_USUAL_DIRECTION)
    start = np.array([0.0, 0.0, _USUAL_LOG_STRENGTH])
    if len(some) < _MIN_POINTS:
        return Lamp(usual @ axes, up, float(np.exp(_USUAL_LOG_STRENGTH)))
    colours = np.maximum(linear[some], 1e-3)
    brightness = np.log(colours.mean(axis=1))
    material = _materials(colours / colours.sum(axis=1, keepdims=True))
    across = np.stack([np.cross(usual, [0.0, 1.0, 0.0]), np.cross(usual, np.cross(usual, [0.0, 1.0, 0.0]))])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    local = normals[some] @ axes.T
    count = np.maximum(np.bincount(material, minlength=_MATERIALS), 1)

    def towards_lamp(x: F64) -> F64:
        lamp = usual + x[:2] @ across
        return np.asarray(lamp / np.linalg.norm(lamp))

    def residuals(x: F64) -> F64:
        shade = np.log(_shade(local, towards_lamp(x), np.array([0.0, 1.0, 0.0]), float(np.exp(x[2]))))
        albedo = np.bincount(material, brightness - shade, minlength=_MATERIALS) / count
        residual = (brightness - shade - albedo[material]) / _TEXTURE_SIGMA
        residual /= np.sqrt(1 + (residual / 2) ** 2)  # robust to prints on cloth
        prior = (x - start) / np.array(prior_sigmas)[[0, 0, 1]]
        return np.concatenate([residual * np.sqrt(_DATA_WEIGHT / len(residual)), prior])

    def rows(x: F64, derive: bool) -> tuple[F64, F64]:
        value = residuals(x)
        step = 1e-4
        slopes = [(residuals(x + step * unit) - value) / step for unit in np.eye(3)] if derive else []
        return value, np.stack(slopes, axis=1) if derive else np.zeros((0, 0))

    best = least_squares(rows, start, _FIT_STEPS)
    return Lamp(towards_lamp(best) @ axes, up, float(np.exp(best[2])))


def _shade(normals: F64, direction: F64, up: F64, strength: float) -> F64:
    ambient = _FLOOR_FRACTION + (_CEILING_FRACTION - _FLOOR_FRACTION) * (0.5 + 0.5 * (normals @ up))
    lamp = np.maximum((normals @ direction + _WRAP) / (1 + _WRAP), 0)
    return np.asarray(ambient + strength * lamp)


def _materials(chroma: F64) -> NDArray[np.intp]:
    """Return [M] the material of each chromaticity [M, 3], by k-means."""
    count = min(_MATERIALS, len(np.unique(chroma.round(6), axis=0)))  # grey pictures have one
    return np.asarray(kmeans2(chroma, count, minit="++", seed=0)[1], np.intp)
