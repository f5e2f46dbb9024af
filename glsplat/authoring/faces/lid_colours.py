"""What a lid that is shut looks like: the skin around the eye, continued, with a lid's own shading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.authoring.faces.eyeballs import Eyeball
from glsplat.authoring.faces.openings import LidEdges
from glsplat.splats import SH_C0, Splats

__all__ = ["lid_colours"]

F64 = NDArray[np.float64]

_AROUND, _APART = 0.034, np.radians(8)  # metres from an eye's middle, and beyond the opening, where skin is looked for
_NEAR = np.radians(20)  # beyond the opening, over which what is found there counts less and less
_USUAL = 0.6  # of what lies around, darker than skin: brows, lashes, shade
_ALIKE = 0.18  # of 1, from the middle colour of the rest, by which skin may differ
_ROUNDS, _DOUBT, _LEAST = 8, 2.5, 0.012  # of the fit; standard deviations that are skin; one of those at least
_FAIR = 3.0  # times as many where it is lighter: shade, lashes and brows are dark
_RANGE = 0.84, 1.12  # of the skin's mean light, that a lid has: a quadratic runs away where nothing holds it
_FINE, _MOST = 0.7, 0.08  # share of the skin's own variation, and how much of its light that is at most
_CREASE = 0.16, 0.0014, 0.0012  # how dark, metres above the opening, and how wide
_EDGE = 0.10, 0.0012  # how dark the skin is at the lashes, and over how many metres
_CORNERS = 0.06  # how dark towards both corners


def lid_colours(splats: Splats, places: F64, ball: Eyeball, edges: LidEdges) -> F64:
    """[N, 3] sRGB at ``places`` [N, 3] of the lid that is shut before ``ball``; grey where ``splats`` show no skin.

    A quadratic of x and y is fitted to the skin around by iteratively reweighted least squares (Tukey's biweight:
    Beaton and Tukey 1974), so that brows, lashes and glasses do not count; what the skin below the eye differs from it
    by is the fine variation of the lid.
    """
    rgb, ways = splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, splats.means.astype(np.float64) - ball.centre
    about = (np.linalg.norm(ways, axis=1) < _AROUND) & (ways[:, 2] > 0) & splats.finite()
    beyond = np.zeros(len(ways))
    beyond[about] = edges.beyond(ways[about])
    about &= (beyond > _APART) & (np.linalg.norm(ways, axis=1) > ball.radius)
    shaded = _shading(places - ball.centre, ball, edges)[:, None]
    if not about.any():
        return np.full((len(places), 3), 0.5) * shaded
    found, at, close = rgb[about], ways[about], np.exp(-beyond[about] / _NEAR)
    light = found.mean(axis=1)
    hue = np.median(found[light >= np.quantile(light, _USUAL)], axis=0).clip(1e-3)  # lids have one
    off = np.linalg.norm(found - hue, axis=1)
    alike = off <= max(_ALIKE, off.min())
    at, light, close = at[alike], light[alike], close[alike]
    sure, terms = np.ones(len(at)), _terms(at, ball)
    bent = 1e-3 * len(at) * np.diag([1e-6, 0.1, 0.1, 1, 1, 1])  # where skin is seen on one side alone, nothing bends
    for _ in range(_ROUNDS):
        held = terms * (sure * close)[:, None]
        rest = light - terms @ np.linalg.solve(held.T @ terms + bent, held.T @ light)
        spread = max(float(np.median(np.abs(rest))), _LEAST) * np.where(rest < 0, 1, _FAIR)
        sure = (1 - (rest / (_DOUBT * spread)) ** 2).clip(1e-3, 1) ** 2
    here, usual = places - ball.centre, float(np.average(light, weights=sure * close))
    smooth = _terms(here, ball) @ np.linalg.solve(held.T @ terms + bent, held.T @ light)
    smooth = np.clip(smooth, usual * _RANGE[0], usual * _RANGE[1])
    below = here - (0, ball.radius * np.sin(0.5 * float(np.max(edges.upper - edges.lower)) + _APART), 0)
    fine = (rest / light.clip(0.05))[cKDTree(at[:, :2]).query(below[:, :2])[1]].clip(-_MOST, _MOST)
    return np.asarray((((smooth * (1 + _FINE * fine))[:, None] * (hue / hue.mean())) * shaded).clip(0, 1))


def _terms(ways: F64, ball: Eyeball) -> F64:
    """[N, 6] the terms of a quadratic of x and y, in radii of the eye."""
    x, y = (ways[:, :2] / ball.radius).T
    return np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)


def _shading(ways: F64, ball: Eyeball, edges: LidEdges) -> F64:
    """[N] of the skin's light, what is left on a lid: less in the crease above it, at its lashes and in the corners."""
    low, high, aside = edges.above(ways)
    far = np.linalg.norm(ways, axis=1)
    dark, up, wide = _CREASE
    inside = (-aside / np.radians(12)).clip(0, 1)
    crease = dark * np.exp(-0.5 * ((high * far - up) / wide) ** 2)
    edge, over = _EDGE
    lashes = edge * np.exp(-np.abs(low * far) / over)
    return np.asarray(1 - inside * (crease + lashes) - _CORNERS * np.exp(-((aside / np.radians(10)) ** 2)))
