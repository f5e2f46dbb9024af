"""Make the normals, occlusion and shade of splats consistent with the surface that pictures show.

Pictures blend overlapping splats. A splat inside a cheek shows between those of its outside, and a fit gives it the
colour of the skin; lit by its own normal it would be a dark speck. So a splat that deviates far from the surface
visible around it takes that surface's mean. Hidden splats keep their own values; teeth are mostly visible in an open
mouth.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.footprints import footprints
from glsplat.extras.authoring.geometry.posed import PosedSplats, drawable, placed
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.extras.authoring.optimize.cameras import (
    FACE_ANGLES_DEG,
    REVEALING,
    Subject,
    ViewConfig,
    camera_around,
    views_of,
)
from glsplat.skinning.skin import strongest_joint

__all__ = ["ConsistentSurface", "view_consistent"]

F64 = NDArray[np.float64]

_ROUNDS = 3
_OWN_WEIGHT_PX = 1.0  # weight of a splat's own values against its pixels in all pictures
# From the mean, of a unit vector or an octave: below the first a splat keeps its values, from the second on it takes
# the mean.
_MIN_DEVIATION, _MAX_DEVIATION = 0.2, 0.4
_GRAZING_COS2 = 0.22  # mean squared cosine up to which views are grazing; from twice that they are trusted
_MIN_TRANSMITTANCE = 1e-3  # a pixel is finished when less passes
_MIN_FACING_SHARE = 0.5  # of a pixel; with less, the surface is seen through
_BODY_VIEWS, _BODY_PX, _CLOSE_PX = 12, 192, 96


class _View(NamedTuple):
    """A picture's M visible splats and their shares of its P pixels."""

    visible: NDArray[np.intp]  # [M]
    shares: csr_array  # [P, M]
    to_camera: F64  # [M, 3] vectors from the splats, metres
    towards: F64  # [3] unit, to the camera


class ConsistentSurface(NamedTuple):
    """The surface of N splats as pictures blend them."""

    normals: F64  # [N, 3] unit
    occlusion: F64  # [N]
    shade: F64  # [N]


def view_consistent(avatar: Avatar, normals: F64, occlusion: F64, shade: F64 | None = None) -> ConsistentSurface:
    """Return the surface of the zero pose: unit normals [N, 3], occlusion [N] and shade [N] (None: 1).

    Unchanged for an avatar without drawable splats.
    """
    shade = np.ones(len(normals)) if shade is None else shade
    values = np.concatenate([normals, occlusion[:, None], np.log2(shade)[:, None]], axis=1)

    def projected(view: tuple[PosedSplats, Camera]) -> _View:
        splats, camera = view
        prints = footprints(*splats[:4], camera, antialias=avatar.splats.antialias)
        reached = prints.transmittance > _MIN_TRANSMITTANCE
        pixel, splat = prints.pixel[reached], prints.splat[reached]
        weight = (prints.alpha * prints.transmittance)[reached]
        visible, own = np.unique(splat, return_inverse=True)
        ends = np.append(0, np.cumsum(np.bincount(pixel, minlength=camera.width * camera.height)))
        shares = csr_array((weight, own, ends), shape=(len(ends) - 1, len(visible)))
        eye = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3]
        return _View(visible, shares, eye - splats.means[visible], -camera.viewmat[2, :3])

    def sums_of(view: _View) -> F64:
        """Return [M, 7] five values and 1, weighted by the squared cosine of the view; and the weighted pixels."""
        own = values[view.visible]
        facing = np.einsum("nc,nc->n", view.to_camera, own[:, :3]) > 0
        blended = view.shares @ (np.column_stack([own, np.ones(len(own))]) * facing[:, None])
        good, part = blended[:, 5] > _MIN_FACING_SHARE, np.maximum(blended[:, 5], _MIN_FACING_SHARE)
        # rims show much of what lies behind
        upright = good * (blended[:, :3] @ view.towards / part).clip(0, 1) ** 2
        blended[:, :5] *= (upright / part)[:, None]
        blended[:, 5] = upright
        return np.asarray(view.shares.T @ np.column_stack([blended, good]))

    pairs = ((splats, camera) for splats, cameras in _consistency_views(avatar) for camera in cameras)
    views = map_threads(projected, pairs)
    for _ in range(_ROUNDS if views else 0):
        sums = np.zeros((len(values), 7))
        for view, found in zip(views, map_threads(sums_of, views), strict=True):
            sums[view.visible] += found
        weight, whole = sums[:, 5:6] + _OWN_WEIGHT_PX, sums[:, 6:7]
        total = values * _OWN_WEIGHT_PX + sums[:, :5]
        mean = total / weight
        deviation = np.linalg.norm(mean - values, axis=1, keepdims=True)
        cos2 = (weight - _OWN_WEIGHT_PX) / np.maximum(whole, 1e-6)
        confidence = np.clip((cos2 - _GRAZING_COS2) / _GRAZING_COS2, 0, 1)
        excess = (deviation - _MIN_DEVIATION) / (_MAX_DEVIATION - _MIN_DEVIATION)
        values += (mean - values) * confidence * np.clip(excess, 0, 1)
        length = np.linalg.norm(values[:, :3], axis=1, keepdims=True)
        values[:, :3] = np.where(length > 1e-6, values[:, :3] / np.maximum(length, 1e-6), 0)
    return ConsistentSurface(values[:, :3], values[:, 3], np.exp2(values[:, 4]))


def _consistency_views(avatar: Avatar) -> Iterator[tuple[PosedSplats, list[Camera]]]:
    """Yield splats and cameras: the zero pose from around, head, hands and feet; then the face in two expressions."""
    usable = drawable(avatar.splats)
    if not usable.any():
        return
    strongest = strongest_joint(avatar.skin.joints, avatar.skin.weights)[usable]
    names, means = avatar.skeleton.names, avatar.splats.means[usable].astype(np.float64)
    on_head = np.array([name.startswith(HEAD) for name in names])[strongest]
    size = _CLOSE_PX if on_head.all() else _BODY_PX
    config = ViewConfig(body=_BODY_VIEWS, poses=0, size=size, close=_CLOSE_PX)
    views = views_of(Subject(names, means, strongest, lambda pose: means), np.random.default_rng(0), config)
    still = placed(avatar.splats)
    yield still, [view.camera for view in views]
    if avatar.shapes is None or not on_head.any():
        return
    cameras = [camera_around(means[on_head], around, up, _CLOSE_PX, 1.5) for around, up in FACE_ANGLES_DEG]
    for expression in REVEALING:
        weights = avatar.shapes.weights(expression)
        if weights is not None:
            moved = reference.expressed(avatar.splats, avatar.shapes, weights)
            yield still._replace(means=moved.means, rotations=moved.shapes, scales=np.ones_like(still.scales)), cameras
