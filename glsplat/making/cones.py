"""Visibility cones: from where a splat can be seen at all, so that the renderer may leave out the others.

About half of an avatar's splats face away from the eye or lie behind opaque ones. The avatar is looked at from all
around, in a few poses, and every splat is told how much of each picture it makes. Its cone holds all directions from
which that was more than a threshold: an axis, in the splat's own axes so that it turns with the skin, and the smallest
cosine. The threshold is the largest that keeps pictures of other directions above a wanted PSNR.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError
from glsplat.making.footprints import Footprints, footprints
from glsplat.making.posed import posed_splats
from glsplat.making.visibility import probe_poses, sphere
from glsplat.splats import SH_C0, Splats

__all__ = ["ConeConfig", "hidden", "with_cones"]

F64 = NDArray[np.float64]
_FAR = 8.0  # radii of the scene from which it is looked at
_EVERYWHERE = np.array([0, 0, 0, -127], np.int8)  # a cone without an axis: visible from everywhere
_DECADES = 6  # between the smallest threshold and the largest weight
_STEPS = 9  # halvings of the interval of thresholds
_FLAT = 1e-15  # metres: what is thinner has no direction in float32 (cone.glsl has its square)
Scene = TypeVar("Scene", bound=Splats | Avatar)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeConfig:
    """How thoroughly to look, and how much may be lost."""

    directions: int = 128  # a pose
    size: int = 320  # pixels, square, that the sphere around the scene fills
    eps2d: float = 0.3  # px^2: at this size the dilation closes the surface, so that what is behind it counts as hidden
    test_eps2d: float = 0.03  # px^2: in the tests, as in a picture three times as large, where it shines through
    tests: int = 6  # pictures that choose the threshold
    psnr: float = 42.0  # decibels that each of them keeps; at 1024 x 1024, drawn by the renderer, that was 45 (docs)


def with_cones(
    scene: Scene, config: ConeConfig | None = None, progress: Callable[[str, float], None] | None = None
) -> Scene:
    """The scene with visibility cones, about 0.2 s of one core a direction at 40,000 splats. Deterministic.

    An avatar is seen in the poses that place its splats (visibility.probe_poses); what only another pose uncovers is
    taken for hidden. Raises GlsplatError for a scene without a finite splat.
    """
    config = config or ConeConfig()
    report = progress or (lambda stage, done: None)
    splats = scene.splats if isinstance(scene, Avatar) else scene
    usable = splats.finite() & (np.abs(splats.quats).max(axis=1, initial=0) > 0)
    if not usable.any():
        raise GlsplatError("visibility cones need at least one finite splat")
    poses = [posed.take(usable) for posed in _poses(scene)]
    views = len(poses) * config.directions
    weight = np.empty((views, len(poses[0])), np.float32)  # how much of a view a splat makes, m^2 at its distance
    way = np.empty((views, len(poses[0]), 3), np.float32)  # from the splat to the eye, in the splat's own axes
    for view, (posed, camera) in enumerate(_views(poses, sphere(config.directions), config.size)):
        report("looking for hidden splats", view / views)
        depth = posed.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        area = (depth / camera.K[0, 0]) ** 2  # of a pixel
        weight[view] = _weights(_footprints(posed, camera, config.eps2d)) * area
        way[view] = _ways(posed, camera.position)
    axis = np.einsum("vn,vni->ni", weight, way).astype(np.float64)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-30)
    cosine = np.einsum("vni,ni->vn", way, axis)

    # other directions than those looked from, the poses in turn; opacity compensation undoes the dilation
    test_eps2d = 0.01 * config.test_eps2d if splats.antialias else config.test_eps2d
    spread = sphere(2 * config.directions + 1)[:: 2 * config.directions // config.tests]
    tests = [
        (posed, camera.position, _footprints(posed, camera, test_eps2d))
        for i, direction in enumerate(spread)
        for posed, camera in _views(poses[i % len(poses) : i % len(poses) + 1], direction[None], config.size)
    ]
    best = np.tile(_EVERYWHERE, (len(axis), 1))
    high = float(np.log10(max(weight.max(), 1e-30)))  # decimal logarithm of the threshold in m^2
    low = high - _DECADES
    for step in range(_STEPS):
        report("choosing the threshold", step / _STEPS)
        middle = (low + high) / 2
        smallest = np.where(weight > 10**middle, cosine, 1.0).min(axis=0)
        narrow = _packed(axis, smallest)
        if all(_psnr(replace(posed, cones=narrow), eye, prints) >= config.psnr for posed, eye, prints in tests):
            best, low = narrow, middle
        else:
            high = middle
    cones = np.tile(_EVERYWHERE, (len(splats), 1))
    cones[usable] = best
    done = replace(splats, cones=cones)
    return cast("Scene", replace(scene, splats=done) if isinstance(scene, Avatar) else done)


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


def _poses(scene: Splats | Avatar) -> list[Splats]:
    if isinstance(scene, Splats):
        return [scene]
    return [posed_splats(scene, pose) for pose in probe_poses(scene.skeleton.names)]


def _views(poses: Sequence[Splats], directions: F64, size: int) -> Iterator[tuple[Splats, Camera]]:
    """Each pose from each direction, from so far that the way to the eye is nearly one direction."""
    for posed in poses:
        points = posed.means.astype(np.float64)
        centre = (points.max(axis=0) + points.min(axis=0)) / 2
        radius = max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-6)
        K = pinhole(size, size, float(2 * np.degrees(np.arctan(1 / _FAR))))
        for direction in directions:
            viewmat = look_at(centre + direction * _FAR * radius, centre)
            yield posed, Camera(viewmat, K, size, size, near=1e-3 * radius, far=1e3 * radius)


def _axes(posed: Splats) -> F64:
    """[N, 3, 3] columns: principal axes as they come out of M, where a negative scale turns one round."""
    sign = np.where(posed.scales < 0, -1.0, 1.0)
    return reference.quaternion_matrices(posed.quats.astype(np.float64)) * sign[:, None, :]


def _ways(posed: Splats, eye: F64) -> F64:
    """[N, 3] unit vectors from the splats to ``eye`` in the splats' own axes."""
    way = eye - posed.means.astype(np.float64)
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-30)
    return np.asarray(np.einsum("nij,ni->nj", _axes(posed), way), np.float64)


def _footprints(posed: Splats, camera: Camera, eps2d: float) -> Footprints:
    scales, opacities = np.abs(posed.scales.astype(np.float64)), np.clip(posed.opacities.astype(np.float64), 0, 1)
    return footprints(posed.means.astype(np.float64), _axes(posed), scales, opacities, camera, eps2d=eps2d)


def _weights(prints: Footprints) -> F64:
    """[N] how many pixels of the picture each splat makes."""
    return np.bincount(prints.splat, prints.alpha * prints.transmittance, prints.count).astype(np.float64)


def _psnr(posed: Splats, eye: F64, prints: Footprints) -> float:
    """Of the picture without the hidden splats against the whole one, base colours."""
    rgb = np.clip(posed.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0, 1)
    kept = reference.lifted(prints.without(hidden(posed, [eye])).picture(rgb), (0.0, 0.0, 0.0))
    square = (kept - prints.picture(rgb))[..., :3] ** 2
    return float(-10 * np.log10(max(square.mean(), 1e-16)))
