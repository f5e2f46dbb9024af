"""The parameters of splats during a descent, and one step of bounded Adam on them, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.compute.compiled import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

COUNT = 13
"""Parameters of a splat: shift in cells 3, log growth 3, turn (rotation vector) 3, logit of the opacity, colour 3."""
Bounds = tuple[float, float, float, float, float, float]
"""Largest shift, smallest and largest log growth, largest turn, smallest and largest logit."""

_MIN_WEIGHT_PX = 0.05  # splats that a picture hardly shows are not moved by it


@compiled
def compose(
    first: int,
    last: int,
    values: F32,  # [N, COUNT]
    start: tuple[F64, F64, F64, F64],  # means [N, 3], rotations [N, 3, 3], logarithms of the scales, cells [N]
    placed: tuple[F64, F64, F64, F64, F64],  # written
) -> None:
    """Write the splats first to last of these parameters, in the zero pose."""
    means0, rotations0, logs0, cells = start
    means, rotations, scales, opacities, rgb = placed
    turn = np.empty((3, 3))
    for i in range(first, last):
        for k in range(3):
            means[i, k] = means0[i, k] + values[i, k] * cells[i]
            scales[i, k] = math.exp(logs0[i, k] + values[i, 3 + k])
            rgb[i, k] = values[i, 10 + k]
        opacities[i] = 1 / (1 + math.exp(-values[i, 9]))
        x, y, z = float(values[i, 6]), float(values[i, 7]), float(values[i, 8])
        angle = math.sqrt(x * x + y * y + z * z)
        s, c = 1.0, 0.5  # Rodrigues' formula
        if angle > 1e-6:
            s, c = math.sin(angle) / angle, (1 - math.cos(angle)) / (angle * angle)
        turn[0, 0], turn[0, 1], turn[0, 2] = 1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
        turn[1, 0], turn[1, 1], turn[1, 2] = c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x
        turn[2, 0], turn[2, 1], turn[2, 2] = c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)
        for r in range(3):
            for k in range(3):
                rotations[i, r, k] = (
                    rotations0[i, r, 0] * turn[0, k]
                    + rotations0[i, r, 1] * turn[1, k]
                    + rotations0[i, r, 2] * turn[2, k]
                )


@compiled
def pose(
    first: int,
    last: int,
    blended: F32,  # [N, 3, 4]
    turned: F32,  # [N, 3, 3]
    means: F64,
    rotations: F64,
    out_means: F64,
    out_rotations: F64,
) -> None:
    """Write the splats first to last, moved by their blended bones and turned."""
    for i in range(first, last):
        for r in range(3):
            out_means[i, r] = (
                blended[i, r, 0] * means[i, 0]
                + blended[i, r, 1] * means[i, 1]
                + blended[i, r, 2] * means[i, 2]
                + blended[i, r, 3]
            )
            for k in range(3):
                out_rotations[i, r, k] = (
                    turned[i, r, 0] * rotations[i, 0, k]
                    + turned[i, r, 1] * rotations[i, 1, k]
                    + turned[i, r, 2] * rotations[i, 2, k]
                )


@compiled
def step(
    first: int,
    last: int,
    gradients: F64,  # [N, kernels.GRADIENTS], in the axes of the zero pose
    values: F32,  # [N, COUNT], updated, as are the two moments and the step counts
    moments: F32,
    powers: F32,
    counts: F32,
    cells: F64,
    rates: F64,  # [COUNT]
    shrink: F64,  # [COUNT] decoupled weight decay, fraction of the rates
    bounds: Bounds,
) -> None:
    """Apply Adam (Kingma and Ba 2015; decays 0.9 and 0.99) to the rows that the picture shows, then the bounds."""
    shift, least, most, turn, low, high = bounds
    slope = np.empty(COUNT)
    for i in range(first, last):
        if not gradients[i, 13] > _MIN_WEIGHT_PX:
            continue
        for k in range(3):
            slope[k] = gradients[i, k] * cells[i]
            slope[3 + k], slope[6 + k], slope[10 + k] = gradients[i, 3 + k], gradients[i, 6 + k], gradients[i, 10 + k]
        slope[9] = gradients[i, 9] * (1 - 1 / (1 + math.exp(-values[i, 9])))
        counts[i] += 1
        first_left, second_left = 1 - 0.9 ** counts[i], 1 - 0.99 ** counts[i]
        for k in range(COUNT):
            moments[i, k] += np.float32(0.1 * (slope[k] - moments[i, k]))
            powers[i, k] += np.float32(0.01 * (slope[k] * slope[k] - powers[i, k]))
            mean, power = moments[i, k] / first_left, powers[i, k] / second_left
            values[i, k] -= np.float32(rates[k] * (mean / (math.sqrt(power) + 1e-20) + shrink[k]))
        length = math.sqrt(values[i, 0] ** 2 + values[i, 1] ** 2 + values[i, 2] ** 2)
        for k in range(3):
            if length > shift:
                values[i, k] *= np.float32(shift / length)
            values[i, 3 + k] = min(max(values[i, 3 + k], least), most)
            values[i, 6 + k] = min(max(values[i, 6 + k], -turn), turn)
            values[i, 10 + k] = min(max(values[i, 10 + k], 0.0), 1.0)
        values[i, 9] = min(max(values[i, 9], low), high)
