"""The open body in another shape, as a textured mesh; splats on its skin."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_body import BETAS, open_body
from glsplat.extras.authoring.faces.moving_face import MovingFace, moving_face
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from glsplat.splats import Splats

EYES = ("left_eye_smplhf", "right_eye_smplhf")


@lru_cache(maxsize=1)
def person() -> RiggedMesh:
    """Somebody tall and heavy, of the parts skin, eyes and mouth, soles not on the floor."""
    body = open_body()
    betas = np.linspace(1.2, -0.7, BETAS)
    vertices, joints = body.shaped(betas)
    ball = np.isin(body.part, [JOINT_NAMES.index(name) for name in EYES])
    kinds = {"skin": body.skin, "eyes": ball & ~body.skin, "mouth": ~ball & ~body.skin}
    white = np.full((2, 2, 4), 255, np.uint8)
    parts = []
    for name, chosen in kinds.items():
        mine = chosen[body.faces[:, 0]]
        parts.append(MeshPart(name, body.faces[mine], body.uv[mine], white))
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), joints)
    return RiggedMesh(vertices, skeleton, body.skin_joints.astype(np.int64), body.skin_weights, tuple(parts))


@lru_cache(maxsize=1)
def face() -> MovingFace:
    """That person's, as those of photographs get it."""
    return moving_face(person())


def avatar_on(mesh: RiggedMesh, count: int = 1500) -> Avatar:
    """Discs of a few millimetres at the middles of triangles of its head and mouth."""
    neck = mesh.skeleton.joints[mesh.skeleton.names.index("neck"), 1]
    above = np.flatnonzero((mesh.vertices[mesh.faces, 1] > neck).all(axis=1))
    corners = mesh.faces[above[np.linspace(0, len(above) - 1, count).astype(int)]]
    means = mesh.vertices[corners].mean(axis=1)
    skin = Skin.create(mesh.joints[corners[:, 0]], mesh.weights[corners[:, 0]], len(mesh.skeleton))
    scales = np.tile([0.004, 0.003, 0.0004], (count, 1))
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    splats = Splats.create(means, quats, scales, np.full(count, 0.9), rgb=np.full((count, 3), 0.6))
    return Avatar(splats, mesh.skeleton, skin)
