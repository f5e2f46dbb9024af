"""Fit an avatar's splats to pictures of the mesh they came from.

Stochastic gradient descent (Adam) on position, scale, opacity and colour; each step draws a pose and a camera at
random, the whole body at several distances and close-ups of head and hands. It closes holes, sharpens texture and
takes back the bloat that overlapping discs and the renderer's dilation give to silhouettes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.making.footprints import footprints
from glsplat.making.raster import mesh_picture_and_depth
from glsplat.meshes import RiggedMesh
from glsplat.rotations import nearest_rotations
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0, Splats

__all__ = ["RefineConfig", "refine"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineConfig:
    """How far and how fast splats may move."""

    steps: int = 450
    size: int = 448  # pixels, square
    mean_rate: float = 0.025  # in cell sizes a step
    scale_rate: float = 0.025  # natural logarithm a step
    turn_rate: float = 0.012  # radians a step
    opacity_rate: float = 0.03  # logit a step
    color_rate: float = 0.01
    alpha_weight: float = 1.0  # of the coverage in the loss, against colour
    layer: float = 0.02  # metres; what lies farther behind the surface must not help to close it
    max_shift: float = 1.0  # cell sizes from where the splat began
    max_turn: float = 0.6  # radians
    max_growth: float = 0.9  # natural logarithm of the scale, either way


class _Adam:
    """Adam that leaves alone what a step did not see (rows with no gradient)."""

    def __init__(self, value: F64, rate: float) -> None:
        self.value, self.rate = value, rate
        self.first, self.second = np.zeros_like(value), np.zeros_like(value)
        self.count = np.zeros(len(value))

    def step(self, gradient: F64, seen: NDArray[np.bool_], decay: float) -> None:
        g = gradient[seen]
        self.count[seen] += 1
        shape = (-1,) + (1,) * (g.ndim - 1)
        n = self.count[seen].reshape(shape)
        self.first[seen] += 0.1 * (g - self.first[seen])
        self.second[seen] += 0.01 * (g * g - self.second[seen])
        mean, power = self.first[seen] / (1 - 0.9**n), self.second[seen] / (1 - 0.99**n)
        self.value[seen] -= self.rate * decay * mean / (np.sqrt(power) + 1e-20)


def refine(
    avatar: Avatar,
    mesh: RiggedMesh,
    seed: int = 0,
    config: RefineConfig | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Avatar:
    """The avatar with its splats fitted to ``mesh``; SH degree 0. Deterministic in ``seed``."""
    config = config or RefineConfig()
    rng = np.random.default_rng(seed)
    splats = avatar.splats
    start = splats.means.astype(np.float64)
    log_start = np.log(splats.scales.astype(np.float64))
    cell = np.exp(log_start[:, :2].mean(axis=1, keepdims=True))
    rest = Rotation.from_quat(splats.quats[:, [1, 2, 3, 0]].astype(np.float64)).as_matrix()
    shift = _Adam(np.zeros_like(start), config.mean_rate)
    growth = _Adam(np.zeros_like(start), config.scale_rate)
    turn = _Adam(np.zeros_like(start), config.turn_rate)
    opacity = np.clip(splats.opacities.astype(np.float64), 0.02, 0.985)
    logit = _Adam(np.log(opacity / (1 - opacity)), config.opacity_rate)
    color = _Adam(np.clip(splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0, 1), config.color_rate)
    joints, weights = avatar.skin.joints.astype(np.int64), avatar.skin.weights.astype(np.float64)

    for step in range(config.steps):
        if progress:
            progress("fitting to pictures", step / config.steps)
        pose = _random_pose(avatar.skeleton.names, rng)
        vertices = mesh.posed(pose)
        camera = _random_camera(mesh, vertices, config.size, rng)
        target, depth = mesh_picture_and_depth(mesh, vertices, camera, 2)
        bones = np.einsum("nk,nkij->nij", weights, pose.bones(avatar.skeleton)[joints])
        scales = np.exp(log_start + growth.value)
        alpha = 1 / (1 + np.exp(-logit.value))
        means = np.einsum("nij,nj->ni", bones[:, :, :3], start + shift.value * cell) + bones[:, :, 3]
        rotations = nearest_rotations(bones[:, :, :3]) @ rest @ Rotation.from_rotvec(turn.value).as_matrix()
        prints = footprints(means, rotations, scales, alpha, camera, depth + config.layer)
        by_picture = 2 * (prints.picture(color.value) - target)
        by_picture[..., 3] *= config.alpha_weight
        # a splat has more pixels in a close-up, and would listen to those only; by surface area, it would hear the
        # distant views only and shrink to make up for the renderer's dilation there. In between, both look right.
        shown = depth[np.isfinite(depth)]
        by_picture *= np.median(shown) / camera.K[0, 0] if len(shown) else 0.0
        grad = prints.backward(by_picture, color.value, alpha, scales)
        seen = grad.weight > 0.05
        decay = 0.05 ** max(0.0, 1.6 * step / config.steps - 0.6)
        by_shift = np.einsum("nij,ni->nj", bones[:, :, :3], grad.means) * cell
        shift.step(by_shift, seen, decay)
        growth.step(grad.log_scales, seen, decay)
        turn.step(grad.turns, seen, decay)
        logit.step(grad.opacities * alpha * (1 - alpha), seen, decay)
        color.step(grad.rgb, seen, decay)
        length = np.linalg.norm(shift.value, axis=1, keepdims=True)
        shift.value *= np.minimum(1, config.max_shift / np.maximum(length, 1e-9))
        np.clip(growth.value, -config.max_growth, config.max_growth, out=growth.value)
        np.clip(turn.value, -config.max_turn, config.max_turn, out=turn.value)
        np.clip(logit.value, -3.0, 4.6, out=logit.value)
        np.clip(color.value, 0, 1, out=color.value)

    fitted = Splats.create(
        start + shift.value * cell,
        (Rotation.from_matrix(rest) * Rotation.from_rotvec(turn.value)).as_quat()[:, [3, 0, 1, 2]],
        np.exp(log_start + growth.value),
        1 / (1 + np.exp(-logit.value)),
        rgb=color.value,
        antialias=splats.antialias,
    )
    return replace(avatar, splats=fitted)


def _random_pose(names: tuple[str, ...], rng: np.random.Generator) -> Pose:
    """Arms anywhere between hanging and raised, one pose in three sits deep, joints bent the way they bend."""
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


_CLOSE_UPS = (
    ("head", "jaw"),
    ("left_wrist", "left_index", "left_thumb"),
    ("right_wrist", "right_index", "right_thumb"),
)


def _random_camera(mesh: RiggedMesh, vertices: F64, size: int, rng: np.random.Generator) -> Camera:
    """The whole figure, its head, a hand or a random spot, from anywhere around, mostly level."""
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
