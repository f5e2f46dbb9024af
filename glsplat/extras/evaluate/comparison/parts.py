"""Assign the pixels of a participant's pictures to body parts."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skin import strongest_joint

PARTS = ("face", "head", "hands", "torso", "legs")
"""The face is the front of the head without hair; ``head`` is the rest of it, ``torso`` has the arms."""

_HEAD = ("head", "jaw", "left_eye", "right_eye")
_HANDS = tuple(
    f"{side}_{name}" for side in ("left", "right") for name in ("wrist", "index", "middle", "pinky", "ring", "thumb")
)
_LEGS = tuple(f"{side}_{name}" for side in ("left", "right") for name in ("hip", "knee", "ankle", "foot"))
_HAIR = ("hair",)
_STEP = 40  # levels of 255 between the greys of two parts


def labelled_mesh(mesh: RiggedMesh) -> RiggedMesh:
    """Return the mesh with each triangle in the grey of its part; for a renderer with one sample per pixel."""
    kinds = np.concatenate([_kinds(mesh, part) for part in mesh.parts])
    faces, parts = mesh.faces, []
    for index, name in enumerate(PARTS):
        mine = faces[kinds == index]
        if len(mine):
            grey = np.full((2, 2, 4), 255, np.uint8)
            grey[..., :3] = _STEP * (index + 1)
            parts.append(MeshPart(name, mine, np.zeros((*mine.shape, 2)), grey))
    return RiggedMesh(mesh.vertices, mesh.skeleton, mesh.joints, mesh.weights, tuple(parts))


def labels_of(picture: NDArray[np.uint8]) -> NDArray[np.int8]:
    """Return the part (index into PARTS) [H, W] in a picture [H, W, 4] of a labelled mesh, -1 for none."""
    return np.asarray(np.where(picture[..., 3] > 127, np.rint(picture[..., 0] / _STEP).astype(int) - 1, -1), np.int8)


def regions(labels: NDArray[np.int8], reach: int) -> NDArray[np.int8]:
    """Return labels [H, W] with background pixels within ``reach`` pixels of a part assigned to the nearest one.

    Pixels that an avatar wrongly covers beside the person so count as errors of that part.
    """
    empty = labels < 0
    if empty.all():
        return labels
    away, nearest = cv2.distanceTransformWithLabels(
        empty.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of = np.full(int(nearest.max()) + 1, -1, np.int8)
    of[nearest[~empty]] = labels[~empty]
    return np.where(away <= reach, of[nearest], np.int8(-1))


def _kinds(mesh: RiggedMesh, part: MeshPart) -> NDArray[np.intp]:
    """Return each triangle's index into PARTS [F], by the strongest joint of its first corner."""
    corner = part.faces[:, 0]
    strongest = strongest_joint(mesh.joints, mesh.weights)[corner]
    names = mesh.skeleton.names
    out = np.full(len(corner), PARTS.index("torso"))
    for kind, starts in (("head", _HEAD), ("hands", _HANDS), ("legs", _LEGS)):
        out[np.array([name.startswith(starts) for name in names])[strongest]] = PARTS.index(kind)
    if "head" in names and not part.name.startswith(_HAIR):
        before = mesh.vertices[part.faces].mean(axis=1)[:, 2] > mesh.skeleton.joints[names.index("head"), 2] + _FRONT
        out[(out == PARTS.index("head")) & before] = PARTS.index("face")
    return out


_FRONT = 0.03  # metres in front of the head joint: between ears and face
