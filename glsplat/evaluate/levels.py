"""Fewer splats of one scene: neighbours merged by their moments. Plain on purpose; it is what the report calls a level.

A scene made anew with fewer splats (``glsplat avatar make --splats``) is better than one merged from many.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.detail.cells import cells
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["merged"]

F64 = NDArray[np.float64]


def merged(scene: Splats | Avatar, count: int) -> Splats | Avatar:
    """``count`` splats in place of more: each is a cell of neighbours with their mean, covariance and mean colour.

    Opacity is such that opacity times area is kept, area being the product of the two larger deviations; above 1 it is
    cut. Splats that are not finite or transparent are left out. An avatar's splats take the mean of their weights.
    """
    splats = scene.splats if isinstance(scene, Avatar) else scene
    usable = np.flatnonzero(splats.finite() & (splats.opacities > 0) & (np.abs(splats.quats).max(-1, initial=0) > 0))
    if count >= len(usable):
        return scene
    few = splats.take(usable)
    means = few.means.astype(np.float64)
    rotations = reference.quaternion_matrices(few.quats)
    scales = np.abs(few.scales.astype(np.float64))
    cell = cells(means, count)

    area = _area(scales)
    weight = few.opacities.astype(np.float64) * area
    weight = np.maximum(weight, weight.max() * 1e-12)
    total = np.bincount(cell, weight, count)

    def mean_of(values: F64) -> F64:
        flattened = values.reshape(len(values), -1)
        sums = np.stack([np.bincount(cell, weight * column, count) for column in flattened.T], -1)
        return (sums / total[:, None]).reshape(count, *values.shape[1:])

    centre = mean_of(means)
    shapes = rotations * scales[:, None, :]
    apart = means - centre[cell]
    covariance = mean_of(shapes @ np.swapaxes(shapes, 1, 2) + apart[:, :, None] * apart[:, None, :])
    values, vectors = np.linalg.eigh(covariance)
    vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
    deviations = np.sqrt(np.maximum(values, 1e-18))
    opacity = np.minimum(total / _area(deviations), 1.0)
    quats = Rotation.from_matrix(vectors).as_quat()[:, [3, 0, 1, 2]]
    made = Splats.create(centre, quats, deviations, opacity, mean_of(few.sh.astype(np.float64)))
    out = replace(made, antialias=few.antialias)
    if not isinstance(scene, Avatar):
        return out
    joints = len(scene.skeleton)
    kept = Skin(scene.skin.joints[usable], scene.skin.weights[usable]).dense(joints)
    weights = mean_of(kept)
    skin = Skin.create(np.broadcast_to(np.arange(joints), weights.shape), weights, joints, scene.skin.influences)
    return Avatar(out, scene.skeleton, skin, scene.meta)


def _area(deviations: F64) -> F64:
    """[N] product of the two larger of [N, 3]."""
    ordered = np.sort(deviations, axis=1)
    return ordered[:, 1] * ordered[:, 2]
