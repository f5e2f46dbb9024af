"""Visibility cones: from where a splat can be seen at all, so that the renderer may leave out the others.

About half of an avatar's splats face away from the eye or lie behind opaque ones. The avatar is looked at from all
around, in a few poses, and every splat is told how much of each picture it makes. Its cone holds all directions from
which that was more than a threshold: an axis, in the splat's own axes so that it turns with the skin, and the smallest
cosine. Pictures that were not looked at before then say what is missing, how much wider all cones have to be, and at
last, others again, what is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.compute.compiled import available
from glsplat.extras.authoring.geometry.footprints import EPS2D, Footprints, footprints, transmittance
from glsplat.extras.authoring.geometry.posed import axes_of, drawable, placed, posed_splats
from glsplat.extras.authoring.geometry.visibility import probe_poses, sphere, sphere_around
from glsplat.extras.authoring.optimize.refine import random_pose
from glsplat.rotations import unit_vectors
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import Shapes
from glsplat.splats import Splats

__all__ = ["ConeConfig", "hidden", "with_cones", "worth_cones"]

F64 = NDArray[np.float64]
_SEED = 0
_FAR, _NEAR = 8.0, (2.0, 5.0)  # radii of the scene from which it is looked at, and drawn
_EVERYWHERE = np.array([0, 0, 0, -127], np.int8)  # a cone without an axis: visible from everywhere
_WORTH = 0.02  # of all splats: where fewer can be hidden, cones are not worth their bytes
_DECADES = 6  # between the smallest threshold and the largest weight
_STEPS = 8  # halvings of the interval of thresholds
_FLAT = 1e-15  # metres: what is thinner has no direction in float32 (cone.glsl has its square)
_MOVES = 1e-3  # metres that a splat moves with an expression, from which it uncovers what is near
_BEHIND = 0.08  # metres from such a splat within which it does: lips, teeth, tongue, eyes
_FILL = 0.92  # of the picture that the sphere around the splats' means takes: those on its rim reach beyond
Progress = Callable[[str, float], None]
Scene = TypeVar("Scene", bound=Splats | Avatar)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeConfig:
    """How thoroughly to look, and how much may be lost."""

    directions: int = 96  # around a scene; around an avatar three times as many, shared out among its poses
    poses: int = 16  # of an avatar: those that place its splats, and random ones
    size: int = 320  # pixels, square, that the sphere around the scene fills
    eps2d: float = 0.3  # px^2: at this size the dilation closes the surface, so that what is behind it counts as hidden
    psnr: float = 45.0  # decibels that pictures keep
    spare: float = 1.0  # decibels more that a picture keeps that was mended
    # cosines, of which all cones are widened by one
    wider: Sequence[float] = (0.01, 0.02, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 0.9)
    slack: float = 0.02  # cosine by which a cone is wider than the direction that it was widened for
    choosing: int = 8  # pictures that choose the threshold
    tests: int = 12  # pictures a round
    rounds: int = 3  # of mending, and of widening all, at most
    test_size: int = 512  # pixels, square, that the scene fills


def with_cones(scene: Scene, config: ConeConfig | None = None, progress: Progress | None = None) -> Scene:
    """The scene with visibility cones, and what pictures keep without what they hide. Deterministic.

    A splat's cone starts as the directions from which it makes more than a threshold of a picture. Then fresh pictures
    (poses and directions that were not looked at before) are drawn as the renderer draws them, with and without the
    hidden splats: where one keeps less than ``psnr``, the cones of the splats that are missing most are widened. At
    last further pictures say what is kept: where one of them keeps less, all cones are widened by the least with
    which further ones all keep it, and others look again. ``cones_psnr`` is the worst of the last ones, over the whole
    of a picture that the scene fills, before black.
    Poses are without expressions: what those move, and what lies within 8 cm of it, has a cone that hides nothing.
    Levels get cones of their own. About two minutes of one core at 40,000 splats.
    Raises GlsplatError for a scene without a finite splat.
    """
    config = config or ConeConfig()
    report = progress or (lambda stage, done: None)
    splats = scene.splats if isinstance(scene, Avatar) else scene
    usable = drawable(splats)
    if not usable.any():
        raise GlsplatError("visibility cones need at least one finite splat")
    rng = np.random.default_rng(_SEED)
    weight, way = _looked_at(scene, usable, rng, config, report)
    axis = unit_vectors(np.einsum("vn,vni->ni", weight, way), 1e-30)
    cosine = np.einsum("vni,ni->vn", way, axis)

    smallest = _cut(weight, cosine, axis, _pictures(scene, usable, rng, config.choosing, config), config, report)
    del weight, way, cosine
    for round_ in range(config.rounds):
        mended = 0
        for k, picture in enumerate(_pictures(scene, usable, rng, config.tests, config)):
            report("looking for what is missing", (round_ + k / config.tests) / (config.rounds + 1))
            if picture.kept(_packed(axis, smallest)) < config.psnr:
                picture.widened(axis, smallest, config)
                mended += 1
        if not mended:
            break
    for round_ in range(config.rounds + 1):
        kept, many = np.inf, 2 * config.tests
        for k, picture in enumerate(_pictures(scene, usable, rng, many, config)):
            report("looking at what is kept", k / many)
            kept = min(kept, picture.kept(_packed(axis, smallest)))
        if kept >= config.psnr or round_ == config.rounds:
            break
        smallest = smallest - _wide_enough(_pictures(scene, usable, rng, many, config), axis, smallest, config, report)
    cones = np.tile(_EVERYWHERE, (len(splats), 1))
    cones[usable] = _packed(axis, smallest)
    if isinstance(scene, Avatar) and scene.shapes is not None:
        cones[_uncovered(scene.splats, scene.shapes)] = _EVERYWHERE
    done = replace(splats, cones=cones, cones_psnr=round(kept, 2))
    return cast("Scene", _with_levels(scene, done, config, progress))


def worth_cones(avatar: Avatar) -> Avatar:
    """The avatar, without cones that hide hardly anything: what widens all of them can leave none that hides."""
    cones = avatar.splats.cones
    if cones is None or (cones[:, 3] > _EVERYWHERE[3]).mean() >= _WORTH:
        return avatar
    levels = tuple(replace(one, content=worth_cones(one.content)) for one in avatar.levels)
    return replace(avatar, splats=replace(avatar.splats, cones=None, cones_psnr=None), levels=levels)


def _uncovered(splats: Splats, shapes: Shapes) -> NDArray[np.bool_]:
    """[N] what an expression moves or may uncover: poses alone do not say from where it can be seen."""
    out = np.diff(shapes.starts) > 0
    far = np.zeros(len(splats), bool)
    far[shapes.rows[np.linalg.norm(shapes.metres, axis=1) > _MOVES]] = True
    far &= splats.finite()
    if far.any():
        rows = np.flatnonzero(splats.finite())
        near = cKDTree(splats.means[far]).query(splats.means[rows], distance_upper_bound=_BEHIND)[0]
        out[rows[np.isfinite(near)]] = True
    return np.asarray(out)


def _with_levels(
    scene: Splats | Avatar, done: Splats, config: ConeConfig, progress: Progress | None
) -> Splats | Avatar:
    if isinstance(scene, Avatar):
        rigged = tuple(replace(one, content=with_cones(one.content, config, progress)) for one in scene.levels)
        return replace(scene, splats=done, levels=rigged)
    levels = tuple(replace(one, content=with_cones(one.content, config, progress)) for one in scene.levels)
    return replace(done, levels=levels)


def hidden(posed: Splats, eyes: Sequence[NDArray[np.float64]], margin: float = 0.0) -> NDArray[np.bool_]:
    """[N] True for splats whose cone holds none of the positions ``eyes`` [3] (cone.glsl).

    A splat without extent in some direction is never hidden: the renderer cannot tell its axes.
    """
    if posed.cones is None:
        raise GlsplatError("these splats have no visibility cones; make them with with_cones")
    axis = np.maximum(posed.cones / 127.0, -1)
    length = np.linalg.norm(axis[:, :3], axis=1)
    out = np.asarray(np.abs(posed.scales).min(axis=1) > _FLAT)
    for eye in eyes:
        with np.errstate(invalid="ignore"):
            along = np.einsum("ni,ni->n", _ways(posed, eye), axis[:, :3])
            out &= along < (axis[:, 3] - 1e-4 + margin) * length
    return out


def _packed(axis: F64, smallest: F64) -> NDArray[np.int8]:
    """[N, 4] rounded to a cone that is not too narrow; a splat that was never seen keeps one of a degree."""
    out = np.empty((len(axis), 4), np.int8)
    lost = ~(np.abs(axis).max(axis=1) > 0.1)
    out[:, :3] = np.rint(np.where(lost[:, None], (0, 0, 1), axis) * 127)
    out[:, 3] = np.where(smallest >= 1, 127, np.clip(np.floor(smallest * 127) - 2, -127, 127))
    return out


def _looked_at(
    scene: Splats | Avatar, usable: NDArray[np.bool_], rng: np.random.Generator, config: ConeConfig, report: Progress
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """[V, N] how much of each view a splat makes (m^2 at its distance), [V, N, 3] its way to the eye (own axes)."""
    poses: Sequence[Pose | None] = [None]
    directions = config.directions
    if isinstance(scene, Avatar):
        directions = max(3 * config.directions // config.poses, 1)
        names = scene.skeleton.names
        poses = list(probe_poses(names))[: config.poses]
        poses += [_pose(names, rng, k) for k in range(config.poses - len(poses))]
    views = len(poses) * directions
    count = int(usable.sum())
    weight, way = np.empty((views, count), np.float32), np.empty((views, count, 3), np.float32)
    view = 0
    weigh = _weigher(count, config.eps2d)
    for pose in poses:
        posed = _posed(scene, pose, usable)
        for direction in sphere(directions) @ Rotation.random(rng=rng).as_matrix():
            report("looking for hidden splats", view / views)
            camera = _far_camera(posed, direction, config.size)
            depth = posed.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
            weight[view] = weigh(posed, camera) * (depth / camera.K[0, 0]) ** 2
            way[view] = _ways(posed, camera.position)
            view += 1
    return weight, way


def _weigher(count: int, eps2d: float) -> Callable[[Splats, Camera], F64]:
    """What gives [N] how much of a picture each splat makes, in pixels: compiled where it can be, else in numpy."""
    if not available() or eps2d != EPS2D:

        def weigh(posed: Splats, camera: Camera) -> F64:
            prints = _footprints(posed, camera, eps2d)
            return np.bincount(prints.splat, prints.alpha * prints.transmittance, prints.count).astype(np.float64)

        return weigh
    from glsplat.extras.authoring.optimize.rasterizer import Rasterizer

    drawing = Rasterizer(count, min_transmittance=0.0)  # also what hardly shows says from where

    def weigh_compiled(posed: Splats, camera: Camera) -> F64:
        drawing.draw(placed(posed), camera, antialias=False)
        return drawing.weights()

    return weigh_compiled


def _cut(
    weight: NDArray[np.float32],
    cosine: F64,
    axis: F64,
    pictures: Iterable[_Picture],
    config: ConeConfig,
    report: Progress,
) -> F64:
    """[N] the smallest cosines by the largest threshold with which the median picture keeps what is asked."""
    found = list(pictures)
    high = float(np.log10(max(weight.max(), 1e-30)))  # decimal logarithm of the threshold in m^2
    low = high - _DECADES
    best = np.full(len(axis), -1.0)
    for step in range(_STEPS):
        report("choosing the threshold", step / _STEPS)
        middle = (low + high) / 2
        smallest = np.where(weight > 10**middle, cosine, 1.0).min(axis=0)
        narrow = _packed(axis, smallest)
        if np.median([picture.kept(narrow) for picture in found]) >= config.psnr:
            best, low = smallest, middle
        else:
            high = middle
    return best


def _wide_enough(pictures: Iterable[_Picture], axis: F64, smallest: F64, config: ConeConfig, report: Progress) -> float:
    """The least of ``config.wider`` with which the pictures all keep enough; the largest, where none does.

    All of them are tried: the lift (lift.glsl) is made for what a threshold hides, so wider cones may keep less.
    """
    kept = np.full(len(config.wider), np.inf)
    for k, picture in enumerate(pictures):
        report("looking how wide", k / (2 * config.tests))
        kept = np.minimum(kept, [picture.kept(_packed(axis, smallest - by)) for by in config.wider])
    enough = np.flatnonzero(kept >= config.psnr + config.spare)
    return config.wider[int(enough[0]) if len(enough) else -1]


def _pose(names: tuple[str, ...], rng: np.random.Generator, k: int) -> Pose:
    """As a fit draws it, in turn as it is, farther, and standing with the arms down."""
    pose = random_pose(names, rng)
    if k % 3 == 1:
        return Pose(1.3 * pose.rotations)
    if k % 3 == 2:
        rotations = 0.3 * pose.rotations
        for name, down in (("left_shoulder", -1.2), ("right_shoulder", 1.2)):
            if name in names:
                rotations[names.index(name), 2] += down
        return Pose(rotations)
    return pose


class _Picture:
    """One view of a scene as the renderer draws it: what each splat adds to each pixel."""

    def __init__(self, posed: Splats, camera: Camera, eps2d: float) -> None:
        self.posed, self.eye, self._size = posed, camera.position, camera.width * camera.height
        prints = _footprints(posed, camera, eps2d, posed.antialias)
        self._splat, self._pixel = prints.splat.astype(np.int32), prints.pixel.astype(np.int32)
        self._alpha = prints.alpha
        self._rgb = placed(posed).rgb
        self._whole = self._drawn(np.zeros(len(posed), bool))

    def kept(self, cones: NDArray[np.int8]) -> float:
        """PSNR of the picture without what ``cones`` hide against the whole one, over black."""
        return _decibel(self._without(hidden(replace(self.posed, cones=cones), [self.eye])))

    def widened(self, axis: F64, smallest: F64, config: ConeConfig) -> None:
        """Widen, in place, the cones that hide most of what the picture misses, until it keeps enough."""
        gone = hidden(replace(self.posed, cones=_packed(axis, smallest)), [self.eye])
        error = (self._without(gone) ** 2).sum(axis=1)
        pairs = np.flatnonzero(gone[self._splat])
        made: F64 = self._alpha[pairs] * transmittance(self._pixel, self._alpha)[pairs]
        blame = np.bincount(self._splat[pairs], made * error[self._pixel[pairs]], len(gone))
        order = np.argsort(-blame, kind="stable")[: np.count_nonzero(blame)]
        few, many = 0, len(order)
        while many - few > max(few // 16, 8):
            middle = (few + many) // 2 if few else max(many // 8, 1)
            back = gone.copy()
            back[order[:middle]] = False
            if _decibel(self._without(back)) >= config.psnr + config.spare:
                many = middle
            else:
                few = middle
        chosen = order[:many]
        way = _ways(self.posed, self.eye)[chosen]
        lost = np.abs(axis[chosen]).max(axis=1) < 0.1
        axis[chosen[lost]] = way[lost]
        along = np.einsum("ni,ni->n", way, axis[chosen]) - config.slack
        smallest[chosen] = np.minimum(smallest[chosen], along)

    def _without(self, gone: NDArray[np.bool_]) -> F64:
        """[P, 3] what the picture lacks without the splats in ``gone``."""
        return np.asarray(reference.lifted(self._drawn(gone), (0.0, 0.0, 0.0))[..., :3] - self._whole[..., :3])

    def _drawn(self, gone: NDArray[np.bool_]) -> F64:
        kept = ~gone[self._splat]
        splat, pixel, alpha = self._splat[kept], self._pixel[kept], self._alpha[kept]
        made: F64 = alpha * transmittance(pixel, alpha)
        columns = [np.bincount(pixel, made * c[splat], minlength=self._size) for c in self._rgb.T]
        return np.stack([*columns, np.bincount(pixel, made, minlength=self._size)], axis=1)


def _decibel(error: F64) -> float:
    return float(-10 * np.log10(max((error**2).mean(), 1e-16)))


def _pictures(
    scene: Splats | Avatar, usable: NDArray[np.bool_], rng: np.random.Generator, count: int, config: ConeConfig
) -> Iterator[_Picture]:
    """Pictures from all around, an avatar in a random pose each, every other one as if it had twice the pixels."""
    for k, direction in enumerate(sphere(count) @ Rotation.random(rng=rng).as_matrix()):
        pose = _pose(scene.skeleton.names, rng, k) if isinstance(scene, Avatar) else None
        posed = _posed(scene, pose, usable)
        yield _Picture(posed, _near_camera(posed, direction, rng, config.test_size), EPS2D / (1 + 3 * (k % 2)))


def _posed(scene: Splats | Avatar, pose: Pose | None, usable: NDArray[np.bool_]) -> Splats:
    if isinstance(scene, Splats):
        return scene.take(usable)
    return posed_splats(scene, pose or Pose.zero(len(scene.skeleton))).take(usable)


def _far_camera(posed: Splats, direction: F64, size: int) -> Camera:
    """From so far that the way to the eye is nearly one direction; the sphere around all fills the picture."""
    points = posed.means.astype(np.float64)
    centre, radius = sphere_around(points)
    K = pinhole(size, size, _fov(_FAR))
    viewmat = look_at(centre + direction * _FAR * radius, centre)
    return Camera(viewmat, K, size, size, near=1e-3 * radius, far=1e3 * radius)


def _fov(far: float) -> float:
    """Degrees that show a sphere from ``far`` radii, and the splats on its rim."""
    return float(2 * np.degrees(np.arctan(np.tan(np.arcsin(1 / far)) / _FILL)))


def _near_camera(posed: Splats, direction: F64, rng: np.random.Generator, size: int) -> Camera:
    """From where somebody looks who goes around it; it fills the picture."""
    points = posed.means.astype(np.float64)
    centre, radius = sphere_around(points)
    viewmat = look_at(centre + direction * rng.uniform(*_NEAR) * radius, centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    slope = max(float(np.abs(seen[:, :2] / seen[:, 2:]).max()), 1e-6)
    K = pinhole(size, size, float(2 * np.degrees(np.arctan(slope / _FILL))))
    return Camera(viewmat, K, size, size, near=1e-3 * radius, far=1e3 * radius)


def _ways(posed: Splats, eye: F64) -> F64:
    """[N, 3] unit vectors from the splats to ``eye`` in the splats' own axes."""
    way = unit_vectors(eye - posed.means.astype(np.float64), 1e-30)
    return np.asarray(np.einsum("nij,ni->nj", axes_of(posed), way), np.float64)


def _footprints(posed: Splats, camera: Camera, eps2d: float, antialias: bool = False) -> Footprints:
    return footprints(*placed(posed)[:4], camera, eps2d=eps2d, antialias=antialias)
