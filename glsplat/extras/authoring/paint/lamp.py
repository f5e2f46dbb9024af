"""Where the light of a picture comes from, so that sides it does not show are as dark as they would be.

The model is the one of a soft lamp and a room: an ambient part that grows from the floor to the ceiling, and a lamp
that wraps around the form. Its direction and strength are fitted to the brightness of the seen surface; clothes of any
colours are told apart by their chromaticity, each with a brightness of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from glsplat.extras.authoring.compute.levenberg import least_squares

__all__ = ["Lamp", "find_light"]

F64 = NDArray[np.float64]

_FLOOR, _CEILING = 0.7, 1.3  # ambient light from below and from above, in shares of the ambient light
_WRAP = 0.15
_USUAL = np.array([0.3, 0.7, 0.65])  # a lamp above and before the person
_LEAN, _STRENGTH, _STRENGTHS = 0.45, np.log(1.4), 0.35  # doubts of the prior, and the lamp's usual strength
_COLOURS = 8  # kinds of surface that are told apart
_MOST = 3000  # points that are looked at
_SPREAD = 0.25  # of the logarithm of brightness within a kind: its texture


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """``shade`` says how bright a surface is against one without the lamp."""

    direction: F64  # [3] unit, towards the lamp; axes of the normals it was found from
    up: F64  # [3] unit, in the same axes
    strength: float  # of the lamp, in shares of the ambient light

    def shade(self, normals: F64) -> F64:
        """[M] relative brightness of surfaces with unit normals [M, 3]."""
        return _shade(normals, self.direction, self.up, self.strength)


def find_light(
    normals: F64,
    linear: F64,
    trust: F64,
    up: F64,
    towards: F64,
    doubts: tuple[float, float] = (_LEAN, _STRENGTHS),  # of the prior: the lamp's direction, the log of its strength
) -> Lamp:
    """The light on seen points: unit ``normals`` [M, 3], ``linear`` colours [M, 3], ``trust`` [M].

    ``up`` [3] and ``towards`` [3] (from the person to the camera) are unit vectors in the same axes.
    """
    some = np.flatnonzero(trust > 0.3)
    some = some[:: max(1, len(some) // _MOST)]
    left = np.cross(up, towards)
    axes = np.stack([left / np.linalg.norm(left), up, np.cross(left / np.linalg.norm(left), up)])
    usual = _USUAL / np.linalg.norm(_USUAL)
    start = np.array([0.0, 0.0, _STRENGTH])
    if len(some) < 100:
        return Lamp(usual @ axes, up, float(np.exp(_STRENGTH)))
    colours = np.maximum(linear[some], 1e-3)
    brightness = np.log(colours.mean(axis=1))
    kind = _kinds(colours / colours.sum(axis=1, keepdims=True))
    across = np.stack([np.cross(usual, [0.0, 1.0, 0.0]), np.cross(usual, np.cross(usual, [0.0, 1.0, 0.0]))])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    local = normals[some] @ axes.T
    count = np.maximum(np.bincount(kind, minlength=_COLOURS), 1)

    def towards_lamp(x: F64) -> F64:
        lamp = usual + x[:2] @ across
        return np.asarray(lamp / np.linalg.norm(lamp))

    def misfit(x: F64) -> F64:
        shade = np.log(_shade(local, towards_lamp(x), np.array([0.0, 1.0, 0.0]), float(np.exp(x[2]))))
        albedo = np.bincount(kind, brightness - shade, minlength=_COLOURS) / count
        off = (brightness - shade - albedo[kind]) / _SPREAD
        off /= np.sqrt(1 + (off / 2) ** 2)  # what is printed on cloth must not count as light
        prior = np.array([x[0] / doubts[0], x[1] / doubts[0], (x[2] - _STRENGTH) / doubts[1]])
        return np.concatenate([off * np.sqrt(60 / len(off)), prior])

    def rows(x: F64, derive: bool) -> tuple[F64, F64]:
        at = misfit(x)
        step = 1e-4
        slopes = [(misfit(x + step * unit) - at) / step for unit in np.eye(3)] if derive else []
        return at, np.stack(slopes, axis=1) if derive else np.zeros((0, 0))

    best = least_squares(rows, start, 12)
    return Lamp(towards_lamp(best) @ axes, up, float(np.exp(best[2])))


def _shade(normals: F64, direction: F64, up: F64, strength: float) -> F64:
    ambient = _FLOOR + (_CEILING - _FLOOR) * (0.5 + 0.5 * (normals @ up))
    lamp = np.maximum((normals @ direction + _WRAP) / (1 + _WRAP), 0)
    return np.asarray(ambient + strength * lamp)


def _kinds(chroma: F64) -> NDArray[np.intp]:
    """[M] which of a few kinds of surface each colour belongs to."""
    count = min(_COLOURS, len(np.unique(chroma.round(6), axis=0)))  # of a picture without colours there is one
    return np.asarray(kmeans2(chroma, count, minit="++", seed=0)[1], np.intp)
