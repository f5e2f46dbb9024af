"""Fit splats to pictures by Adam: positions, shapes, opacities and colours; recycle those of little use.

    loss = metres_per_pixel * (sum (picture - target)^2 + 0.03 * sum (1 - SSIM))

Each pass takes the pictures in a new random order. Three times, the splats that show least in every picture are
removed, and as many splats where the error is largest are split in two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.attribute_transfer import (
    expression_maps,
    transferred_shapes,
    transferred_surface,
)
from glsplat.extras.authoring.geometry.posed import PosedSplats, drawable
from glsplat.extras.authoring.optimize import descent
from glsplat.extras.authoring.optimize.loss import loss_of
from glsplat.extras.authoring.optimize.rasterizer import Gradients, Rasterizer
from glsplat.extras.authoring.optimize.refine import rate_decay
from glsplat.extras.authoring.optimize.target_pictures import TargetPicture
from glsplat.extras.authoring.sample.surface import joint_zones
from glsplat.rotations import matrix_quaternions, nearest_rotations, quaternion_matrices
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import Skin, strongest_joint
from glsplat.splats import SH_C0, Splats

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Report = Callable[[str, float], None]

_REPORT_STEPS, _ERROR_DECAY = 10, 0.95  # the reported error is a running mean
_MIN_LOGIT, _MAX_LOGIT = -5.5, 4.6  # of the opacity
_MIN_START_OPACITY, _MAX_START_OPACITY = 0.0041, 0.985


@dataclass(frozen=True, slots=True, kw_only=True)
class FitConfig:
    """Step sizes and bounds of the fit. Rates are those of the first step; they decay to a twentieth."""

    steps: int = 450
    mean_rate: float = 0.05  # cells
    scale_rate: float = 0.05  # natural logarithm
    turn_rate: float = 0.024  # radians
    opacity_rate: float = 0.06  # logit
    colour_rate: float = 0.02
    ssim_weight: float = 0.03  # of 1 - SSIM in the loss
    max_shift: float = 1.0  # cells from the start
    max_growth: float = 0.6  # natural logarithm of the scales
    max_shrink: float = 0.9  # natural logarithm
    scale_decay: float = 0.16  # decoupled decay of the scales, fraction of their rate: overlap costs drawing time
    max_turn: float = 0.6  # radians
    recycled_fraction: float = 0.05  # of the splats, removed each time, and as many split
    recycle_at: tuple[float, ...] = (0.15, 0.3, 0.45)  # fractions of the steps


def fitted(
    avatar: Avatar,
    pictures: Sequence[TargetPicture],
    seed: int = 0,
    config: FitConfig | None = None,
    progress: Report | None = None,
    threads: int | None = None,
) -> Avatar:
    """Return the avatar with its splats fitted to the pictures; SH degree 0, as many splats, no levels. Needs numba.

    Its shapes deform the splats for pictures with expressions, and are transferred to the fitted splats. The same
    bytes for the same input, with any number of threads. Splats that cannot be drawn (not finite, or with a scale of
    zero or less) stay as they are. Ctrl-C stops the fit and keeps its state.
    """
    config, report = config or FitConfig(), progress or (lambda stage, done: None)
    rng = np.random.default_rng(seed)
    if not (config.steps and pictures):
        return avatar
    fit = _Fit(avatar, pictures, Rasterizer(len(avatar.splats), threads), config)
    first = len(pictures)  # after a whole pass
    recycle_steps = [max(first, round(config.steps * fraction)) for fraction in config.recycle_at]
    queue: list[int] = []
    error = 0.0
    for step in range(config.steps):
        try:
            queue = queue or [int(i) for i in rng.permutation(len(pictures))]
            step_error = fit.descend(queue.pop(), rate_decay(step / config.steps))
            error = step_error if step == 0 else _ERROR_DECAY * error + (1 - _ERROR_DECAY) * step_error
            if step % _REPORT_STEPS == 0:
                report(f"fitting splats, error {error:.4f}", step / config.steps)
            if step + 1 in recycle_steps and config.recycled_fraction:
                fit.recycle(config.recycled_fraction)
        except KeyboardInterrupt:
            report(f"stopped after {step} of {config.steps} steps, error {error:.4f}", 1.0)
            break
    return fit.avatar()


class _Fit:
    """The state of a fit."""

    def __init__(
        self, avatar: Avatar, pictures: Sequence[TargetPicture], rasterizer: Rasterizer, config: FitConfig
    ) -> None:
        self._avatar, self._pictures, self._rasterizer, self._config = avatar, pictures, rasterizer, config
        splats = avatar.splats
        count = len(splats)
        self._antialias = splats.antialias
        scales = splats.scales.astype(np.float64)
        self._drawn = drawable(splats) & (scales > 0).all(axis=1) & np.isfinite(splats.sh[:, 0]).all(axis=1)
        alive = self._drawn[:, None]
        logs = np.log(np.where(alive, scales, 1.0))
        self._start = (
            np.where(alive, splats.means, 0).astype(np.float64),
            np.ascontiguousarray(quaternion_matrices(np.where(alive, splats.quats, (1, 0, 0, 0)))),
            logs,
            np.exp(logs[:, :2].mean(axis=1)),
        )
        self._values = np.zeros((count, descent.COUNT), np.float32)
        self._values[:, 9] = _logit(np.where(self._drawn, splats.opacities, 0.5))
        self._values[:, 10:] = np.clip(np.where(alive, splats.sh[:, 0], 0) * SH_C0 + 0.5, 0, 1)
        self._moments, self._powers = np.zeros_like(self._values), np.zeros_like(self._values)
        self._counts = np.zeros(count, np.float32)
        self._placed = PosedSplats(*(np.zeros((count, *shape)) for shape in ((3,), (3, 3), (3,), (), (3,))))
        self._posed = PosedSplats(np.zeros((count, 3)), np.zeros((count, 3, 3)), *self._placed[2:])
        self._joints, self._weights = avatar.skin.joints.astype(np.intp), avatar.skin.weights.astype(np.float64)
        strongest = strongest_joint(self._joints, self._weights)
        self._zones = joint_zones(avatar.skeleton.names)[strongest]
        self._origin = np.arange(count)  # the splat that each was split from: it has its shapes
        self._blended: dict[int, tuple[F32, F32]] = {}
        self._max_weight, self._max_error = np.zeros(count), np.zeros(count)
        rates = (config.mean_rate, config.scale_rate, config.turn_rate, config.opacity_rate, config.colour_rate)
        self._rates = np.repeat(rates, (3, 3, 3, 1, 3)).astype(np.float64)
        self._shrink = np.repeat((0.0, config.scale_decay, 0.0, 0.0, 0.0), (3, 3, 3, 1, 3))
        growth = -config.max_shrink, config.max_growth
        self._bounds = (config.max_shift, *growth, config.max_turn, _MIN_LOGIT, _MAX_LOGIT)

    def descend(self, index: int, decay: float) -> float:
        """Take one step for a picture; return its RMS error."""
        picture, config = self._pictures[index], self._config
        self._compose()
        bones = None if picture.pose is None else self._blend(picture.pose)
        splats = self._placed
        if bones is not None:
            splats = self._posed
            descent.pose(0, len(self._values), *bones, *self._placed[:2], *splats[:2])
        drawn = self._rasterizer.draw(splats, picture.camera, self._antialias)
        loss = loss_of(drawn, picture.target, picture.metres_per_pixel, config.ssim_weight, picture.trust)
        gradients = self._rasterizer.backward(loss.slope, loss.error)
        if bones is not None:
            gradients.means[:] = np.einsum("nij,ni->nj", bones[0][:, :, :3], gradients.means)
        self._record(gradients, picture.metres_per_pixel)
        state = self._values, self._moments, self._powers, self._counts
        rows = self._rasterizer.out
        descent.step(
            0, len(self._values), rows, *state, self._start[3], self._rates * decay, self._shrink, self._bounds
        )
        return float(np.sqrt(loss.squares))

    def recycle(self, fraction: float) -> None:
        """Prune the least visible fraction and split as many splats where the error is largest.

        Hands, head and the rest each keep their number: by pixels alone the small splats of hands would go.
        """
        removed, split = self._removed_and_split(fraction)
        self._compose()
        means, rotations, scales, opacities, rgb = self._placed
        longest = scales[split].argmax(axis=1)
        rows = np.arange(len(split))
        half_axis = rotations[split, :, longest] * scales[split, longest][:, None] * 0.5
        logs = np.log(scales[split])
        logs[rows, longest] -= 0.5
        for chosen, sign in ((split, 1), (removed, -1)):
            start_means, start_rotations, start_logs, cells = self._start
            start_means[chosen], start_rotations[chosen] = means[split] + sign * half_axis, rotations[split]
            start_logs[chosen], cells[chosen] = logs, np.exp(logs[:, :2].mean(axis=1))
        for chosen in (removed, split):
            values = np.zeros((len(split), descent.COUNT), np.float32)
            values[:, 9], values[:, 10:] = _logit(opacities[split]), rgb[split]
            self._values[chosen], self._moments[chosen], self._powers[chosen] = values, 0, 0
            self._counts[chosen] = 0
        self._joints[removed], self._weights[removed] = self._joints[split], self._weights[split]
        self._origin[removed] = self._origin[split]
        for blended, turned in self._blended.values():
            blended[removed], turned[removed] = blended[split], turned[split]
        self._max_weight[:], self._max_error[:] = 0, 0

    def _removed_and_split(self, fraction: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return as many splats to remove as to split, zone by zone."""
        removed, split = [], []
        for zone in np.unique(self._zones):
            mine = np.flatnonzero(self._drawn & (self._zones == zone))
            by_weight = mine[np.argsort(self._max_weight[mine], kind="stable")]
            count = min(int(fraction * len(mine)), len(mine) // 2)
            kept = by_weight[count:]
            removed.append(by_weight[:count])
            split.append(kept[np.argsort(-self._max_error[kept], kind="stable")[:count]])
        return np.concatenate(removed), np.concatenate(split)

    def avatar(self) -> Avatar:
        """Return the avatar as fitted so far."""
        self._compose()
        means, rotations, scales, opacities, rgb = self._placed
        first = self._avatar.splats
        alive = self._drawn[:, None]
        made = Splats.create(
            np.where(alive, means, first.means),
            np.where(alive, matrix_quaternions(rotations), first.quats),
            np.where(alive, scales, first.scales),
            np.where(self._drawn, opacities, first.opacities),
            np.where(alive, (rgb - 0.5) / SH_C0, first.sh[:, 0])[:, None],
            antialias=self._antialias,
        )
        made = replace(made, surface=transferred_surface(first.surface, first, made))
        skin = Skin(self._joints.astype(self._avatar.skin.joints.dtype), self._weights.astype(np.float32))
        shapes = self._avatar.shapes
        if shapes is not None:
            shapes = transferred_shapes(shapes.take(self._origin), first.take(self._origin), made)
        return replace(self._avatar, splats=made, skin=skin, shapes=shapes, levels=())

    def _compose(self) -> None:
        descent.compose(0, len(self._values), self._values, self._start, self._placed[:5])
        self._placed.opacities[~self._drawn] = 0

    def _record(self, gradients: Gradients, weight: float) -> None:
        np.maximum(self._max_weight, gradients.weight, out=self._max_weight)
        np.maximum(self._max_error, gradients.error * weight, out=self._max_error)

    def _blend(self, pose: Pose) -> tuple[F32, F32]:
        """Return the blended bones [N, 3, 4] of a pose with its expression, and their rotations and bends [N, 3, 3]."""
        if id(pose) not in self._blended:
            bones = pose.bones(self._avatar.skeleton)
            blended = np.einsum("nk,nkij->nij", self._weights, bones[self._joints])
            turned = nearest_rotations(blended[:, :, :3])
            weights = self._avatar.weights(pose)
            if weights is not None and self._avatar.shapes is not None:
                bend, move = expression_maps(self._avatar.shapes, self._avatar.splats, weights)
                bend, move = bend[self._origin], move[self._origin]
                blended[:, :, 3] += np.einsum("nij,nj->ni", blended[:, :, :3], move)
                blended[:, :, :3], turned = blended[:, :, :3] @ bend, turned @ bend
            self._blended[id(pose)] = blended.astype(np.float32), turned.astype(np.float32)
        return self._blended[id(pose)]


def _logit(opacities: NDArray[np.floating]) -> F64:
    clipped = np.clip(opacities.astype(np.float64), _MIN_START_OPACITY, _MAX_START_OPACITY)
    return np.asarray(np.log(clipped / (1 - clipped)))
