"""Levels of detail fitted to pictures of the finest, each at the size at which it stands in for it.

A level starts as the finest with neighbours merged. Stochastic gradient descent (refine.Fit) then brings its pictures
close to those of the finest, drawn as the renderer draws both: with the dilation and, where the splats ask for it,
opacity compensation. Cameras stand where the level will be looked at: a splat covers a few pixels, however many there
are. Where the mesh is at hand the pictures to come close to are part finest, part mesh, so that what a level cannot
copy it does not get wrong the same way twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at
from glsplat.errors import GlsplatError
from glsplat.making.detail.merge import MergeConfig, merged
from glsplat.making.footprints import footprints
from glsplat.making.posed import posed_splats
from glsplat.making.raster import mesh_picture_and_depth
from glsplat.making.refine import Fit, RefineConfig, falling, random_pose
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0

__all__ = ["FittedConfig", "fitted_levels"]

F64 = NDArray[np.float64]
_RIM = 3  # pixels around what a picture shows
_LARGEST = 2048  # pixels a side


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedConfig:
    """How levels are fitted."""

    steps: int = 160  # a level
    pictures: int = 30  # different ones, drawn again and again
    mesh_share: float = 0.3  # of the pictures to come close to; the rest is the finest
    splat: float = 1.55  # pixels that the median splat of a level measures (sigma), at the middle of its distances
    nearest: float = 1.55  # of these pixels, from the nearest distance
    farthest: float = 0.65
    faster: float = 1.0  # rates of the descent against those of refine
    merge: MergeConfig | None = None


def fitted_levels(
    avatar: Avatar,
    counts: Sequence[int],
    mesh: RiggedMesh | None = None,
    seed: int = 0,
    config: FittedConfig | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Avatar, ...]:
    """Avatars of ``counts`` splats (falling) that look like ``avatar`` from afar; SH degree 0. Deterministic.

    ``mesh`` is the one that it was made from; without it, pictures of the avatar alone decide. Raises
    GlsplatError for counts that do not fall from the avatar's own.
    """
    config = config or FittedConfig()
    sizes = [len(avatar.splats), *counts]
    if any(not 0 < few < many for many, few in pairwise(sizes)):
        raise GlsplatError(f"levels need fewer and fewer splats below {sizes[0]}, not {', '.join(map(str, counts))}")
    made: list[Avatar] = []
    for index, count in enumerate(counts):
        rng = np.random.default_rng((seed, count))

        def show(done: float, index: int = index) -> None:
            if progress:
                progress("fitting levels of detail", (index + done) / len(counts))

        made.append(_fitted(avatar, count, mesh, rng, config, show))
    return tuple(made)


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    pose: Pose
    camera: Camera
    target: NDArray[np.float32]  # [H, W, 4] premultiplied


def _fitted(
    avatar: Avatar,
    count: int,
    mesh: RiggedMesh | None,
    rng: np.random.Generator,
    config: FittedConfig,
    show: Callable[[float], None],
) -> Avatar:
    start = merged(replace(avatar, levels=(), splats=replace(avatar.splats, cones=None)), count, config.merge)
    sizes = np.sort(start.splats.scales.astype(np.float64), axis=1)[:, 1:]
    density = config.splat / float(np.median(np.sqrt(sizes.prod(axis=1))))  # pixels a metre
    fit = Fit(start, _rates(config.faster))
    shots: list[_Shot] = []
    order: list[int] = []
    for step in range(config.steps):
        show(step / config.steps)
        if len(shots) < config.pictures:
            nearer = np.exp(rng.uniform(np.log(config.farthest), np.log(config.nearest)))
            shots.append(_shot(avatar, mesh, density * nearer, config.mesh_share, rng))
            shot = shots[-1]
        else:
            order = order or [int(i) for i in rng.permutation(len(shots))]
            shot = shots[order.pop()]

        def slope(picture: F64, target: NDArray[np.float32] = shot.target) -> F64:
            return np.asarray(2 * (picture - target))

        fit.descend(shot.pose, shot.camera, slope, falling(step / config.steps), antialias=avatar.splats.antialias)
    return replace(fit.avatar(), meta=dict(avatar.meta))


def _rates(faster: float) -> RefineConfig:
    rates = RefineConfig()
    return replace(
        rates,
        mean_rate=faster * rates.mean_rate,
        scale_rate=faster * rates.scale_rate,
        turn_rate=faster * rates.turn_rate,
        opacity_rate=faster * rates.opacity_rate,
        color_rate=faster * rates.color_rate,
    )


def _shot(
    avatar: Avatar, mesh: RiggedMesh | None, density: float, mesh_share: float, rng: np.random.Generator
) -> _Shot:
    """A random pose, and the finest in it from a random side, as large as ``density`` (pixels a metre) shows it."""
    pose = random_pose(avatar.skeleton.names, rng)
    posed = posed_splats(avatar, pose)
    means, scales = posed.means.astype(np.float64), np.abs(posed.scales.astype(np.float64))
    camera = _camera(means, density, rng)
    prints = footprints(
        means,
        reference.quaternion_matrices(posed.quats.astype(np.float64)),
        scales,
        np.clip(posed.opacities.astype(np.float64), 0, 1),
        camera,
        antialias=posed.antialias,
    )
    target = prints.picture(np.clip(posed.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0, 1))
    if mesh is not None:
        target += mesh_share * (mesh_picture_and_depth(mesh, mesh.posed(pose), camera, 2)[0] - target)
    return _Shot(pose, camera, target.astype(np.float32))


def _camera(points: F64, density: float, rng: np.random.Generator) -> Camera:
    """From anywhere around, mostly level, a few sizes away; the picture is as large as what it shows."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, size = (low + high) / 2, float((high - low).max())
    turn, lift = rng.uniform(0, 2 * np.pi), np.arcsin(np.clip(rng.normal(0.1, 0.4), -0.95, 0.95))
    direction = np.array([np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)])
    distance = size * rng.uniform(1.2, 3.0)
    viewmat = look_at(centre + direction * distance, centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    focal = density * distance
    flat = seen[:, :2] / np.maximum(seen[:, 2:], 0.1 * size) * focal
    left, top = np.floor(flat.min(axis=0)) - _RIM - rng.uniform(0, 1, 2)
    width, height = (int(n) for n in np.ceil(flat.max(axis=0)) + _RIM - np.floor((left, top)))
    K = np.array([[focal, 0, -left], [0, focal, -top], [0, 0, 1.0]])
    return Camera(viewmat, K, min(width, _LARGEST), min(height, _LARGEST), near=1e-3 * size)
