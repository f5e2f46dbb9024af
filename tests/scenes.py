"""Small scenes made in code, and cameras to look at them."""

from __future__ import annotations

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats


def cloud(count: int = 500, degree: int = 0, seed: int = 0, spread: float = 0.5) -> Splats:
    """Anisotropic splats of mixed opacity around the origin."""
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.normal(0.5, 0.8, (count, 3))
    return Splats.create(
        rng.normal(0, spread, (count, 3)),
        rng.normal(size=(count, 4)),
        np.exp(rng.uniform(-5, -2.5, (count, 3))),
        rng.uniform(0.01, 1, count),
        sh,
    )


def one_splat(**changes: object) -> Splats:
    """A single red splat at the origin; ``changes`` replaces attributes."""
    values: dict[str, object] = {
        "means": [[0.0, 0, 0]],
        "quats": [[1.0, 0, 0, 0]],
        "scales": [[0.1, 0.1, 0.1]],
        "opacities": [0.8],
        "rgb": [[1.0, 0.2, 0.1]],
    }
    values.update(changes)
    return Splats.create(**values)  # type: ignore[arg-type]


def camera(size: int = 64, distance: float = 3.0, **changes: object) -> Camera:
    """Looking along -z at the origin."""
    return Camera(look_at((0, 0, distance), (0, 0, 0)), pinhole(size, size), size, size, **changes)  # type: ignore[arg-type]


def eyes(size: int = 64, distance: float = 3.0, ipd: float = 0.2) -> tuple[Camera, Camera]:
    """A pair whose eyes see clearly different pictures."""
    head = np.eye(4)
    head[2, 3] = distance
    return stereo_cameras(head, ipd, size=(size, size))


def limb(count: int = 600, joints: int = 4, influences: int = 4, degree: int = 0, seed: int = 3) -> Avatar:
    """A rod along x on a chain of joints half a metre apart, weights that fade from joint to joint."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 0.5 * joints, count)
    base = cloud(count, degree, seed)
    means = np.stack([x, *rng.normal(0, 0.05, (2, count))], -1)
    splats = Splats.create(means, base.quats, base.scales, base.opacities, base.sh)
    centres = 0.5 * np.arange(joints) + 0.25
    weights = np.exp(-(((x[:, None] - centres) / 0.2) ** 2))
    skeleton = Skeleton.from_joints(
        tuple(f"joint{i}" for i in range(joints)),
        np.arange(joints) - 1,
        np.stack([0.5 * np.arange(joints), np.zeros(joints), np.zeros(joints)], -1),
    )
    ids = np.broadcast_to(np.arange(joints), weights.shape)
    return Avatar(splats, skeleton, Skin.create(ids, weights, joints, influences))
