"""Make the normals, occlusion and shade of splats consistent with the surface that pictures show.

Pictures blend overlapping splats. A splat inside a cheek shows between those of its outside, and a fit gives it the
colour of the skin; lit by its own normal it would be a dark speck. So a splat that deviates far from the surface
visible around it takes that surface's mean. Hidden splats keep their own values; teeth are mostly visible in an open
mouth.
"""

from __future__ import annotations

from queue import SimpleQueue
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.compute.compiled import available
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.posed import PosedSplats
from glsplat.io.cores import cores

if TYPE_CHECKING:
    from glsplat.extras.authoring.optimize.view_consistency import Shares

F64 = NDArray[np.float64]

_ROUNDS = 3
_OWN_WEIGHT_PX = 1.0  # weight of a splat's own values against its pixels in all pictures
# From the mean, of a unit vector or an octave: below the first a splat keeps its values, from the second on it takes
# the mean.
_MIN_DEVIATION, _MAX_DEVIATION = 0.2, 0.4
_GRAZING_COS2 = 0.22  # mean squared cosine up to which views are grazing; from twice that they are trusted
_MIN_TRANSMITTANCE = 1e-3  # a pixel is finished when less passes


def load_compiled() -> None:
    """Load the compiled code of ``view_consistent`` before its first call, where loading would take a second."""
    if not available():
        return
    from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
    from glsplat.extras.authoring.optimize.view_consistency import SUMS, VALUES, gather_visible

    rasterizer, towards = Rasterizer(1, 1), np.zeros(3, np.float32)
    one = PosedSplats(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)), np.ones(1), np.zeros((1, 3)))
    rasterizer.place(one, Camera(look_at((0, 0, 3), (0, 0, 0)), pinhole(8, 8), 8, 8), True)
    gather_visible(*rasterizer.shares(), 64, np.zeros((1, VALUES), np.float32), towards, np.zeros((1, SUMS)))


class _View(NamedTuple):
    """A picture's M visible splats and their shares of its pixels."""

    visible: NDArray[np.intp]  # [M]
    shares: Shares  # of these
    pixels: int
    to_camera: F64  # [M, 3] vectors from the splats, metres
    towards: F64  # [3] unit, to the camera


class ConsistentSurface(NamedTuple):
    """The surface of N splats as pictures blend them."""

    normals: F64  # [N, 3] unit
    occlusion: F64  # [N]
    shade: F64  # [N]


def view_consistent(avatar: Avatar, normals: F64, occlusion: F64, shade: F64 | None = None) -> ConsistentSurface:
    """Return the surface of the zero pose: unit normals [N, 3], occlusion [N] and shade [N] (None: 1).

    Unchanged without numba, and for an avatar without drawable splats.
    """
    shade = np.ones(len(normals)) if shade is None else shade
    if not available():
        return ConsistentSurface(normals, occlusion, shade)
    from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
    from glsplat.extras.authoring.optimize.target_pictures import consistency_views
    from glsplat.extras.authoring.optimize.view_consistency import SUMS, gather_visible

    rasterizers = SimpleQueue[Rasterizer]()
    for _ in range(cores()):
        rasterizers.put(Rasterizer(len(avatar.splats), 1, _MIN_TRANSMITTANCE))

    def projected(view: tuple[PosedSplats, Camera]) -> _View:
        splats, camera = view
        rasterizer = rasterizers.get()
        try:
            rasterizer.place(splats, camera, avatar.splats.antialias)
            found = rasterizer.shares()
        finally:
            rasterizers.put(rasterizer)
        visible, own = np.unique(found.splat.astype(np.intp), return_inverse=True)
        eye = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3]
        shares = found._replace(splat=own.astype(np.int32))
        return _View(visible, shares, camera.width * camera.height, eye - splats.means[visible], -camera.viewmat[2, :3])

    def sums_of(view: _View) -> F64:
        own = values[view.visible]
        facing = np.einsum("nc,nc->n", view.to_camera, own[:, :3]) > 0
        mixed = np.column_stack([own, np.ones(len(own))]) * facing[:, None]
        found = np.empty((len(own), SUMS))
        gather_visible(*view.shares, view.pixels, mixed.astype(np.float32), view.towards.astype(np.float32), found)
        return found

    pairs = ((splats, camera) for splats, cameras in consistency_views(avatar) for camera in cameras)
    views = map_threads(projected, pairs)
    values = np.concatenate([normals, occlusion[:, None], np.log2(shade)[:, None]], axis=1)
    for _ in range(_ROUNDS):
        sums = np.zeros((len(values), SUMS))
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
