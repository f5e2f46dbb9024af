"""Fit an avatar's splats to pictures of the mesh they came from, without numba.

Stochastic gradient descent (Adam) on position, scale, opacity and colour. Each step draws a random pose and camera:
the whole body at several distances, close-ups of head and hands. The fit closes holes, sharpens texture and undoes
the growth of silhouettes by overlapping discs and the renderer's dilation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.geometry.attribute_transfer import transferred_shapes, transferred_surface
from glsplat.extras.authoring.geometry.footprints import footprints
from glsplat.extras.authoring.geometry.raster import mesh_picture_and_depth
from glsplat.meshes import RiggedMesh
from glsplat.rotations import nearest_rotations
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0, Splats

F64 = NDArray[np.float64]


_CLOSE_UPS = (  # prefixes of the names of joints
    ("head", "jaw"),
    ("left_wrist", "left_index", "left_thumb"),
    ("right_wrist", "right_index", "right_thumb"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineConfig:
    """Step sizes and bounds of the fit."""

    steps: int = 450
    size: int = 448  # pixels, square
    mean_rate: float = 0.025  # in cell sizes a step
    scale_rate: float = 0.025  # natural logarithm a step
    turn_rate: float = 0.012  # radians a step
    opacity_rate: float = 0.03  # logit a step
    color_rate: float = 0.01
    layer: float = 0.02  # metres behind the surface within which splats are drawn: deeper ones must not close its holes
    max_shift: float = 1.0  # cell sizes from where the splat began
    max_turn: float = 0.6  # radians
    max_growth: float = 0.9  # natural logarithm of the scale, either way


class Adam:
    """Adam on the visible rows only."""

    def __init__(self, value: F64, rate: float) -> None:
        self.value, self.rate = value, rate
        self.first, self.second = np.zeros_like(value), np.zeros_like(value)
        self.count = np.zeros(len(value))

    def step(self, gradient: F64, visible: NDArray[np.bool_], decay: float) -> None:
        """Move the visible rows against their gradient."""
        g = gradient[visible]
        self.count[visible] += 1
        shape = (-1,) + (1,) * (g.ndim - 1)
        n = self.count[visible].reshape(shape)
        self.first[visible] += 0.1 * (g - self.first[visible])
        self.second[visible] += 0.01 * (g * g - self.second[visible])
        mean, power = self.first[visible] / (1 - 0.9**n), self.second[visible] / (1 - 0.99**n)
        self.value[visible] -= self.rate * decay * mean / (np.sqrt(power) + 1e-20)


class _Fit:
    """An avatar's splats while they are moved, turned, scaled and coloured; SH degree 0."""

    def __init__(self, avatar: Avatar, config: RefineConfig) -> None:
        self._avatar, self._config = avatar, config
        splats = avatar.splats
        self._start = splats.means.astype(np.float64)
        self._log_start = np.log(splats.scales.astype(np.float64))
        self._cell = np.exp(self._log_start[:, :2].mean(axis=1, keepdims=True))
        self._rest = Rotation.from_quat(splats.quats[:, [1, 2, 3, 0]].astype(np.float64)).as_matrix()
        self._shift = Adam(np.zeros_like(self._start), config.mean_rate)
        self._growth = Adam(np.zeros_like(self._start), config.scale_rate)
        self._turn = Adam(np.zeros_like(self._start), config.turn_rate)
        opacity = np.clip(splats.opacities.astype(np.float64), 0.02, 0.985)
        self._logit = Adam(np.log(opacity / (1 - opacity)), config.opacity_rate)
        self._color = Adam(np.clip(splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0, 1), config.color_rate)
        self._joints, self._weights = avatar.skin.joints.astype(np.int64), avatar.skin.weights.astype(np.float64)

    def descend(
        self,
        pose: Pose,
        camera: Camera,
        loss: Callable[[F64], F64],
        decay: float,
        beyond: F64,
    ) -> None:
        """Take one step for a picture of ``pose`` by ``camera``.

        ``loss`` maps the picture (premultiplied RGBA [H, W, 4]) to its slope; ``decay`` is the fraction of the full
        rates; ``beyond`` as of footprints().
        """
        bones = np.einsum("nk,nkij->nij", self._weights, pose.bones(self._avatar.skeleton)[self._joints])
        scales = np.exp(self._log_start + self._growth.value)
        alpha = 1 / (1 + np.exp(-self._logit.value))
        at = self._start + self._shift.value * self._cell
        means = np.einsum("nij,nj->ni", bones[:, :, :3], at) + bones[:, :, 3]
        turns = Rotation.from_rotvec(self._turn.value).as_matrix()
        rotations = nearest_rotations(bones[:, :, :3]) @ self._rest @ turns
        prints = footprints(means, rotations, scales, alpha, camera, beyond)
        grad = prints.backward(loss(prints.picture(self._color.value)), self._color.value, alpha, scales)
        visible = grad.weight > 0.05
        by_shift = np.einsum("nij,ni->nj", bones[:, :, :3], grad.means) * self._cell
        self._shift.step(by_shift, visible, decay)
        self._growth.step(grad.log_scales, visible, decay)
        self._turn.step(grad.turns, visible, decay)
        self._logit.step(grad.opacities * alpha * (1 - alpha), visible, decay)
        self._color.step(grad.rgb, visible, decay)
        self._bound()

    def _bound(self) -> None:
        config, shift, growth = self._config, self._shift.value, self._growth.value
        shift *= np.minimum(1, config.max_shift / np.maximum(np.linalg.norm(shift, axis=1, keepdims=True), 1e-9))
        np.clip(growth, -config.max_growth, config.max_growth, out=growth)
        np.clip(self._turn.value, -config.max_turn, config.max_turn, out=self._turn.value)
        np.clip(self._logit.value, -3.0, 4.6, out=self._logit.value)
        np.clip(self._color.value, 0, 1, out=self._color.value)

    def avatar(self) -> Avatar:
        """Return the avatar as fitted so far."""
        turns = Rotation.from_matrix(self._rest) * Rotation.from_rotvec(self._turn.value)
        fitted = Splats.create(
            self._start + self._shift.value * self._cell,
            turns.as_quat()[:, [3, 0, 1, 2]],
            np.exp(self._log_start + self._growth.value),
            1 / (1 + np.exp(-self._logit.value)),
            rgb=self._color.value,
            antialias=self._avatar.splats.antialias,
        )
        old, shapes = self._avatar.splats, self._avatar.shapes
        fitted = replace(fitted, surface=transferred_surface(old.surface, old, fitted))
        if shapes is not None:
            shapes = transferred_shapes(shapes, old, fitted)
        return replace(self._avatar, splats=fitted, shapes=shapes)


