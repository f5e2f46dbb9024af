"""What a lid that is shut looks like: the skin around the eye, continued, with a lid's own shading."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.extras.authoring.faces.openings import LidEdges, Opening
from glsplat.splats import SH_C0, Splats

__all__ = ["lid_colours"]

F64 = NDArray[np.float64]

_AROUND, _APART = 0.034, np.radians(8)  # metres from an eye's middle, and beyond the opening, where skin is looked for
_NEAR = np.radians(20)  # beyond the opening, over which what is found there counts less and less
_USUAL = 0.6  # of what lies around, darker than skin: brows, lashes, shade
_ALIKE = 0.18  # of 1, from the middle colour of the rest, by which skin may differ
_ROUNDS, _DOUBT, _LEAST = 8, 2.5, 0.012  # of the fit; standard deviations that are skin; one of those at least
_FAIR = 3.0  # times as many where it is lighter: shade, lashes and brows are dark
_RANGE = 0.95, 1.12  # of the skin's mean light, that a lid has: a quadratic runs away where nothing holds it
_HUES = 0.94, 1.06  # the same of its hue
_RUDDY = 1.06  # power of the hue: lids are thin
_CREASE = 0.11, 0.0014, 0.0012  # how dark, metres above the opening, and how wide
_EDGE = 0.10, 0.0012  # how dark the skin is at the lashes, and over how many metres
_CORNERS = 0.04  # how dark towards both corners
_BLEND = np.radians((5, 13))  # beyond the opening, over which a lid becomes as light as what is there ...
_SHADE = 0.8, 1.05  # ... by so much at most: brows are there, too
_NEIGHBOURS = 6


class _SkinAbout(NamedTuple):
    """The skin around an eye, as if brows, lashes, glasses and the eye itself were not there."""

    ball: Eyeball
    light: F64  # [6] of a quadratic of x and y
    hue: F64  # [3, 3] of a plane: red, green and blue, in shares of their mean
    usual_hue: F64  # [3]
    usual: float  # light in the middle

    def at(self, ways: F64, ruddy: float = 1.0) -> F64:
        """[N, 3] sRGB in ways [N, 3] metres from the eye's middle; ``ruddy`` is a power of its hue."""
        terms = _terms(ways, self.ball)
        hue = (self.usual_hue * (terms[:, :3] @ self.hue / self.usual_hue).clip(*_HUES)) ** ruddy
        light = (terms @ self.light).clip(self.usual * _RANGE[0], self.usual * _RANGE[1])
        return np.asarray(light[:, None] * hue / hue.mean(axis=1, keepdims=True))


def lid_colours(splats: Splats, places: F64, eye: Opening) -> F64:
    """[N, 3] sRGB at ``places`` [N, 3] of the lid that shuts before an ``eye``; grey where ``splats`` show no skin."""
    here = places - eye.ball.centre
    skin, shaded = _skin_about(splats, eye), _shading(here, *eye)[:, None]
    if skin is None:
        return np.full((len(places), 3), 0.5) * shaded
    rgb = skin.at(here, _RUDDY) * shaded
    share = ((eye.edges.beyond(here) - _BLEND[0]) / (_BLEND[1] - _BLEND[0])).clip(0, 1)[:, None]
    _, nearest = cKDTree(np.where(splats.finite()[:, None], splats.means, 0)).query(places, k=_NEIGHBOURS)
    around = (splats.sh[nearest, 0].astype(np.float64) * SH_C0 + 0.5).mean(axis=(1, 2))[:, None]
    light = (around / rgb.mean(axis=1, keepdims=True)).clip(*_SHADE)
    return np.asarray((rgb * (1 + share * (light - 1))).clip(0, 1))


def _skin_about(splats: Splats, eye: Opening) -> _SkinAbout | None:
    """By iteratively reweighted least squares (Tukey's biweight: Beaton and Tukey 1974); None where no skin is seen."""
    ball, edges = eye
    rgb, ways = splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, splats.means.astype(np.float64) - ball.centre
    about = (np.linalg.norm(ways, axis=1) < _AROUND) & (ways[:, 2] > 0) & splats.finite()
    beyond = np.zeros(len(ways))
    beyond[about] = edges.beyond(ways[about])
    about &= (beyond > _APART) & (np.linalg.norm(ways, axis=1) > ball.radius)
    if not about.any():
        return None
    found, at, close = rgb[about], ways[about], np.exp(-beyond[about] / _NEAR)
    light = found.mean(axis=1)
    hue = np.median(found[light >= np.quantile(light, _USUAL)], axis=0).clip(1e-3)
    off = np.linalg.norm(found - hue, axis=1)
    alike = off <= max(_ALIKE, off.min())
    found, at, light, close = found[alike], at[alike], light[alike], close[alike]
    sure, terms = np.ones(len(at)), _terms(at, ball)
    bent = 1e-3 * len(at) * np.diag([1e-6, 0.1, 0.1, 1, 1, 1])  # where skin is seen on one side alone, nothing bends
    for _ in range(_ROUNDS):
        held = terms * (sure * close)[:, None]
        solved = np.linalg.solve(held.T @ terms + bent, held.T @ light)
        rest = light - terms @ solved
        spread = max(float(np.median(np.abs(rest))), _LEAST) * np.where(rest < 0, 1, _FAIR)
        sure = (1 - (rest / (_DOUBT * spread)) ** 2).clip(1e-3, 1) ** 2
    shares, plane = found / light[:, None].clip(_LEAST), terms[:, :3] * (sure * close)[:, None]
    even = 1e-2 * len(at) * np.diag([1e-6, 1, 1])
    hues = np.linalg.solve(plane.T @ terms[:, :3] + even, plane.T @ shares)
    return _SkinAbout(ball, solved, hues, hue / hue.mean(), float(np.average(light, weights=sure)))


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
