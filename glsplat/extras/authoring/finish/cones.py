"""Visibility cones: the directions from which a splat is visible, so that the renderer can skip hidden splats.

About half of an avatar's splats face away from the eye or lie behind opaque ones. The avatar is drawn from all around
in a few poses, which gives each splat's share of each picture. Its cone holds all directions from which that exceeds
a threshold: an axis, in the splat's own axes so that it turns with the skin, and the smallest cosine. Fresh pictures
then find missing splats and widen their cones; others decide how much wider all cones have to be; the last ones give
the PSNR that is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from glsplat import reference
from glsplat.arrays import F32, F64
from glsplat.avatar import Avatar, splats_of
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
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import Level, Splats

_FAR_RADII, _NEAR_RADII = 8.0, (2.0, 5.0)  # distance of the cameras that make and that test cones
_EVERYWHERE = np.array([0, 0, 0, -127], np.int8)  # a cone without an axis: visible from everywhere
_MIN_HIDEABLE_FRACTION = 0.02  # of all splats; with fewer, cones are not worth their bytes
_THRESHOLD_DECADES = 6  # from the largest weight down to the smallest threshold
_THRESHOLD_HALVINGS = 8
_MIN_THICKNESS_M = 1e-15  # thinner splats have no direction in float32 (cone.glsl squares it)
_MIN_MOVE_M = 1e-3  # by an expression: such splats uncover others
_UNCOVERING_M = 0.08  # from such a splat: lips, teeth, tongue, eyes
_FILL_FRACTION = 0.92  # of the picture, by the sphere around the means: splats on its rim reach beyond
Progress = Callable[[str, float], None]
Scene = TypeVar("Scene", bound=Splats | Avatar)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeConfig:
    """Number of pictures, and the PSNR to keep."""

    directions: int = 96  # around a scene; an avatar has three times as many, shared out among its poses
    poses: int = 16  # of an avatar: probe_poses, then random ones
    size: int = 320  # pixels, square, filled by the scene's sphere; small, so that the dilation closes surfaces
    psnr: float = 45.0  # dB that pictures keep
    psnr_margin: float = 1.0  # dB above ``psnr`` to which cones are widened
    # candidate cosines by which all cones are widened
    wider: Sequence[float] = (0.01, 0.02, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 0.9)
    slack: float = 0.02  # cosine by which a widened cone exceeds the direction it was widened to
    choosing: int = 8  # pictures to choose the threshold by
    tests: int = 12  # pictures in each round
    rounds: int = 3  # at most, of widening single cones, and of widening all
    test_size: int = 512  # pixels, square, of pictures filled by the scene


def with_cones(scene: Scene, config: ConeConfig | None = None, progress: Progress | None = None) -> Scene:
    """Return the scene with visibility cones and the PSNR that pictures keep with them. Deterministic.

    A splat's cone starts as the directions from which its share of a picture exceeds a threshold. Fresh poses and
    directions are then drawn as the renderer draws them, with and without the hidden splats. Where a picture keeps
    less than ``psnr``, the cones of the splats that it misses most are widened. Where one of the pictures after that
    keeps less, all cones are widened by the least candidate with which further pictures keep it, and the check is
    repeated. ``cones_psnr`` is the worst of the last pictures, which the scene fills, before black.
    Heads are always drawn: brows, lashes and hair are thin, so that the far side shows through, and people look there.
    Poses have no expressions, so splats that these move, and those within 8 cm, get cones that hide nothing, too.
    Levels get their own cones. About two minutes on one core at 40,000 splats.
    Raises GlsplatError for a scene without a finite splat.
    """
    config = config or ConeConfig()
    report = progress or (lambda stage, done: None)
    splats = splats_of(scene)
    usable = drawable(splats)
    if not usable.any():
        raise GlsplatError("visibility cones need at least one finite splat")
    rng = np.random.default_rng(0)
    weight, to_eye = _weights_and_directions(scene, usable, rng, config, report)
    axis = unit_vectors(np.einsum("vn,vni->ni", weight, to_eye), 1e-30)
    cosine = np.einsum("vni,ni->vn", to_eye, axis)

    smallest = _threshold_cosines(
        weight, cosine, axis, _pictures(scene, usable, rng, config.choosing, config), config, report
    )
    del weight, to_eye, cosine
    for round_ in range(config.rounds):
        below = 0
        for k, picture in enumerate(_pictures(scene, usable, rng, config.tests, config)):
            report("looking for missing splats", (round_ + k / config.tests) / (config.rounds + 1))
            if picture.psnr(_packed(axis, smallest)) < config.psnr:
                picture.widen(axis, smallest, config)
                below += 1
        if not below:
            break
    for round_ in range(config.rounds + 1):
        kept, many = np.inf, 2 * config.tests
        for k, picture in enumerate(_pictures(scene, usable, rng, many, config)):
            report("measuring cones", k / many)
            kept = min(kept, picture.psnr(_packed(axis, smallest)))
        if kept >= config.psnr or round_ == config.rounds:
            break
        smallest = smallest - _widening(_pictures(scene, usable, rng, many, config), axis, smallest, config, report)
    cones = np.tile(_EVERYWHERE, (len(splats), 1))
    cones[usable] = _packed(axis, smallest)
    if isinstance(scene, Avatar):
        if "head" in scene.skeleton.names:
            cones[scene.skeleton.under("head")[strongest_joint(scene.skin.joints, scene.skin.weights)]] = _EVERYWHERE
        if scene.shapes is not None:
            cones[_uncovered(scene.splats, scene.shapes)] = _EVERYWHERE
    done = replace(splats, cones=cones, cones_psnr=round(kept, 2))
    old: Sequence[Level[Any]] = scene.levels
    levels = tuple(replace(one, content=with_cones(one.content, config, progress)) for one in old)
    made: Any = replace(scene, splats=done) if isinstance(scene, Avatar) else done
    return cast("Scene", replace(made, levels=levels))


def without_useless_cones(avatar: Avatar) -> Avatar:
    """Return the avatar without cones if they hide hardly any splat, as after widening all of them."""
    cones = avatar.splats.cones
    if cones is None or (cones[:, 3] > _EVERYWHERE[3]).mean() >= _MIN_HIDEABLE_FRACTION:
        return avatar
    levels = tuple(replace(one, content=without_useless_cones(one.content)) for one in avatar.levels)
    return replace(avatar, splats=replace(avatar.splats, cones=None, cones_psnr=None), levels=levels)


def _uncovered(splats: Splats, shapes: Shapes) -> NDArray[np.bool_]:
    """Return True [N] for splats that an expression moves or may uncover: poses alone do not show them."""
    out = np.diff(shapes.starts) > 0
    far = np.zeros(len(splats), bool)
    far[shapes.rows[np.linalg.norm(shapes.metres, axis=1) > _MIN_MOVE_M]] = True
    far &= splats.finite()
    if far.any():
        rows = np.flatnonzero(splats.finite())
        near = cKDTree(splats.means[far]).query(splats.means[rows], distance_upper_bound=_UNCOVERING_M)[0]
        out[rows[np.isfinite(near)]] = True
    return np.asarray(out)


def hidden(posed: Splats, eyes: Sequence[F64], margin: float = 0.0) -> NDArray[np.bool_]:
    """Return True [N] for splats whose cone holds none of the positions ``eyes`` [3] (cone.glsl).

    A splat without extent in some direction is never hidden: the renderer cannot compute its axes.
    Raises GlsplatError for splats without cones.
    """
    if posed.cones is None:
        raise GlsplatError("these splats have no visibility cones; make them with with_cones")
    axis = np.maximum(posed.cones / 127.0, -1)
    length = np.linalg.norm(axis[:, :3], axis=1)
    out = np.asarray(np.abs(posed.scales).min(axis=1) > _MIN_THICKNESS_M)
    for eye in eyes:
        with np.errstate(invalid="ignore"):
            along = np.einsum("ni,ni->n", _to_eye(posed, eye), axis[:, :3])
            out &= along < (axis[:, 3] - 1e-4 + margin) * length
    return out


def _packed(axis: F64, smallest: F64) -> NDArray[np.int8]:
    """Return the cones [N, 4] rounded to the wider side; a splat that was never seen keeps one of a degree."""
    out = np.empty((len(axis), 4), np.int8)
    never_seen = ~(np.abs(axis).max(axis=1) > 0.1)
    out[:, :3] = np.rint(np.where(never_seen[:, None], (0, 0, 1), axis) * 127)
    out[:, 3] = np.where(smallest >= 1, 127, np.clip(np.floor(smallest * 127) - 2, -127, 127))
    return out


def _weights_and_directions(
    scene: Splats | Avatar, usable: NDArray[np.bool_], rng: np.random.Generator, config: ConeConfig, report: Progress
) -> tuple[F32, F32]:
    """Return each splat's share [V, N] of a view, in m^2, and the direction to the eye [V, N, 3] in its own axes."""
    poses: Sequence[Pose | None] = [None]
    directions = config.directions
    if isinstance(scene, Avatar):
        directions = max(3 * config.directions // config.poses, 1)
        names = scene.skeleton.names
        poses = list(probe_poses(names))[: config.poses]
        poses += [_pose(names, rng, k) for k in range(config.poses - len(poses))]
    views = len(poses) * directions
    count = int(usable.sum())
    weight, to_eye = np.empty((views, count), np.float32), np.empty((views, count, 3), np.float32)
    view = 0
    weigh = _weigher(count)
    for pose in poses:
        posed = _posed(scene, pose, usable)
        for direction in sphere(directions) @ Rotation.random(rng=rng).as_matrix():
            report("looking for hidden splats", view / views)
            camera = _far_camera(posed, direction, config.size)
            depth = posed.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
            weight[view] = weigh(posed, camera) * (depth / camera.K[0, 0]) ** 2
            to_eye[view] = _to_eye(posed, camera.position)
            view += 1
    return weight, to_eye


def _weigher(count: int) -> Callable[[Splats, Camera], F64]:
    """Return a function for each splat's share [N] of a picture, in pixels: compiled with numba, else in numpy."""
    if not available():

        def weigh(posed: Splats, camera: Camera) -> F64:
            prints = _footprints(posed, camera, EPS2D)
            return np.bincount(prints.splat, prints.alpha * prints.transmittance, prints.count).astype(np.float64)

        return weigh
    from glsplat.extras.authoring.optimize.rasterizer import Rasterizer

    rasterizer = Rasterizer(count, min_transmittance=0.0)  # faint shares count too

    def weigh_compiled(posed: Splats, camera: Camera) -> F64:
        rasterizer.draw(placed(posed), camera, antialias=False)
        return rasterizer.weights()

    return weigh_compiled


def _threshold_cosines(
    weight: F32, cosine: F64, axis: F64, pictures: Iterable[_Picture], config: ConeConfig, report: Progress
) -> F64:
    """Return the cosines [N] of the largest threshold with which the median picture keeps ``config.psnr``."""
    found = list(pictures)
    high = float(np.log10(max(weight.max(), 1e-30)))  # decimal logarithm of the threshold in m^2
    low = high - _THRESHOLD_DECADES
    best = np.full(len(axis), -1.0)
    for step in range(_THRESHOLD_HALVINGS):
        report("choosing the threshold", step / _THRESHOLD_HALVINGS)
        middle = (low + high) / 2
        smallest = np.where(weight > 10**middle, cosine, 1.0).min(axis=0)
        narrow = _packed(axis, smallest)
        if np.median([picture.psnr(narrow) for picture in found]) >= config.psnr:
            best, low = smallest, middle
        else:
            high = middle
    return best


def _widening(pictures: Iterable[_Picture], axis: F64, smallest: F64, config: ConeConfig, report: Progress) -> float:
    """Return the least of ``config.wider`` with which all pictures keep enough; the largest, where none does.

    All are tried: opacity compensation (lift.glsl) suits the cones of a threshold, so wider cones may keep less.
    """
    kept = np.full(len(config.wider), np.inf)
    for k, picture in enumerate(pictures):
        report("widening cones", k / (2 * config.tests))
        kept = np.minimum(kept, [picture.psnr(_packed(axis, smallest - by)) for by in config.wider])
    enough = np.flatnonzero(kept >= config.psnr + config.psnr_margin)
    return config.wider[int(enough[0]) if len(enough) else -1]


def _pose(names: tuple[str, ...], rng: np.random.Generator, k: int) -> Pose:
    """Return a random pose: of every three one as it is, one exaggerated, one standing with the arms down."""
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
    """A view of a scene as the renderer draws it: the splat-pixel pairs."""

    def __init__(self, posed: Splats, camera: Camera, eps2d: float) -> None:
        self.posed, self.eye, self._size = posed, camera.position, camera.width * camera.height
        prints = _footprints(posed, camera, eps2d, posed.antialias)
        self._splat, self._pixel = prints.splat.astype(np.int32), prints.pixel.astype(np.int32)
        self._alpha = prints.alpha
        self._rgb = placed(posed).rgb
        self._whole = self._draw(np.zeros(len(posed), bool))

    def psnr(self, cones: NDArray[np.int8]) -> float:
        """Return the PSNR, over black, of the picture without the splats that ``cones`` hide."""
        return _psnr(self._without(hidden(replace(self.posed, cones=cones), [self.eye])))

    def widen(self, axis: F64, smallest: F64, config: ConeConfig) -> None:
        """Widen, in place, the cones that cost the picture most, until it keeps enough."""
        missing = hidden(replace(self.posed, cones=_packed(axis, smallest)), [self.eye])
        error = (self._without(missing) ** 2).sum(axis=1)
        pairs = np.flatnonzero(missing[self._splat])
        made: F64 = self._alpha[pairs] * transmittance(self._pixel, self._alpha)[pairs]
        damage = np.bincount(self._splat[pairs], made * error[self._pixel[pairs]], len(missing))
        order = np.argsort(-damage, kind="stable")[: np.count_nonzero(damage)]
        low, high = 0, len(order)
        while high - low > max(low // 16, 8):
            middle = (low + high) // 2 if low else max(high // 8, 1)
            still_missing = missing.copy()
            still_missing[order[:middle]] = False
            if _psnr(self._without(still_missing)) >= config.psnr + config.psnr_margin:
                high = middle
            else:
                low = middle
        chosen = order[:high]
        to_eye = _to_eye(self.posed, self.eye)[chosen]
        never_seen = np.abs(axis[chosen]).max(axis=1) < 0.1
        axis[chosen[never_seen]] = to_eye[never_seen]
        along = np.einsum("ni,ni->n", to_eye, axis[chosen]) - config.slack
        smallest[chosen] = np.minimum(smallest[chosen], along)

    def _without(self, missing: NDArray[np.bool_]) -> F64:
        """Return the error [P, 3] of the picture without the splats in ``missing``."""
        return np.asarray(reference.lifted(self._draw(missing), (0.0, 0.0, 0.0))[..., :3] - self._whole[..., :3])

    def _draw(self, missing: NDArray[np.bool_]) -> F64:
        kept = ~missing[self._splat]
        splat, pixel, alpha = self._splat[kept], self._pixel[kept], self._alpha[kept]
        made: F64 = alpha * transmittance(pixel, alpha)
        columns = [np.bincount(pixel, made * c[splat], minlength=self._size) for c in self._rgb.T]
        return np.stack([*columns, np.bincount(pixel, made, minlength=self._size)], axis=1)


def _psnr(error: F64) -> float:
    return float(-10 * np.log10(max((error**2).mean(), 1e-16)))


def _pictures(
    scene: Splats | Avatar, usable: NDArray[np.bool_], rng: np.random.Generator, count: int, config: ConeConfig
) -> Iterator[_Picture]:
    """Yield pictures from all around; an avatar's in random poses; every other one with half the dilation."""
    for k, direction in enumerate(sphere(count) @ Rotation.random(rng=rng).as_matrix()):
        pose = _pose(scene.skeleton.names, rng, k) if isinstance(scene, Avatar) else None
        posed = _posed(scene, pose, usable)
        yield _Picture(posed, _near_camera(posed, direction, rng, config.test_size), EPS2D / (1 + 3 * (k % 2)))


def _posed(scene: Splats | Avatar, pose: Pose | None, usable: NDArray[np.bool_]) -> Splats:
    if isinstance(scene, Splats):
        return scene.take(usable)
    return posed_splats(scene, pose or Pose.zero(len(scene.skeleton))).take(usable)


def _far_camera(posed: Splats, direction: F64, size: int) -> Camera:
    """Return a camera so far away that directions to it are nearly equal; the sphere of the scene fills it."""
    points = posed.means.astype(np.float64)
    centre, radius = sphere_around(points)
    K = pinhole(size, size, _fov(_FAR_RADII))
    viewmat = look_at(centre + direction * _FAR_RADII * radius, centre)
    return Camera(viewmat, K, size, size, near=1e-3 * radius, far=1e3 * radius)


def _fov(far: float) -> float:
    """Return the field of view, degrees, of a sphere at ``far`` radii and the splats on its rim."""
    return float(2 * np.degrees(np.arctan(np.tan(np.arcsin(1 / far)) / _FILL_FRACTION)))


def _near_camera(posed: Splats, direction: F64, rng: np.random.Generator, size: int) -> Camera:
    """Return a camera at a viewer's distance, filled by the scene."""
    points = posed.means.astype(np.float64)
    centre, radius = sphere_around(points)
    viewmat = look_at(centre + direction * rng.uniform(*_NEAR_RADII) * radius, centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    slope = max(float(np.abs(seen[:, :2] / seen[:, 2:]).max()), 1e-6)
    K = pinhole(size, size, float(2 * np.degrees(np.arctan(slope / _FILL_FRACTION))))
    return Camera(viewmat, K, size, size, near=1e-3 * radius, far=1e3 * radius)


def _to_eye(posed: Splats, eye: F64) -> F64:
    """Return unit vectors [N, 3] from the splats to ``eye`` in the splats' own axes."""
    to_eye = unit_vectors(eye - posed.means.astype(np.float64), 1e-30)
    return np.asarray(np.einsum("nij,ni->nj", axes_of(posed), to_eye), np.float64)


def _footprints(posed: Splats, camera: Camera, eps2d: float, antialias: bool = False) -> Footprints:
    return footprints(*placed(posed)[:4], camera, eps2d=eps2d, antialias=antialias)
