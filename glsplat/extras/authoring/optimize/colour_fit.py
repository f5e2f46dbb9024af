"""Colours of splats solved for so that their pictures equal the photographs: a linear least-squares problem.

A splat starts with the mean colour of its cell, and overlapping splats blur that once more. With fixed shapes, a
picture is a sparse matrix times the colours; conjugate gradients solve for the colours, regularized towards the first
ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.footprints import footprints
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.rotations import nearest_rotations, quaternion_matrices
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0, Splats

F64 = NDArray[np.float64]

_PERSON_HEIGHT_PX = 900.0  # in the resampled photographs
_PRIOR_WEIGHT_PX = 0.6  # weight of a splat's first colour
_COLOUR_DECIMALS = 4  # the last bits of sums depend on the number of threads
_MIN_COVERAGE = 0.6  # of a pixel; less is the outline
_MAX_COLOUR_CHANGE = 0.25


def fit_colours(avatar: Avatar, shots: Sequence[FittedPicture], rounds: int) -> Avatar:
    """Return the avatar with the colours of its visible splats solved for in ``rounds`` of conjugate gradients."""
    splats = avatar.splats
    first = splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5
    rows, targets = [], []
    for shot in shots:
        matrix, target = _equations(avatar, shot)
        rows.append(matrix)
        targets.append(target)
    colours = first + _solve(rows, [t - m @ first for m, t in zip(rows, targets, strict=True)], len(first), rounds)
    colours = np.clip(colours, first - _MAX_COLOUR_CHANGE, first + _MAX_COLOUR_CHANGE)
    colours = np.round(colours.clip(0, 1), _COLOUR_DECIMALS)
    made = Splats.create(
        splats.means, splats.quats, splats.scales, splats.opacities, rgb=colours, antialias=splats.antialias
    )
    return replace(avatar, splats=made)


def _equations(avatar: Avatar, shot: FittedPicture) -> tuple[csr_array, F64]:
    """Return each splat's share of each pixel [P, N] of the person, and the photograph there [P, 3]."""
    camera = shot.camera(avatar.skeleton.joints[0], _PERSON_HEIGHT_PX)
    height, width = camera.height, camera.width
    splats, skin = avatar.splats, avatar.skin
    bones = Pose(shot.view.rotations).bones(avatar.skeleton)
    blended = np.einsum("nk,nkij->nij", skin.weights.astype(np.float64), bones[skin.joints.astype(np.intp)])
    means = np.einsum("nij,nj->ni", blended[:, :, :3], splats.means.astype(np.float64)) + blended[:, :, 3]
    turned = nearest_rotations(blended[:, :, :3]) @ quaternion_matrices(splats.quats.astype(np.float64))
    prints = footprints(means, turned, splats.scales.astype(np.float64), splats.opacities.astype(np.float64), camera)
    weight = prints.alpha * prints.transmittance
    covered = np.bincount(prints.pixel, weight, minlength=height * width)
    small, mask = shot.resized(camera)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~shot.unused_pixels(camera)
    used = inner.ravel() & (covered > _MIN_COVERAGE)
    number = np.cumsum(used) - 1
    keep = used[prints.pixel]
    pixel = prints.pixel[keep]
    shape = (int(used.sum()), len(splats.means))
    matrix = csr_array((weight[keep] / covered[pixel], (number[pixel], prints.splat[keep])), shape=shape)
    return matrix, small.reshape(-1, 3)[used] / 255


def _solve(rows: Sequence[csr_array], residuals: Sequence[F64], count: int, rounds: int) -> F64:
    """Return the regularized least-squares change [N, 3] for these residuals, by conjugate gradients."""
    change = np.zeros((count, 3))
    rest = sum((matrix.T @ residual for matrix, residual in zip(rows, residuals, strict=True)), np.zeros((count, 3)))
    along = rest.copy()
    size = (rest * rest).sum(axis=0)
    for _ in range(rounds):
        moved = sum((matrix.T @ (matrix @ along) for matrix in rows), _PRIOR_WEIGHT_PX * along)
        step = size / np.maximum((along * moved).sum(axis=0), 1e-12)
        change += step * along
        rest -= step * moved
        new = (rest * rest).sum(axis=0)
        along = rest + new / np.maximum(size, 1e-12) * along
        size = new
    return change
