"""Levels of detail: coarser versions of an item, and the choice of one for a view.

A level is chosen by the density at which a view shows the item: the focal length in pixels over the depth in metres,
averaged over the pixels that the item covers. ``extras.authoring.finish`` measures levels at such densities. A few
points represent the item (``Proxy``), so that a density takes microseconds. Densities are continuous: points fade at
the picture's rim and are blurred by the spread of their splats, so that an eye may be among them. From outside, the
density is close to the focal length over the distance of the near side.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64, frozen, number
from glsplat.avatar import Avatar, splats_of
from glsplat.camera import Camera
from glsplat.config import MAX_BIAS
from glsplat.errors import GlsplatError
from glsplat.splats import Splats

HYSTERESIS = 1.05
"""Factor by which the view's density has to pass the limit between two levels before the level changes."""

_STATIC_POINTS = 256  # of splats without a skeleton
_AVATAR_POINTS = 96  # posed each frame
_SAMPLED_SPLATS = 65536  # the points are means of these
_FADE = 0.25  # range of the cosine over which points fade beyond the corners of the picture

_numbers = itertools.count()  # unique in the process, as a Selector may follow its viewer to another renderer


def cells(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Return the cell [N] of each of ``points`` [N, D]: ``count`` cells of neighbours, by halving the longest axis.

    Sizes differ by at most one between siblings; every cell has at least one point if ``count`` <= N.
    """
    out = np.zeros(len(points), np.intp)
    todo = [(np.arange(len(points)), 0, count)]
    while todo:
        index, first, share = todo.pop()
        if share == 1:
            out[index] = first
            continue
        own = points[index]
        axis = int(np.ptp(own, axis=0).argmax())
        left = share // 2
        cut = int(np.clip(round(len(index) * left / share), left, len(index) - (share - left)))
        order = np.argpartition(own[:, axis], min(cut, len(index) - 1))
        todo += [(index[order[:cut]], first, left), (index[order[cut:]], first + left, share - left)]
    return out


@dataclass(frozen=True, eq=False, repr=False)
class Proxy:
    """A few points that represent splats (at most 256 points) or an avatar, in its own space.

    Each point of an avatar moves with one joint: 96 points, and at least one for each joint that moves splats.

    >>> proxy = Proxy.of(glsplat.default_avatar())
    >>> camera = glsplat.Camera(glsplat.look_at((0, 0, 4), (0, 0, 0)), glsplat.pinhole(1024, 1024, 90), 1024, 1024)
    >>> round(proxy.density(camera))  # 512 px over 4 m; nearer points raise the mean
    129
    """

    points: F64  # [P, 4] metres and a 1, in the zero pose
    spread: F64  # [P] metres: standard deviation of the splats' places
    area: F64  # [P] metres^2 that its splats cover, as seen from their flat side
    joints: NDArray[np.intp] | None = None  # [P] joint of each point; None: static

    @classmethod
    def of(cls, scene: Splats | Avatar) -> Proxy:
        """Return the points of all splats that can be drawn. Takes about 0.1 s, however many there are."""
        splats = splats_of(scene)
        rows = np.arange(0, len(splats), max(1, -(-len(splats) // _SAMPLED_SPLATS)))
        some = splats.take(rows)
        keep = some.finite() & (some.opacities > 0)
        rows, some = rows[keep], some.take(keep)
        means = some.means.astype(np.float64)
        sizes = np.sort(np.abs(some.scales.astype(np.float64)), axis=1)
        area = 2 * np.pi * sizes[:, 1] * sizes[:, 2] * np.minimum(some.opacities, 1) * (len(splats) / max(len(rows), 1))
        owner, most = np.zeros(len(rows), np.intp), _STATIC_POINTS
        if isinstance(scene, Avatar):
            owner, most = scene.skin.joints[rows, 0].astype(np.intp), _AVATAR_POINTS
        cell = np.zeros(len(rows), np.intp)
        count = 0
        for joint in np.unique(owner):  # splats of different joints share no cell
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
        """Return pixels per metre (of the item's own space) at which ``camera`` shows it; 0 if out of view.

        Takes about 50 microseconds.
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
        shown = np.minimum(np.maximum((cosine - corner) / _FADE + 1, 0), 1)
        near = 1 / (depth * depth + variance)
        pixels = shown * self.area * near
        total = float(pixels.sum())
        # errors are squares: a pixel at twice the density counts four times
        return float(max(K[0, 0], K[1, 1])) * float(pixels @ near / total) ** 0.5 if total > 0 else 0.0


class Selector:
    """Chooses levels for one viewer and remembers them against flicker. Each of several viewers has its own.

    ``bias`` is added to ``RenderConfig.lod_bias``; -8 to 8. See ``Renderer.selector``.
    """

    def __init__(self, bias: float = 0.0) -> None:
        self.bias = bias
        self.coarsest: bool = True  # every item in view got its coarsest level
        self._last: dict[int, int] = {}  # level by the item's number

    @property
    def bias(self) -> float:
        """Log2 of a factor of the density: above 0 for finer levels, below 0 for coarser ones; -8 to 8."""
        return self._bias

    @bias.setter
    def bias(self, bias: float) -> None:
        self._bias = number(bias, "bias", GlsplatError)
        if not -MAX_BIAS <= self._bias <= MAX_BIAS:
            raise GlsplatError(f"bias needs -{MAX_BIAS:g} to {MAX_BIAS:g}, not {self._bias:g}")

    def choose(self, items: Iterable[tuple[int, Sequence[float], float]], bias: float = 0.0) -> list[int]:
        """Return a level for each item of (number, densities of its coarser levels, density of the view).

        Densities are in pixels per metre, 0 if no view shows the item: it keeps its level.
        """
        finer, before = 2.0 ** (bias + self.bias), self._last
        found: dict[int, int] = {}
        self.coarsest = True
        for key, densities, density in items:
            last = before.get(key)
            if density > 0:
                found[key] = chosen(densities, density * finer, last)
                self.coarsest &= found[key] == len(densities)
            else:
                found[key] = len(densities) if last is None else last
        self._last = found
        return list(found.values())


def chosen(densities: Sequence[float], wanted: float, before: int | None = None) -> int:
    """Return the coarsest level that is sharp enough at ``wanted`` pixels per metre; 0 is the finest.

    ``densities`` are those of the coarser levels, falling (Splats.levels). ``before`` is the level that the same view
    had; near the limit between two levels it is kept.

    >>> chosen((800, 400, 200), 300), chosen((800, 400, 200), 405), chosen((800, 400, 200), 405, before=2)
    (2, 1, 2)
    """

    def suffices(least: float) -> int:
        return sum(density >= least for density in densities)

    level = suffices(wanted)
    if before is None or level == before:
        return level
    if level > before:
        return max(before, suffices(wanted * HYSTERESIS))
    return min(before, suffices(wanted / HYSTERESIS))


class ItemLevels:
    """Contents and densities of an item's levels, on the host; 0 is the finest. ``number`` is unique in the process."""

    def __init__(self, content: Splats | Avatar) -> None:
        self.number: int = next(_numbers)
        self.contents: tuple[Splats | Avatar, ...] = (content, *(level.content for level in content.levels))
        self.densities: tuple[float, ...] = tuple(level.density for level in content.levels)
        self._proxy: Proxy | None = None

    @property
    def coarsest(self) -> int:
        """Number of the coarsest level."""
        return len(self.densities)

    @property
    def has_cones(self) -> bool:
        """Whether any level has visibility cones."""
        return any(splats_of(content).cones is not None for content in self.contents)

    def splats(self, level: int) -> int:
        """Return the number of splats of a level."""
        return len(splats_of(self.contents[level]))

    def density(self, views: Sequence[Camera], to_world: F64 | None, bones: F64 | None) -> float:
        """Return the largest ``Proxy.density`` of the views."""
        if self._proxy is None:
            self._proxy = Proxy.of(self.contents[0])
        return max((self._proxy.density(view, to_world, bones) for view in views), default=0.0)
