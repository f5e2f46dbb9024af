"""Colour closed lids: the skin around the eye, continued, with a lid's own shading."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.extras.authoring.faces.openings import LidEdges, Opening
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.splats import SH_C0, Splats

_SEARCH_RADIUS_M, _MIN_GAP_RAD = 0.034, np.radians(8)  # around an eye's middle; beyond its opening
_FALLOFF_RAD = np.radians(20)  # of a sample's weight, beyond the opening
_DARK_QUANTILE = 0.6  # of the samples that are darker than skin: brows, lashes, shade
_MAX_SKIN_DISTANCE = 0.18  # sRGB, from the median of the brighter samples
_FIT_ROUNDS = 8
_OUTLIER_SIGMAS, _MIN_SIGMA = 2.5, 0.012  # of brightness
_BRIGHT_FACTOR = 3.0  # on the sigma of brighter samples, since shade, lashes and brows are dark
_LIGHT_RANGE = 0.95, 1.12  # of a lid over the mean: a quadratic may run away where it has no samples
_HUE_RANGE = 0.94, 1.06
_LID_HUE_POWER = 1.06  # lids are thin, so blood shows
_CREASE_DEPTH, _CREASE_ABOVE_M, _CREASE_SIGMA_M = 0.11, 0.0014, 0.0012  # darkening; above the opening; width
_LASH_EDGE_DEPTH, _LASH_EDGE_M = 0.10, 0.0012  # darkening at the lashes, and its reach
_CORNER_DEPTH, _CORNER_RAD, _CORNER_FADE_RAD = 0.04, np.radians(10), np.radians(12)  # darkening at both corners
_BLEND_RAD = np.radians((5, 13))  # beyond the opening: a lid takes the brightness of its surroundings ...
_BLEND_RANGE = 0.8, 1.05  # ... within these factors, because of brows
_NEIGHBOURS = 6


class _SkinModel(NamedTuple):
    """The skin around an eye, without brows, lashes, glasses and the eye itself."""

    ball: Eyeball
    light: F64  # [6] of a quadratic in x and y
    hue: F64  # [3, 3] of a plane: red, green and blue over their mean
    usual_hue: F64  # [3]
    usual: float  # light at the middle

    def at(self, offsets: F64, hue_power: float = 1.0) -> F64:
        """Return [N, 3] sRGB at ``offsets`` [N, 3], metres from the eye's middle; ``hue_power`` deepens the hue."""
        terms = _terms(offsets, self.ball)
        hue = (self.usual_hue * (terms[:, :3] @ self.hue / self.usual_hue).clip(*_HUE_RANGE)) ** hue_power
        light = (terms @ self.light).clip(self.usual * _LIGHT_RANGE[0], self.usual * _LIGHT_RANGE[1])
        return np.asarray(light[:, None] * hue / hue.mean(axis=1, keepdims=True))


def lid_colours(splats: Splats, places: F64, eye: Opening) -> F64:
    """Return [N, 3] sRGB at ``places`` [N, 3] of the closed lid of ``eye``; grey where ``splats`` show no skin."""
    offsets = places - eye.ball.centre
    skin, shaded = _fit_skin(splats, eye), _lid_shading(offsets, *eye)[:, None]
    if skin is None:
        return np.full((len(places), 3), 0.5) * shaded
    rgb = skin.at(offsets, _LID_HUE_POWER) * shaded
    share = ramp(eye.edges.beyond(offsets), *_BLEND_RAD)[:, None]
    _, nearest = cKDTree(np.where(splats.finite()[:, None], splats.means, 0)).query(places, k=_NEIGHBOURS)
    around = (splats.sh[nearest, 0].astype(np.float64) * SH_C0 + 0.5).mean(axis=(1, 2))[:, None]
    light = (around / rgb.mean(axis=1, keepdims=True)).clip(*_BLEND_RANGE)
    return np.asarray((rgb * (1 + share * (light - 1))).clip(0, 1))


def _fit_skin(splats: Splats, eye: Opening) -> _SkinModel | None:
    """Return the skin model, or None without visible skin.

    By iteratively reweighted least squares (Tukey's biweight: Beaton and Tukey 1974).
    """
    ball, edges = eye
    rgb, offsets = splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, splats.means.astype(np.float64) - ball.centre
    about = (np.linalg.norm(offsets, axis=1) < _SEARCH_RADIUS_M) & (offsets[:, 2] > 0) & splats.finite()
    beyond = np.zeros(len(offsets))
    beyond[about] = edges.beyond(offsets[about])
    about &= (beyond > _MIN_GAP_RAD) & (np.linalg.norm(offsets, axis=1) > ball.radius)
    if not about.any():
        return None
    samples, at, falloff = rgb[about], offsets[about], np.exp(-beyond[about] / _FALLOFF_RAD)
    light = samples.mean(axis=1)
    hue = np.median(samples[light >= np.quantile(light, _DARK_QUANTILE)], axis=0).clip(1e-3)
    difference = np.linalg.norm(samples - hue, axis=1)
    skin_like = difference <= max(_MAX_SKIN_DISTANCE, difference.min())
    samples, at, light, falloff = samples[skin_like], at[skin_like], light[skin_like], falloff[skin_like]
    weights, terms = np.ones(len(at)), _terms(at, ball)
    light_penalty = 1e-3 * len(at) * np.diag([1e-6, 0.1, 0.1, 1, 1, 1])  # keeps the fit flat with skin on one side only
    for _ in range(_FIT_ROUNDS):
        weighted = terms * (weights * falloff)[:, None]
        solved = np.linalg.solve(weighted.T @ terms + light_penalty, weighted.T @ light)
        residual = light - terms @ solved
        spread = max(float(np.median(np.abs(residual))), _MIN_SIGMA) * np.where(residual < 0, 1, _BRIGHT_FACTOR)
        weights = (1 - (residual / (_OUTLIER_SIGMAS * spread)) ** 2).clip(1e-3, 1) ** 2
    shares, plane = samples / light[:, None].clip(_MIN_SIGMA), terms[:, :3] * (weights * falloff)[:, None]
    hue_penalty = 1e-2 * len(at) * np.diag([1e-6, 1, 1])
    hues = np.linalg.solve(plane.T @ terms[:, :3] + hue_penalty, plane.T @ shares)
    return _SkinModel(ball, solved, hues, hue / hue.mean(), float(np.average(light, weights=weights)))


def _terms(offsets: F64, ball: Eyeball) -> F64:
    """Return [N, 6] the terms of a quadratic in x and y, in radii of the eye."""
    x, y = (offsets[:, :2] / ball.radius).T
    return np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)


def _lid_shading(offsets: F64, ball: Eyeball, edges: LidEdges) -> F64:
    """Return [N] a lid's light over the skin's: darker in the crease, at the lashes and in the corners."""
    low, high, aside = edges.above(offsets)
    radius = np.linalg.norm(offsets, axis=1)
    inside = (-aside / _CORNER_FADE_RAD).clip(0, 1)
    crease = _CREASE_DEPTH * np.exp(-0.5 * ((high * radius - _CREASE_ABOVE_M) / _CREASE_SIGMA_M) ** 2)
    lashes = _LASH_EDGE_DEPTH * np.exp(-np.abs(low * radius) / _LASH_EDGE_M)
    return np.asarray(1 - inside * (crease + lashes) - _CORNER_DEPTH * np.exp(-((aside / _CORNER_RAD) ** 2)))
