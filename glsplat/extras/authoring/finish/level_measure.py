"""Measure up to which density a level may replace the finest: both are drawn from around, the worst picture decides.

PSNR is over the box of rows and columns that either picture covers (alpha of 1/255 and more), before black and before
grey, the lower of the two, as in ``glsplat avatar score``: background outside the box does not raise it. The size of
each picture follows from the density as ``glsplat.renderer.levels.Proxy`` defines it, by which levels are chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeVar, cast

import numpy as np
from scipy.spatial import cKDTree

from glsplat.arrays import F32, F64
from glsplat.avatar import Avatar, splats_of
from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.geometry.footprints import ALPHA_MIN
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.geometry.visibility import probe_poses, sphere, sphere_around
from glsplat.gl.context import Context, create_context
from glsplat.renderer import Renderer
from glsplat.renderer.levels import Proxy
from glsplat.skinning.pose import Pose
from glsplat.splats import Level, Splats

Scene = TypeVar("Scene", bound=Splats | Avatar)
Report = Callable[[str, float], None]

_FAR_RADII = 8.0  # distance of cameras outside
_INSIDE_HALF_TAN = float(np.tan(np.radians(75) / 2))  # of half the angle of view of cameras inside
_MAX_SAMPLES = 65536  # splats, in the search for free places
_DENSITY_FACTOR = 2**0.5  # between measured densities
_REFINEMENT_STEPS = 3  # halvings of that factor: 4 % remain
_MIN_PICTURE_PX = 24  # longer side at the lowest density, and of pictures from inside
_MAX_PSNR_DB = 120.0  # of equal pictures
_EXACT = RenderConfig(target="32f", output="float32", cull_hidden=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureConfig:
    """Number and size of the pictures, and the PSNR to keep."""

    psnr: float = 39.0  # dB of the worst picture, over its covered box
    slack: float = 1.0  # dB less, for a level that reaches ``psnr`` nowhere
    directions: int = 6  # from outside, for each pose
    inside: int = 4  # places inside a static scene
    size: int = 1280  # pixels of the longer side of the largest pictures


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A pose and a camera without its focal length."""

    pose: Pose | None
    viewmat: F64
    low: F64  # [2] left and upper edge of the picture at a focal length of 1
    high: F64  # [2]
    near: float  # metres
    inside: bool = False
    unit: float = 0.0  # density at a focal length of 1 (Proxy)

    @property
    def extent(self) -> float:
        """Return the longer side of the picture at a focal length of 1."""
        return float((self.high - self.low).max())

    def camera(self, focal: float) -> Camera:
        """Return the camera with that focal length, pixels."""
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
    """Return ``levels`` with the largest density at which the worst picture keeps ``config.psnr`` against ``finest``.

    A level that reaches it nowhere is measured with ``config.slack`` less. An avatar is drawn in probe_poses, a static
    scene from outside and from free places within. No density is beyond that of pictures of ``config.size``. Levels
    that keep enough nowhere are left out, as are levels no better than a coarser one. Deterministic on one driver.
    Raises GlsplatError for a scene without a finite splat.
    """
    config, report = config or MeasureConfig(), progress or (lambda stage, done: None)
    viewpoints = viewpoints_of(finest, config)
    outside = [s for s in viewpoints if not s.inside]
    top = min(config.size / s.extent * s.unit for s in outside)
    bottom = min(top, *(_MIN_PICTURE_PX / s.extent * s.unit for s in outside))
    found: dict[int, tuple[float, float]] = {}
    with Pictures([finest, *levels], viewpoints, config.size, context) as pictures:
        start = top
        for index, wanted in product(range(len(levels)), (config.psnr, config.psnr - config.slack)):
            if len(found) < index:
                break  # a coarser level is not better than a finer one
            if index in found:
                continue
            density = start
            while density >= bottom:
                report("measuring levels", float(np.log(top / density) / np.log(top / bottom)) if bottom < top else 1.0)
                kept = min(pictures.psnrs(index + 1, density))
                # far below, the finest is no reference: its splats fade when they are much smaller than a pixel
                if kept >= wanted and min(pictures.psnrs(index + 1, max(density / 2, bottom))) >= wanted:
                    above = density * _DENSITY_FACTOR if density < top else density
                    found[index] = pictures.max_density(index + 1, density, kept, above, wanted)
                    start = density
                    break
                density /= _DENSITY_FACTOR
    out: list[Level[Scene]] = []
    for index in sorted(found, reverse=True):
        density, kept = found[index]
        if not out or density > out[-1].density:
            out.append(Level(levels[index], density, kept))
    return tuple(out[::-1])


def box_psnr(picture: F32, other: F32) -> float:
    """Return the PSNR in dB, at most 120, of two pictures [H, W, 4] (premultiplied RGB, alpha).

    It is taken over the box that either covers, before black and before grey: the lower of the two.
    """
    shown = (picture[..., 3] >= ALPHA_MIN) | (other[..., 3] >= ALPHA_MIN)
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    if not len(rows):
        return _MAX_PSNR_DB
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    kept = _MAX_PSNR_DB
    for grey in (0.0, 0.5):
        a, b = (np.clip(one[box][..., :3] + grey * (1 - one[box][..., 3:]), 0, 1) for one in (picture, other))
        kept = min(kept, float(-10 * np.log10(max(np.square(a - b, dtype=np.float64).mean(), 1e-30))))
    return kept


