"""What splats know of their surface, made to agree with what is seen: a picture mixes splats that lie over each other.

A splat of the inside of a cheek shows through between those of its outside, in the skin's colour: a fit has seen to
that. Lit by its own normal it would be a dark speck there. So a splat that is far from what faces the camera where it
shows takes the mean of that; what nobody sees keeps its own, and teeth are mostly seen in an open mouth.
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

__all__ = ["SeenSurface", "as_seen", "ready"]

F64 = NDArray[np.float64]

_ROUNDS = 3
_OWN = 1.0  # pixels of all pictures that a splat's own values count as
_NEAR, _FAR = (
    0.2,
    0.4,
)  # of a unit, or an octave: how far from the mean a splat's own may be; from there on it is the mean
_GRAZING = 0.22  # square of the cosine under which a splat is seen at most from aside; from twice that it is seen well
_LEAST = 1e-3  # of a pixel: what less passes to is not seen


def ready() -> None:
    """Load the machine code of ``as_seen``, which takes a second the first time: for a core that has nothing to do."""
    if not available():
        return
    from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
    from glsplat.extras.authoring.optimize.view_consistency import SUMS, VALUES, agreed

    drawing, way = Rasterizer(1, 1), np.zeros(3, np.float32)
    one = PosedSplats(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)), np.ones(1), np.zeros((1, 3)))
    drawing.place(one, Camera(look_at((0, 0, 3), (0, 0, 0)), pinhole(8, 8), 8, 8), True)
    agreed(*drawing.shares(), 64, np.zeros((1, VALUES), np.float32), way, np.zeros((1, SUMS)))


class _Look(NamedTuple):
    """A picture that is looked at, of M of the avatar's splats: those that it shows."""

    some: NDArray[np.intp]  # [M]
    shares: Shares  # of these
    pixels: int
    ways: F64  # [M, 3] metres from a splat to the camera
    towards: F64  # [3] unit, to the camera


class SeenSurface(NamedTuple):
    """The surface of N splats as pictures mix them."""

    normals: F64  # [N, 3] unit
    occlusion: F64  # [N]
    shade: F64  # [N]


def as_seen(avatar: Avatar, normals: F64, occlusion: F64, shade: F64 | None = None) -> SeenSurface:
    """Return unit normals [N, 3], occlusion [N] and shade [N], 1 if not given, of splats as pictures mix them.

    Of the zero pose. As they are without numba, and where there is nothing to look at.
    """
    shade = np.ones(len(normals)) if shade is None else shade
    if not available():
        return SeenSurface(normals, occlusion, shade)
    from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
    from glsplat.extras.authoring.optimize.target_pictures import looks_at
    from glsplat.extras.authoring.optimize.view_consistency import SUMS, agreed

    desks = SimpleQueue[Rasterizer]()
    for _ in range(cores()):
        desks.put(Rasterizer(len(avatar.splats), 1, _LEAST))

    def looked(asked: tuple[PosedSplats, Camera]) -> _Look:
        splats, camera = asked
        drawing = desks.get()
        try:
            drawing.place(splats, camera, avatar.splats.antialias)
            found = drawing.shares()
        finally:
            desks.put(drawing)
        some, own = np.unique(found.splat.astype(np.intp), return_inverse=True)
        eye = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3]
        shares = found._replace(splat=own.astype(np.int32))
        return _Look(some, shares, camera.width * camera.height, eye - splats.means[some], -camera.viewmat[2, :3])

    def sums_of(look: _Look) -> F64:
        own = values[look.some]
        facing = np.einsum("nc,nc->n", look.ways, own[:, :3]) > 0
        mixed = np.column_stack([own, np.ones(len(own))]) * facing[:, None]
        found = np.empty((len(own), SUMS))
        agreed(*look.shares, look.pixels, mixed.astype(np.float32), look.towards.astype(np.float32), found)
        return found

    looks = map_threads(looked, ((splats, camera) for splats, cameras in looks_at(avatar) for camera in cameras))
    values = np.concatenate([normals, occlusion[:, None], np.log2(shade)[:, None]], axis=1)
    for _ in range(_ROUNDS):
        sums = np.zeros((len(values), SUMS))
        for look, found in zip(looks, map_threads(sums_of, looks), strict=True):
            sums[look.some] += found
        weight, whole = sums[:, 5:6] + _OWN, sums[:, 6:7]
        total = values * _OWN + sums[:, :5]
        mean = total / weight
        off = np.linalg.norm(mean - values, axis=1, keepdims=True)
        sure = np.clip(((weight - _OWN) / np.maximum(whole, 1e-6) - _GRAZING) / _GRAZING, 0, 1)
        values += (mean - values) * sure * np.clip((off - _NEAR) / (_FAR - _NEAR), 0, 1)
        length = np.linalg.norm(values[:, :3], axis=1, keepdims=True)
        values[:, :3] = np.where(length > 1e-6, values[:, :3] / np.maximum(length, 1e-6), 0)
    return SeenSurface(values[:, :3], values[:, 3], np.exp2(values[:, 4]))
