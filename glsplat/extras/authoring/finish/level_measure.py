"""Up to which density a level may stand in for the finest: both are drawn, from around, and the worst picture decides.

What counts of a picture is the box around what it shows: the rows and columns between the first and the last pixel that
either of the two covers (alpha of 1/255 and more), before black and before grey, of which the worse counts, as
``glsplat avatar score`` has it. So no empty background flatters but what lies between the limbs; and the worst picture
is mostly one of a pose and a side that fill their box. Each picture has the size at which it shows the thing as densely
as asked for by ``glsplat.renderer.proxy.Proxy``, by which levels are chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.avatar import Avatar, splats_of
from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.geometry.visibility import probe_poses, sphere, sphere_around
from glsplat.gl.context import Context, create_context
from glsplat.renderer import Renderer
from glsplat.renderer.levels import Proxy
from glsplat.skinning.pose import Pose
from glsplat.splats import Level, Splats

__all__ = ["MeasureConfig", "Pictures", "Station", "difference", "measured", "stations_of"]

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Scene = TypeVar("Scene", bound=Splats | Avatar)
Report = Callable[[str, float], None]

_FAR = 8.0  # radii from which a thing is looked at from outside
_INSIDE = float(np.tan(np.radians(75) / 2))  # half of a picture taken from inside
_LOOKED_AT = 65536  # splats that say where free places are
_STEP = 2**0.5  # between densities that are looked at
_HALVINGS = 3  # of such a step: 4 % are left
_LEAST = 24  # pixels of the thing's longer side at the lowest density, and of a picture from inside
_COVERED = 1 / 255  # alpha
_MOST = 120.0  # dB of equal pictures
_EXACT = RenderConfig(target="32f", output="float32", cull_hidden=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureConfig:
    """How thoroughly to look, and what is to be kept."""

    psnr: float = 39.0  # dB that the worst picture keeps, over the box around what it shows
    slack: float = 1.0  # dB less, for a level that keeps this nowhere
    directions: int = 6  # from outside, a pose
    inside: int = 4  # places inside a static scene from which it is looked at
    size: int = 1280  # pixels of the longer side of the largest pictures


@dataclass(frozen=True, eq=False)
class Station:
    """A pose, and a camera but for its focal length."""

    pose: Pose | None
    viewmat: F64
    low: F64  # [2] left and upper edge of the picture at a focal length of 1
    high: F64  # [2]
    near: float  # metres
    inside: bool = False
    unit: float = 0.0  # density at a focal length of 1 (Proxy)

    @property
    def extent(self) -> float:
        """Longer side of the picture at a focal length of 1."""
        return float((self.high - self.low).max())

    def camera(self, focal: float) -> Camera:
        """The camera with that focal length in pixels."""
        width, height = np.maximum(np.ceil((self.high - self.low) * focal), 4).astype(int)
        left, top = -self.low * focal
        return Camera(
            self.viewmat, [[focal, 0, left], [0, focal, top], [0, 0, 1]], int(width), int(height), near=self.near
        )


def measured(
    finest: Scene,
    levels: Sequence[Scene],  # finest first, fewer and fewer splats
    config: MeasureConfig | None = None,
    progress: Report | None = None,
    context: Context | None = None,
) -> tuple[Level[Scene], ...]:
    """Those ``levels`` with the largest density at which the worst picture keeps ``config.psnr`` against ``finest``,
    or, where one keeps that nowhere, ``config.slack`` less.

    An avatar is seen in the poses that place its splats (visibility.probe_poses), a static scene from outside and from
    free places within. A level that keeps it wherever pictures of ``config.size`` show the whole thing is known to
    that density and no further. Left out are levels that keep it nowhere, and those that a coarser one is as good as.
    The same every time on one driver. Raises GlsplatError for a scene without a finite splat.
    """
    config, report = config or MeasureConfig(), progress or (lambda stage, done: None)
    stations = stations_of(finest, config)
    outside = [s for s in stations if not s.inside]
    top = min(config.size / s.extent * s.unit for s in outside)
    bottom = min(top, *(_LEAST / s.extent * s.unit for s in outside))
    found: dict[int, tuple[float, float]] = {}
    with Pictures([finest, *levels], stations, config.size, context) as pictures:
        start = top
        for index, wanted in product(range(len(levels)), (config.psnr, config.psnr - config.slack)):
            if len(found) < index:
                break  # a coarser one does not keep what a finer one does not
            if index in found:
                continue
            density = start
            while density >= bottom:
                report("measuring levels", float(np.log(top / density) / np.log(top / bottom)) if bottom < top else 1.0)
                kept = min(pictures.kept(index + 1, density))
                # far below it the finest is no measure: its splats fade when they are much less than a pixel
                if kept >= wanted and min(pictures.kept(index + 1, max(density / 2, bottom))) >= wanted:
                    above = density * _STEP if density < top else density
                    found[index] = pictures.highest(index + 1, density, kept, above, wanted)
                    start = density
                    break
                density /= _STEP
    out: list[Level[Scene]] = []
    for index in sorted(found, reverse=True):
        density, kept = found[index]
        if not out or density > out[-1].density:
            out.append(Level(levels[index], density, kept))
    return tuple(out[::-1])


def difference(picture: F32, other: F32) -> float:
    """PSNR in dB of two pictures [H, W, 4] (premultiplied RGB, alpha), at most 120.

    Over the box around what either covers, before black and before grey: the lower of the two.
    """
    shown = (picture[..., 3] >= _COVERED) | (other[..., 3] >= _COVERED)
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    if not len(rows):
        return _MOST
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    kept = _MOST
    for grey in (0.0, 0.5):
        a, b = (np.clip(one[box][..., :3] + grey * (1 - one[box][..., 3:]), 0, 1) for one in (picture, other))
        kept = min(kept, float(-10 * np.log10(max(np.square(a - b, dtype=np.float64).mean(), 1e-30))))
    return kept


class Pictures:
    """Pictures of the finest (0) and of levels, from all stations, drawn exactly by one renderer each."""

    def __init__(
        self, scenes: Sequence[Splats | Avatar], stations: Sequence[Station], size: int, context: Context | None = None
    ) -> None:
        self._stations, self._size = stations, size
        self._finest: dict[tuple[float, int], F32] = {}
        with ExitStack() as stack:
            shared = context or create_context()
            if context is None:
                stack.callback(shared.release)
            self._renderers = [
                stack.enter_context(Renderer(_alone(scene), size=(64, 64), config=_EXACT, context=shared))
                for scene in scenes
            ]
            self._owned = stack.pop_all()

    def __enter__(self) -> Pictures:
        return self

    def __exit__(self, *_: object) -> None:
        self._owned.close()

    def show(self, which: int, scene: Splats | Avatar) -> None:
        """Another scene in the place of number ``which``."""
        self._renderers[which].load(_alone(scene))

    def kept(self, which: int, density: float) -> list[float]:
        """PSNR of each picture that can be taken at that density, in dB; at least one."""
        densities = list(dict.fromkeys(known for known, _ in self._finest))
        if density not in densities and len(densities) > 1:
            self._finest = {key: one for key, one in self._finest.items() if key[0] == densities[-1]}
        out = []
        for index, station in enumerate(self._stations):
            focal = density / station.unit if station.unit else 0.0
            if station.inside and not _LEAST <= focal * station.extent <= self._size:
                continue
            if (density, index) not in self._finest:
                self._finest[density, index] = self._drawn(0, station, focal)
            out.append(difference(self._finest[density, index], self._drawn(which, station, focal)))
        return out

    def highest(self, which: int, low: float, kept: float, high: float, psnr: float) -> tuple[float, float]:
        """The density from ``low``, where ``kept`` is kept, up to which ``psnr`` is, and what is kept there."""
        for _ in range(_HALVINGS if high > low else 0):
            middle = (low * high) ** 0.5
            now = min(self.kept(which, middle))
            if now >= psnr:
                low, kept = middle, now
            else:
                high = middle
        return low, kept

    def _drawn(self, which: int, station: Station, focal: float) -> F32:
        camera, renderer = station.camera(focal), self._renderers[which]
        renderer.resize(camera.width, camera.height)
        return cast("F32", renderer.render([camera], station.pose)[0])


def _alone(scene: Any) -> Splats | Avatar:
    """Without levels, which exact pictures have no use for."""
    return cast("Splats | Avatar", replace(scene, levels=()))


def stations_of(scene: Splats | Avatar, config: MeasureConfig) -> list[Station]:
    """Where ``scene`` is looked at from, in which pose. Raises GlsplatError where there is nothing to see."""
    out: list[Station] = []
    proxy = Proxy.of(scene)
    poses: list[Pose | None] = [None]
    if isinstance(scene, Avatar):
        poses = [*probe_poses(scene.skeleton.names)]
    for number, pose in enumerate(poses):
        splats = posed_splats(scene, pose) if isinstance(scene, Avatar) and pose is not None else splats_of(scene)
        points = splats.means[splats.finite() & (splats.opacities > _COVERED)].astype(np.float64)
        if not len(points):
            raise GlsplatError("levels of detail need at least one finite splat that is not transparent")
        low, high = np.percentile(points, (0.5, 99.5), axis=0)  # a stray splat is not to shrink the rest
        points = points[((points >= low) & (points <= high)).all(axis=1)] if len(points) > 1000 else points
        centre, radius = sphere_around(points)
        # other directions for each pose
        for direction in sphere(config.directions * len(poses))[number :: len(poses)]:
            viewmat = look_at(centre + direction * _FAR * radius, centre)
            seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
            flat = seen[:, :2] / seen[:, 2:]
            rim = 0.01 * radius / (_FAR * radius)
            out.append(Station(pose, viewmat, flat.min(axis=0) - rim, flat.max(axis=0) + rim, 1e-3 * radius))
        if isinstance(scene, Splats):
            out += [
                Station(None, viewmat, np.full(2, -_INSIDE), np.full(2, _INSIDE), 0.01 * radius, inside=True)
                for viewmat in _free_views(points, config.inside)
            ]
    return [replace(one, unit=proxy.density(one.camera(1e3), None, _bones(scene, one.pose)) / 1e3) for one in out]


def _free_views(points: F64, count: int) -> list[F64]:
    """View matrices from places among ``points`` [N, 3] that are as far from all of them as can be."""
    if not count or len(points) < 100:
        return []
    tree = cKDTree(points[:: max(1, len(points) // _LOOKED_AT)])
    low, high = np.percentile(points, (15, 85), axis=0)
    places = low + (high - low) * np.random.default_rng(0).random((1024, 3))
    clear = tree.query(places)[0]
    middle, extent = np.median(points, axis=0), float((high - low).max())
    chosen: list[F64] = []
    for place in places[np.argsort(-clear)]:
        if all(np.linalg.norm(place - other) > 0.2 * extent for other in chosen):
            chosen.append(place)
        if len(chosen) == count:
            break
    return [look_at(place, middle if np.linalg.norm(middle - place) > 1e-6 * extent else place + 1) for place in chosen]


def _bones(scene: Splats | Avatar, pose: Pose | None) -> F64 | None:
    return pose.bones(scene.skeleton) if isinstance(scene, Avatar) and pose is not None else None
