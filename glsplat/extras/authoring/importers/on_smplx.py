"""Retarget an avatar of another rig to the 55 joints of SMPL-X, so that motions and tracking drive it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, PoseError
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.rigs.humanoid import seated
from glsplat.extras.rigs.match import match_rig
from glsplat.formats.transform import transformed
from glsplat.rotations import nearest_rotations
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS


def on_smplx(avatar: Avatar, rig_map: Mapping[str, str | None] | None = None) -> Avatar:
    """Return the avatar in SMPL-X's T-pose, y up, facing +z, its splats bound to the matching SMPL-X joints.

    As ``avatar make`` does for a mesh: ``rig_map`` (SMPL-X joint -> name of a joint here, or None) overrides names and
    positions. The splats are posed once from the bind pose, in float64. Raises FormatError, one line, for a rig
    without a joint that driving needs.
    """
    skeleton = avatar.skeleton
    if skeleton.names == JOINT_NAMES:
        raise FormatError("this avatar has the 55 joints of SMPL-X already")
    mapped: dict[str, int | None] = {}
    for joint, name in (rig_map or {}).items():
        if name is not None and name not in skeleton.names:
            raise FormatError(f'the rig map gives {joint} a joint "{name:.40}", which this avatar does not have')
        mapped[joint] = None if name is None else skeleton.names.index(name)
    try:
        with np.errstate(all="ignore"):
            return _on_smplx(avatar, mapped)
    except (PoseError, np.linalg.LinAlgError) as error:
        raise FormatError(f"this avatar cannot be put onto SMPL-X's joints: {error}") from None


def _on_smplx(avatar: Avatar, mapped: Mapping[str, int | None]) -> Avatar:
    skeleton = avatar.skeleton
    bound = np.linalg.inv(skeleton.inverse_bind).astype(np.float64)
    found = match_rig(skeleton.names, skeleton.parents, bound[:, :3, 3], mapped)
    if found.missing:
        raise PoseError(f"no joint for {', '.join(found.missing)}; name them in a --rig-map")
    turn, as_bound, of = seated(found, skeleton.parents, bound, skeleton.rest, open_body().joints)
    skin = _merge_slots(of[avatar.skin.joints], avatar.skin)
    first = Avatar(transformed(avatar.splats, turn), as_bound, skin)
    splats, shapes = posed_splats(first, Pose.zero()), avatar.shapes
    if shapes is not None:
        bones = Pose.zero().bones(as_bound)
        linear = np.einsum("nk,nkij->nij", skin.weights.astype(np.float64), bones[skin.joints, :, :3]) @ turn[:3, :3]
        shapes = shapes.turned(linear, nearest_rotations(linear))
    rig = {joint: skeleton.names[index] for joint, index in found.joints.items()}
    meta = {**avatar.meta, "body_model": "SMPL-X joints (55)", "rig": rig}
    return Avatar(splats, Skeleton(JOINT_NAMES, PARENTS, as_bound.rest), skin, meta, shapes=shapes)


def _merge_slots(joints: NDArray[np.integer], skin: Skin) -> Skin:
    """Return the skin with these joints [N, K]; slots of a splat with the same joint are merged."""
    weights = skin.weights.astype(np.float64)
    for later in range(1, joints.shape[1]):
        for earlier in range(later):
            same = joints[:, earlier] == joints[:, later]
            weights[same, earlier] += weights[same, later]
            weights[same, later] = 0
    return Skin.create(joints, weights, len(JOINT_NAMES), skin.influences)
