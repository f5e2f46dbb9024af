"""Read avatars from dumps of LHM's Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.errors import FormatError, PoseError
from glsplat.extras.formats.npz import read_arrays
from glsplat.io.files import naming, open_regular
from glsplat.rotations import matrix_quaternions, nearest_rotations, quaternion_product
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.splats import Splats

_LHM_KEYS: dict[str, tuple[int | str, ...]] = {
    "query_points": ("N", 3),
    "offset_xyz": ("N", 3),
    "opacity": ("N", 1),
    "rotation_wxyz": ("N", 4),
    "scaling": ("N", 3),
    "rgb": ("N", 3),
    "skinning_weight": ("N", 55),
    "transform_mat_neutral_pose": (55, 4, 4),
    "betas": (10,),
    "shape_dirs": ("N", 3, 10),
    "joints_zero": (55, 3),
    "parents": (55,),
    "is_constrain_body": ("N",),
}


def load_lhm_dump(path: str | Path) -> Avatar:
    """Read the .npz that a user's own LHM checkout dumps: activated attributes in LHM's canonical pose.

    Keys and shapes (N splats): query_points (N, 3), offset_xyz (N, 3), opacity (N, 1), rotation_wxyz (N, 4), scaling
    (N, 3), rgb (N, 3) in [0, 1], skinning_weight (N, 55), transform_mat_neutral_pose (55, 4, 4) canonical to zero pose,
    betas (10), shape_dirs (N, 3, 10), joints_zero (55, 3), parents (55), is_constrain_body (N).

    Linear blend skinning takes means to the zero pose, then the shape is added; rotations turn with the blend, except
    for splats of ``is_constrain_body``: LHM draws those as stored, in every pose. Here they start as stored and turn
    with the body in other poses (docs/avatars.md says why). Feet are put on y = 0.
    Raises FormatError naming the file and the key.
    """
    data = _arrays(path)
    try:
        count = _check(data)
        query, transform = data["query_points"] + data["offset_xyz"], data["transform_mat_neutral_pose"]
        weights = data["skinning_weight"]
        total = weights.sum(axis=1, keepdims=True)
        blended = np.einsum("nj,jab->nab", weights / np.where(total > 0, total, 1), transform)
        zero = np.einsum("nab,nb->na", blended[:, :3, :3], query) + blended[:, :3, 3]
        means = zero + np.einsum("nax,x->na", data["shape_dirs"], data["betas"])
        constrained = data["is_constrain_body"] > 0.5
        quats = data["rotation_wxyz"]
        turned = quaternion_product(matrix_quaternions(nearest_rotations(blended[:, :3, :3])), quats)
        quats = np.where(constrained[:, None], quats, turned)
        floor = float(np.percentile(means[:, 1], 0.1)) if count else 0.0
        up = np.array([0, floor, 0])
        splats = Splats.create(means - up, quats, data["scaling"], data["opacity"], rgb=data["rgb"])
        skeleton = Skeleton.from_joints(JOINT_NAMES, data["parents"].astype(np.int32), data["joints_zero"] - up)
        skin = Skin.create(np.broadcast_to(np.arange(55), weights.shape), weights, 55)
    except (FormatError, PoseError) as error:
        raise FormatError(f"{path}: {error}") from None
    meta: dict[str, Any] = {"source": f"LHM, {Path(path).name}", "body_model": "SMPL-X (55 joints)"}
    meta["licence"] = "as the picture and LHM's weights (CC BY-NC 4.0) allow"
    return Avatar(splats, skeleton, skin, meta)


def _arrays(path: str | Path) -> dict[str, F64]:
    with naming(path):
        with open_regular(path) as (file, _):
            data = read_arrays(file, "an LHM dump", tuple(_LHM_KEYS))
        try:
            return {key: np.asarray(array, np.float64) for key, array in data.items()}
        except (TypeError, ValueError) as error:
            raise FormatError(f"an LHM dump is an .npz of numbers, but {error}") from None


def _check(data: Mapping[str, F64]) -> int:
    count = len(data["query_points"])
    for key, shape in _LHM_KEYS.items():
        wanted = tuple(count if n == "N" else int(n) for n in shape)
        if data[key].size != int(np.prod(wanted)) or len(data[key]) != wanted[0]:
            raise FormatError(f"{key} needs shape {wanted}, not {data[key].shape}")
        if not np.isfinite(data[key]).all():
            raise FormatError(f"{key} needs finite numbers, found NaN or infinity")
    if data["rgb"].min(initial=0) < -1e-3 or data["rgb"].max(initial=0) > 1 + 1e-3:
        raise FormatError("rgb needs colours in [0, 1] (LHM's use_rgb), not spherical harmonics")
    if data["opacity"].min(initial=0) < 0 or data["opacity"].max(initial=0) > 1 or data["scaling"].min(initial=0) < 0:
        raise FormatError("opacity and scaling need activated values (0 to 1, and above 0), not logits and logarithms")
    return count
