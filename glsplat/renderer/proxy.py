"""Proxy: a few points that stand for splats, so that how densely a view shows them is known in microseconds.

Levels of detail are chosen by this density and measured at it (``extras.authoring.detail``), so that one rule is
behind both. It is the focal length in pixels over the depth in metres, taken together over what the view shows: each
point counts by the pixels that it stands for, near ones count more, and what is out of view does not count. Nothing
jumps: points fade at the picture's rim, and a point is as blurred as the splats around it are spread, so that an eye
may stand among them. From outside, it is close to the focal length over the distance of the near side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.renderer.cells import cells
from glsplat.splats import Splats

__all__ = ["Proxy"]

F64 = NDArray[np.float64]

_POINTS = 256  # of what stands still
_MOVED = 96  # of an avatar, whose points are posed
_LOOKED_AT = 65536  # splats that place them
_RIM = 0.25  # of a cosine, over which points fade beyond the corners of the picture


@dataclass(frozen=True, eq=False, repr=False)
class Proxy:
    """A few points that stand for the splats of a scene (at most 256) or an avatar, in its own space.

    Those of an avatar each move with one joint: 96, and at least one a joint that moves splats.

    >>> proxy = Proxy.of(glsplat.default_avatar())
    >>> camera = glsplat.Camera(glsplat.look_at((0, 0, 4), (0, 0, 0)), glsplat.pinhole(1024, 1024, 90), 1024, 1024)
    >>> round(proxy.density(camera))  # 512 px over 4 m and less
    129
    """

    points: F64  # [P, 4] metres and a 1: zero pose, or where static splats are
    spread: F64  # [P] metres: standard deviation of the splats' places
    area: F64  # [P] metres^2 that its splats cover, as seen from their flat side
    joints: NDArray[np.intp] | None = None  # [P] what a point moves with

    @classmethod
    def of(cls, scene: Splats | Avatar) -> Proxy:
        """Of what can be drawn: finite splats that are not transparent. About 0.1 s, however many."""
        splats = scene.splats if isinstance(scene, Avatar) else scene
        rows = np.arange(0, len(splats), max(1, -(-len(splats) // _LOOKED_AT)))
        some = splats.take(rows)
        keep = some.finite() & (some.opacities > 0)
        rows, some = rows[keep], some.take(keep)
        means = some.means.astype(np.float64)
        sizes = np.sort(np.abs(some.scales.astype(np.float64)), axis=1)
        area = 2 * np.pi * sizes[:, 1] * sizes[:, 2] * np.minimum(some.opacities, 1) * (len(splats) / max(len(rows), 1))
        owner, most = np.zeros(len(rows), np.intp), _POINTS
        if isinstance(scene, Avatar):
            owner, most = scene.skin.joints[rows, 0].astype(np.intp), _MOVED
        cell = np.zeros(len(rows), np.intp)
        count = 0
        for joint in np.unique(owner):  # what moves apart is no cell
            mine = np.flatnonzero(owner == joint)
            share = min(max(1, most * len(mine) // len(rows)), len(mine))
            cell[mine] = count + cells(means[mine], share)
            count += share
        total = np.maximum(np.bincount(cell, minlength=count).astype(np.float64), 1)
        centre: F64 = np.stack([np.bincount(cell, column, count) / total for column in means.T], axis=1)
        apart = ((means - centre[cell]) ** 2).sum(axis=1) + (sizes**2).sum(axis=1)
        points: F64 = np.concatenate([centre, np.ones((count, 1))], axis=1)
        spread = np.maximum(np.sqrt(np.bincount(cell, apart, count) / total), 1e-9)
        covered: F64 = np.bincount(cell, area, count).astype(np.float64)
        joints = np.zeros(count, np.intp)
        joints[cell] = owner
        rigged = frozen(joints) if isinstance(scene, Avatar) else None
        return cls(frozen(points), frozen(spread), frozen(covered), rigged)

    def density(
        self,
        camera: Camera,
        to_world: F64 | None = None,  # [4, 4] rotation, one scale, translation: Item.transform
        bones: F64 | None = None,  # [J, 3, 4] skinning matrices of the pose; None: zero pose
    ) -> float:
        """Pixels a metre, of the thing's own metres, at which ``camera`` shows it; 0 where it shows nothing of it.

        About 50 microseconds. Of a pair of eyes the larger counts.
        """
        if not len(self.points):
            return 0.0
        view, width, height, K = camera.viewmat, camera.width, camera.height, camera.K
        size = 1.0
        if to_world is not None:
            view = view @ to_world
            size = float(np.sqrt(view[2, :3] @ view[2, :3]))
        if bones is not None and self.joints is not None:
            places = np.einsum("pij,pj->pi", bones.take(self.joints, axis=0), self.points)
            seen = (places @ view[:3, :3].T + view[:3, 3]) / size
        else:
            seen = (self.points @ view[:3].T) / size
        right, down = max(K[0, 2], width - K[0, 2]) / K[0, 0], max(K[1, 2], height - K[1, 2]) / K[1, 1]
        corner = float((1 + right * right + down * down) ** -0.5)  # cosine of the angle to the farthest corner
        depth, variance = seen[:, 2], self.spread * self.spread
        # of a ball: how far its near side is from the optical axis
        cosine = (depth + self.spread) / np.sqrt(np.einsum("pi,pi->p", seen, seen) + variance)
        shown = np.minimum(np.maximum((cosine - corner) / _RIM + 1, 0), 1)
        near = 1 / (depth * depth + variance)
        pixels = shown * self.area * near
        total = float(pixels.sum())
        # errors are squares: what is shown at twice the density counts four times a pixel
        return float(max(K[0, 0], K[1, 1])) * float(pixels @ near / total) ** 0.5 if total > 0 else 0.0