class Pictures:
    """Exact pictures of the finest (0) and of levels, from all viewpoints; each scene has its renderer."""

    def __init__(
        self,
        scenes: Sequence[Splats | Avatar],
        viewpoints: Sequence[Viewpoint],
        size: int,
        context: Context | None = None,
    ) -> None:
        self._viewpoints, self._size = viewpoints, size
        self._finest: dict[tuple[float, int], F32] = {}
        with ExitStack() as stack:
            shared = context or create_context()
            if context is None:
                stack.callback(shared.release)
            self._renderers = [
                stack.enter_context(Renderer(_without_levels(scene), size=(64, 64), config=_EXACT, context=shared))
                for scene in scenes
            ]
            self._owned = stack.pop_all()

    def __enter__(self) -> Pictures:
        return self

    def __exit__(self, *_: object) -> None:
        self._owned.close()

    def replace_scene(self, number: int, scene: Splats | Avatar) -> None:
        """Load another scene in place of scene ``number``."""
        self._renderers[number].load(_without_levels(scene))

    def psnrs(self, number: int, density: float) -> list[float]:
        """Return the PSNR, dB, of each picture that can be taken of scene ``number`` at that density; at least one."""
        densities = list(dict.fromkeys(known for known, _ in self._finest))
        if density not in densities and len(densities) > 1:
            self._finest = {key: one for key, one in self._finest.items() if key[0] == densities[-1]}
        out = []
        for index, viewpoint in enumerate(self._viewpoints):
            focal = density / viewpoint.unit if viewpoint.unit else 0.0
            if viewpoint.inside and not _MIN_PICTURE_PX <= focal * viewpoint.extent <= self._size:
                continue
            if (density, index) not in self._finest:
                self._finest[density, index] = self._draw(0, viewpoint, focal)
            out.append(box_psnr(self._finest[density, index], self._draw(number, viewpoint, focal)))
        return out

    def max_density(self, number: int, low: float, kept: float, high: float, psnr: float) -> tuple[float, float]:
        """Return the largest density that keeps ``psnr``, from ``low`` (PSNR ``kept``) to ``high``, and its PSNR."""
        for _ in range(_REFINEMENT_STEPS if high > low else 0):
            middle = (low * high) ** 0.5
            now = min(self.psnrs(number, middle))
            if now >= psnr:
                low, kept = middle, now
            else:
                high = middle
        return low, kept

    def _draw(self, number: int, viewpoint: Viewpoint, focal: float) -> F32:
        camera, renderer = viewpoint.camera(focal), self._renderers[number]
        renderer.resize(camera.width, camera.height)
        return cast("F32", renderer.render([camera], viewpoint.pose)[0])


def _without_levels(scene: Any) -> Splats | Avatar:
    """Return the scene without levels: exact pictures do not use them."""
    return cast("Splats | Avatar", replace(scene, levels=()))


def viewpoints_of(scene: Splats | Avatar, config: MeasureConfig) -> list[Viewpoint]:
    """Return the viewpoints for ``scene``. Raises GlsplatError where no splat is visible."""
    out: list[Viewpoint] = []
    proxy = Proxy.of(scene)
    poses: list[Pose | None] = [None]
    if isinstance(scene, Avatar):
        poses = [*probe_poses(scene.skeleton.names)]
    for number, pose in enumerate(poses):
        splats = posed_splats(scene, pose) if isinstance(scene, Avatar) and pose is not None else splats_of(scene)
        points = splats.means[splats.finite() & (splats.opacities > ALPHA_MIN)].astype(np.float64)
        if not len(points):
            raise GlsplatError("levels of detail need at least one finite splat that is not transparent")
        low, high = np.percentile(points, (0.5, 99.5), axis=0)  # stray splats must not shrink the rest
        points = points[((points >= low) & (points <= high)).all(axis=1)] if len(points) > 1000 else points
        centre, radius = sphere_around(points)
        # other directions for each pose
        for direction in sphere(config.directions * len(poses))[number :: len(poses)]:
            viewmat = look_at(centre + direction * _FAR_RADII * radius, centre)
            seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
            flat = seen[:, :2] / seen[:, 2:]
            rim = 0.01 * radius / (_FAR_RADII * radius)
            out.append(Viewpoint(pose, viewmat, flat.min(axis=0) - rim, flat.max(axis=0) + rim, 1e-3 * radius))
        if isinstance(scene, Splats):
            half = np.full(2, _INSIDE_HALF_TAN)
            out += [
                Viewpoint(None, viewmat, -half, half, 0.01 * radius, inside=True)
                for viewmat in _free_views(points, config.inside)
            ]
    return [replace(one, unit=proxy.density(one.camera(1e3), None, _bones(scene, one.pose)) / 1e3) for one in out]


def _free_views(points: F64, count: int) -> list[F64]:
    """Return view matrices at places among ``points`` [N, 3] that are as far as possible from all of them."""
    if not count or len(points) < 100:
        return []
    tree = cKDTree(points[:: max(1, len(points) // _MAX_SAMPLES)])
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
