"""Colours of splats that give back the pictures they were taken from: a linear problem, solved as one.

A splat takes the mean of its cell, and a picture of overlapping splats blurs that once more. With their shapes held, a
picture is a sparse matrix times their colours; conjugate gradients find the colours nearest to the first ones with
which it equals the photograph.
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

__all__ = ["sharpened"]

F64 = NDArray[np.float64]

_FIGURE = 900.0  # pixels of the person's height that are looked at
_LOYALTY = 0.6  # pixels that a splat's first colour is worth
_DIGITS = 4  # of a colour, a fortieth of a step of 8 bits: the last bits of sums depend on the number of threads
_COVERED = 0.6  # a pixel less covered than that is the outline's
_MOST = 0.25  # how far a colour may go from the first one


def sharpened(avatar: Avatar, shots: Sequence[FittedPicture], rounds: int) -> Avatar:
    """The avatar with the colours of its seen splats solved for in so many rounds; the rest as it was."""
    splats = avatar.splats
    first = splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5
    rows, targets = [], []
    for shot in shots:
        matrix, target = _equations(avatar, shot)
        rows.append(matrix)
        targets.append(target)
    colours = first + _solve(rows, [t - m @ first for m, t in zip(rows, targets, strict=True)], len(first), rounds)
    colours = np.round(np.clip(colours, first - _MOST, first + _MOST).clip(0, 1), _DIGITS)
    made = Splats.create(
        splats.means, splats.quats, splats.scales, splats.opacities, rgb=colours, antialias=splats.antialias
    )
    return replace(avatar, splats=made)


def _equations(avatar: Avatar, shot: FittedPicture) -> tuple[csr_array, F64]:
    """What each splat adds to each pixel of the person, and the photograph there."""
    camera = shot.camera(avatar.skeleton.joints[0], _FIGURE)
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
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).ravel() > 0
    used = inner & (covered > _COVERED)
    number = np.cumsum(used) - 1
    keep = used[prints.pixel]
    pixel = prints.pixel[keep]
    shape = (int(used.sum()), len(splats.means))
    matrix = csr_array((weight[keep] / covered[pixel], (number[pixel], prints.splat[keep])), shape=shape)
    return matrix, small.reshape(-1, 3)[used] / 255


def _solve(rows: Sequence[csr_array], misses: Sequence[F64], count: int, rounds: int) -> F64:
    """[N, 3] the change that makes up for the misses, small where it is not needed; conjugate gradients."""
    change = np.zeros((count, 3))
    rest = sum((matrix.T @ miss for matrix, miss in zip(rows, misses, strict=True)), np.zeros((count, 3)))
    along = rest.copy()
    size = (rest * rest).sum(axis=0)
    for _ in range(rounds):
        moved = sum((matrix.T @ (matrix @ along) for matrix in rows), _LOYALTY * along)
        step = size / np.maximum((along * moved).sum(axis=0), 1e-12)
        change += step * along
        rest -= step * moved
        new = (rest * rest).sum(axis=0)
        along = rest + new / np.maximum(size, 1e-12) * along
        size = new
    return change
