"""The pixel contract and its derivatives in numpy: each splat's contribution to each pixel, and its gradient.

Vectorised over (splat, pixel) pairs: a 512x512 picture of 40,000 splats takes a fraction of a second. Fits of splats
to pictures use it; the projection is that of reference.py. Formulas: EWA projection and front-to-back
compositing of 3D Gaussian Splatting (Kerbl et al. 2023), differentiated by hand; the projection's Jacobian counts as
constant under a moving mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera
from glsplat.reference import AA_FLOOR, dilated_covariances, jacobians

EPS2D, ALPHA_MAX, ALPHA_MIN, MAX_SIGMA = 0.3, 0.99, 1 / 255, 3.33  # px^2, and the rest of docs/conventions.md


@dataclass(frozen=True, slots=True, eq=False)
class SplatGradients:
    """Derivatives of a loss by the splats of a view; zero for splats that it does not show."""

    means: F64  # [N, 3] by world position, metres
    log_scales: F64  # [N, 3]
    turns: F64  # [N, 3] by a small rotation about the splat's own axes
    opacities: F64  # [N]
    rgb: F64  # [N, 3]
    weight: F64  # [N] sum over pixels of alpha times transmittance


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """All (splat, pixel) pairs of a view, grouped by pixel, near to far."""

    splat: NDArray[np.int64]  # [E]
    pixel: NDArray[np.int64]  # [E] row * width + column, ascending
    alpha: F64  # [E]
    transmittance: F64  # [E] of the pairs in front
    offset: F64  # [2, E] pixel centre minus splat centre
    conic: F64  # [N, 3] inverse of the dilated covariance: a, b, c of [[a, b], [b, c]]
    to_pixels: F64  # [N, 2, 3] Jacobian of the projection by world position
    axes: F64  # [N, 2, 3] principal axes of the splat (unit, without scales) on the screen
    count: int
    shape: tuple[int, int]
    compensation: F64 | None = None  # [N, 2, 2] slope of its logarithm by the covariance; None: without antialias

    def picture(self, rgb: F64) -> F64:
        """Return the premultiplied picture of ``rgb`` [N, 3], RGBA [H, W, 4], over nothing."""
        weight = self.alpha * self.transmittance
        size = self.shape[0] * self.shape[1]
        columns = [np.bincount(self.pixel, weight * c[self.splat], minlength=size) for c in rgb.T]
        columns.append(np.bincount(self.pixel, weight, minlength=size))
        return np.stack(columns, axis=1).reshape(*self.shape, 4).astype(np.float64)

    def backward(self, by_picture: F64, rgb: F64, opacities: F64, scales: F64) -> SplatGradients:
        """Return the gradients by the splats for the gradient ``by_picture`` [H, W, 4] by the picture."""
        g = by_picture.reshape(-1, 4)[self.pixel]
        weight = self.alpha * self.transmittance
        by_weight = np.einsum("ec,ec->e", g[:, :3], rgb[self.splat]) + g[:, 3]
        # behind[e]: sum over the farther pairs of the pixel of weight * by_weight
        gain = weight * by_weight
        running = np.cumsum(gain)
        last = np.flatnonzero(np.append(self.pixel[1:] != self.pixel[:-1], True))
        ends = np.repeat(last, np.diff(np.append(-1, last)))
        behind = running[ends] - running
        by_alpha = self.transmittance * by_weight - behind / (1 - self.alpha)
        free = self.alpha < ALPHA_MAX  # no slope where alpha is capped
        by_exponent = np.where(free, by_alpha * self.alpha, 0.0)

        n = self.count
        total = [np.bincount(self.splat, weight * g[:, c], minlength=n) for c in range(3)]
        by_opacity = np.bincount(self.splat, by_exponent, minlength=n) / np.maximum(opacities, 1e-6)
        dx, dy = self.offset
        a, b, c = self.conic.T
        # alpha = opacity exp(-q / 2), q = offset^T conic offset
        sums = [np.bincount(self.splat, by_exponent * v, minlength=n) for v in (dx, dy, dx * dx, dx * dy, dy * dy)]
        by_centre = np.stack([a * sums[0] + b * sums[1], b * sums[0] + c * sums[1]], axis=1)
        outer = np.stack([sums[2], sums[3], sums[3], sums[4]], axis=1).reshape(n, 2, 2)
        conic = np.stack([a, b, b, c], axis=1).reshape(n, 2, 2)
        by_cov = 0.5 * conic @ outer @ conic
        if self.compensation is not None:
            by_cov += np.bincount(self.splat, by_exponent, minlength=n)[:, None, None] * self.compensation
        by_scale2 = np.einsum("nik,nij,njk->nk", self.axes, by_cov, self.axes)
        # covariance = A S^2 A^T with A the axes: turning axis i towards j changes it by their products
        mixed = np.einsum("nki,nkl,nlj->nij", self.axes, by_cov, self.axes) * 2
        lean = mixed * (scales**2)[:, None, :]  # derivative by axis column j moving along axis i
        turns = np.stack(
            [lean[:, 2, 1] - lean[:, 1, 2], lean[:, 0, 2] - lean[:, 2, 0], lean[:, 1, 0] - lean[:, 0, 1]], axis=1
        )
        return SplatGradients(
            means=np.einsum("nij,ni->nj", self.to_pixels, by_centre),
            log_scales=2 * scales**2 * by_scale2,
            turns=turns,
            opacities=by_opacity,
            rgb=np.stack(total, axis=1),
            weight=np.bincount(self.splat, weight, minlength=n).astype(np.float64),
        )


def footprints(
    means: F64,
    rotations: F64,
    scales: F64,
    opacities: F64,
    camera: Camera,
    beyond: F64 | None = None,
    eps2d: float = EPS2D,
    antialias: bool = False,
) -> Footprints:
    """Project splats (means [N, 3], rotations [N, 3, 3], scales [N, 3], opacities [N]) and list the pixels they cover.

    ``beyond`` [H, W], metres: the largest camera z drawn at each pixel. ``eps2d``: the dilation, px^2; ``antialias``
    lowers the opacity by the factor that the dilation adds to the area (RenderConfig.antialias).
    """
    view, shift = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    width, height = camera.width, camera.height
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    x, y, depth = (means @ view.T + shift).T
    visible = depth > camera.near
    z = np.where(visible, depth, 1.0)
    to_pixels = jacobians(x, y, z, camera) @ view
    axes = to_pixels @ rotations
    a, b, c, sharp, det = dilated_covariances(axes * scales[:, None, :], eps2d)
    conic = np.stack([c, -b, a], axis=1) / det[:, None]
    slope = None
    if antialias:
        kept = sharp / det
        opacities = opacities * np.sqrt(np.maximum(kept, AA_FLOOR))
        inverse = np.stack([c - eps2d, -b, -b, a - eps2d], axis=1) / np.maximum(sharp, 1e-30)[:, None]
        slope = 0.5 * np.where(kept[:, None] > AA_FLOOR, inverse - conic[:, [0, 1, 1, 2]], 0.0).reshape(-1, 2, 2)
    u, v = fx * x / z + cx, fy * y / z + cy
    extent = np.minimum(MAX_SIGMA, np.sqrt(2 * np.log(np.maximum(opacities / ALPHA_MIN, 1))))
    left, right = _span(u, extent * np.sqrt(a), width)
    top, bottom = _span(v, extent * np.sqrt(c), height)
    wide = np.maximum(right - left + 1, 0)
    count = np.where(visible & (opacities >= ALPHA_MIN), wide * np.maximum(bottom - top + 1, 0), 0)

    order = np.argsort(z.astype(np.float32), kind="stable")
    each = count[order]
    splat = np.repeat(order, each)
    inside = np.arange(len(splat)) - np.repeat(np.cumsum(each) - each, each)
    column, row = left[splat] + inside % wide[splat], top[splat] + inside // wide[splat]
    dx, dy = column + 0.5 - u[splat], row + 0.5 - v[splat]
    p, q, r = conic.T
    alpha = opacities[splat] * np.exp(-0.5 * (p[splat] * dx * dx + 2 * q[splat] * dx * dy + r[splat] * dy * dy))
    keep = alpha >= ALPHA_MIN
    if beyond is not None:
        keep &= z[splat] <= beyond[row, column]
    splat, alpha, dx, dy = splat[keep], np.minimum(alpha[keep], ALPHA_MAX), dx[keep], dy[keep]
    pixel = (row * width + column)[keep]
    group = np.argsort(pixel, kind="stable")  # keeps near to far inside a pixel
    splat, alpha, pixel = splat[group], alpha[group], pixel[group]
    offset = np.stack([dx[group], dy[group]])
    passed = transmittance(pixel, alpha)
    shape = (height, width)
    return Footprints(splat, pixel, alpha, passed, offset, conic, to_pixels, axes, len(means), shape, slope)


def transmittance(pixel: NDArray[np.int32] | NDArray[np.int64], alpha: F64) -> F64:
    """Return the transmittance [E] in front of each pair; pairs are grouped by pixel, near to far."""
    log_pass = np.log1p(-alpha)
    before = np.cumsum(log_pass) - log_pass
    starts = np.append(True, pixel[1:] != pixel[:-1])[: len(pixel)]
    base = np.maximum.accumulate(np.where(starts, np.arange(len(pixel)), 0))
    return np.asarray(np.exp(before - before[base]), np.float64)


def _span(centre: F64, reach: F64, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and last pixel whose centre lies within ``reach`` of ``centre``, clipped to the picture."""
    low = np.clip(np.ceil(centre - reach - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.floor(centre + reach - 0.5), -1, size - 1).astype(np.int64)
    return low, high