def refine(
    avatar: Avatar,
    mesh: RiggedMesh,
    seed: int = 0,
    config: RefineConfig | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Avatar:
    """Return the avatar with its splats fitted to ``mesh``; SH degree 0. Deterministic in ``seed``."""
    config = config or RefineConfig()
    rng = np.random.default_rng(seed)
    fit = _Fit(avatar, config)
    for step in range(config.steps):
        if progress:
            progress("fitting to pictures", step / config.steps)
        pose = random_pose(avatar.skeleton.names, rng)
        vertices = mesh.posed(pose)
        camera = _random_camera(mesh, vertices, config.size, rng)
        target, depth = mesh_picture_and_depth(mesh, vertices, camera, 2)
        # weighted by pixels, close-ups would dominate; by surface area, distant views would, and splats would shrink
        # to undo the renderer's dilation there. Metres a pixel lies between.
        shown = depth[np.isfinite(depth)]
        share = float(np.median(shown)) / camera.K[0, 0] if len(shown) else 0.0

        def slope(picture: F64, target: F64 = target, share: float = share) -> F64:
            return 2 * (picture - target) * share

        fit.descend(pose, camera, slope, rate_decay(step / config.steps), depth + config.layer)
    return fit.avatar()


def rate_decay(done: float) -> float:
    """Return the fraction of the full rates after the fraction ``done`` of the steps: from 1 down to 0.05."""
    return float(0.05 ** max(0.0, 1.6 * done - 0.6))


def random_pose(names: tuple[str, ...], rng: np.random.Generator) -> Pose:
    """Return a random pose: arms between hanging and raised, one in three sits deep, joints within their range."""
    index = {name: i for i, name in enumerate(names)}
    if "left_shoulder" not in index or "right_shoulder" not in index:
        return Pose.zero(len(names))
    rotations = rng.normal(0, 0.06, (len(names), 3))
    rotations[index.get("pelvis", 0)] = 0
    if "jaw" in index:
        rotations[index["jaw"]] += (max(0.0, rng.uniform(-0.3, 0.3)), 0.0, 0.0)
    deep = rng.uniform(0.5, 1.0) if rng.uniform() < 1 / 3 else 0.0
    for side, sign in (("left", 1.0), ("right", -1.0)):
        changes = {
            "shoulder": (0.0, -sign * rng.uniform(-0.2, 0.8), -sign * rng.uniform(-0.4, 1.25)),
            "elbow": (0.0, -sign * rng.uniform(0, 1.9), 0.0),
            "wrist": (rng.normal(0, 0.3), rng.normal(0, 0.15), rng.normal(0, 0.3)),
            "hip": (rng.uniform(-0.8, 0.3) - 1.4 * deep, 0.0, sign * rng.uniform(0, 0.3)),
            "knee": (rng.uniform(0, 0.9) + 1.5 * deep, 0.0, 0.0),
            "ankle": (rng.normal(0, 0.2), 0.0, 0.0),
        }
        curl = rng.uniform(0, 0.7)
        for finger in ("index", "middle", "ring", "pinky"):
            for i in (1, 2, 3):
                changes[f"{finger}{i}"] = (0.0, 0.0, -sign * curl * rng.uniform(0.6, 1.0))
        for name, value in changes.items():
            if f"{side}_{name}" in index:
                rotations[index[f"{side}_{name}"]] += value
    return Pose(rotations)


def _random_camera(mesh: RiggedMesh, vertices: F64, size: int, rng: np.random.Generator) -> Camera:
    """Return a camera on the whole figure, its head, a hand or a random spot, mostly level."""
    names = mesh.skeleton.names
    points = vertices[np.unique(mesh.faces)]
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    kind = rng.choice(len(_CLOSE_UPS) + 2, p=[0.45, 0.17, 0.18, 0.1, 0.1])
    if kind == 1:
        centre, radius = points[rng.integers(len(points))], radius * rng.uniform(0.15, 0.4)
    elif kind > 1:
        wanted = np.array([name.startswith(_CLOSE_UPS[kind - 2]) for name in names])
        mine = wanted[mesh.joints[:, 0]]
        if mine.any():
            centre = (vertices[mine].max(axis=0) + vertices[mine].min(axis=0)) / 2
            radius = float(np.linalg.norm(vertices[mine] - centre, axis=1).max())
    turn, lift = rng.uniform(0, 2 * np.pi), np.arcsin(np.clip(rng.normal(0.1, 0.4), -0.95, 0.95))
    direction = np.array([np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)])
    distance = radius * rng.uniform(2.2, 4.0)
    fov = 2 * np.degrees(np.arctan(radius * rng.uniform(0.75, 1.2) / distance))
    centre = centre + rng.normal(0, 0.1, 3) * radius
    viewmat = look_at(centre + direction * distance, centre)
    return Camera(viewmat, pinhole(size, size, float(fov)), size, size)
