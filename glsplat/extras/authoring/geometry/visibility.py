"""The part of a mesh that cameras can see, in the zero pose and a few others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose

EYES = ("left_eye_smplhf", "right_eye_smplhf")
"""Joints that turn the eyeballs."""
HEAD = ("head", "jaw", *EYES)
"""Joints that move the head's surface."""

_REVEALING = (("jawOpen",), ("jawOpen", "tongueOut"), ("eyeBlinkLeft", "eyeBlinkRight"))
"""Expressions that reveal surface which a still face hides: teeth and tongue, and the lids."""

GAZE_LIDS = {  # degrees about x (down) and y (to the person's left) -> lid expressions
    (-22, 0): ("eyeLookUpLeft", "eyeLookUpRight"),
    (25, 0): ("eyeLookDownLeft", "eyeLookDownRight"),
    (0, 32): ("eyeLookOutLeft", "eyeLookInRight"),
    (0, -32): ("eyeLookInLeft", "eyeLookOutRight"),
}
"""Turns of the eyes in which faces are rendered."""

_CUBE_M = 0.002  # visible points are counted in cubes of this size
_MIN_PIXELS = 3  # over all views, for a cube beneath another part to count as visible


@dataclass(frozen=True, slots=True, eq=False)
class VisiblePart:
    """The part of a mesh that cameras can see."""

    faces: NDArray[np.bool_]  # [F] visible, or next to a visible one
    points: F64  # [H, 3] visible points in the zero pose, one for each cube of 2 mm and mesh part
    parts: NDArray[np.intp]  # [H] their mesh part
    hits: NDArray[np.intp]  # [H] pixels, over all views, that show this cube

    def is_visible(self, points: F64, normals: F64, parts: NDArray[np.intp], reach: float) -> NDArray[np.bool_]:
        """Return True [M] for surface points with a visible point of the same part within ``reach`` metres.

        Where another part lies closely above (skin under a hem), single pixels seen up a sleeve do not count.
        """
        out = np.zeros(len(points), bool)
        for part in np.unique(parts):
            mine = np.flatnonzero(parts == part)
            own = self.parts == part
            if not own.any():
                continue
            seen = _within(self.points[own], points[mine], reach)
            well = _within(self.points[own & (self.hits >= _MIN_PIXELS)], points[mine], reach)
            above = np.zeros(len(mine), bool)
            others = self.points[self.parts != part]
            if len(others):
                distance, index = cKDTree(others).query(points[mine], distance_upper_bound=2 * reach, workers=-1)
                close = np.flatnonzero(np.isfinite(distance))
                away = others[index[close]] - points[mine[close]]
                above[close] = np.einsum("ij,ij->i", away, normals[mine[close]]) > 0.5 * distance[close]
            out[mine] = np.where(above, well, seen)
        return out


def visible_surface(mesh: RiggedMesh, size: int = 512) -> VisiblePart:
    """Return the triangles and surface points that are visible in any of the views and poses.

    ``size``: pixels a side of each view.
    """
    seen = np.zeros(len(mesh.faces), bool)
    keys: list[NDArray[np.int64]] = []
    counts: list[NDArray[np.intp]] = []
    corners, part_of = mesh.vertices[mesh.faces], mesh.face_parts
    low = mesh.vertices.min(axis=0) - 1
    poses = probe_poses(mesh.skeleton.names)
    faces = _gaze_poses(mesh)
    if mesh.morphs is not None:
        still = np.zeros((len(mesh.skeleton), 3))
        faces += [Pose(still, expression=dict.fromkeys(names, 1.0)) for names in _REVEALING]
    used = np.unique(mesh.faces)
    head = used[np.isin(mesh.joints[used, 0], [i for i, name in enumerate(mesh.skeleton.names) if name in HEAD])]
    for number, pose in enumerate(poses + faces):
        vertices = mesh.posed(pose)
        spheres = [(vertices[used], 20)] if number < len(poses) and len(head) < len(used) else []
        if len(head):
            spheres.append((vertices[head], 12))
        for points, views in spheres:
            centre, radius = sphere_around(points)
            for direction in sphere(views):
                viewmat = look_at(centre + direction * 4 * radius, centre)
                camera = Camera(viewmat, pinhole(size, size, 29.0), size, size, near=1e-3)
                ids, bary = visible_faces(mesh, vertices, camera)
                hit = ids >= 0
                seen[ids[hit]] = True
                at = np.einsum("nk,nkc->nc", bary[hit], corners[ids[hit]])
                cube = np.clip(np.rint((at - low) / _CUBE_M), 0, 2**18 - 1).astype(np.int64)
                packed = ((part_of[ids[hit]] << 54) | (cube[:, 0] << 36) | (cube[:, 1] << 18)) | cube[:, 2]
                key, count = np.unique(packed, return_counts=True)
                keys.append(key)
                counts.append(count)
    touched = np.zeros(len(mesh.vertices), bool)
    touched[mesh.faces[seen]] = True
    key, first = np.unique(np.concatenate(keys), return_inverse=True)
    hits = np.bincount(first, np.concatenate(counts), minlength=len(key)).astype(np.intp)
    cube = np.stack([key >> 36, key >> 18, key], axis=1) & (2**18 - 1)
    return VisiblePart(seen | touched[mesh.faces].any(axis=1), cube * _CUBE_M + low, (key >> 54).astype(np.intp), hits)


def _within(theirs: F64, ours: F64, reach: float) -> NDArray[np.bool_]:
    if not len(theirs):
        return np.zeros(len(ours), bool)
    return np.isfinite(cKDTree(theirs).query(ours, distance_upper_bound=reach, workers=-1)[0])


def probe_poses(names: tuple[str, ...]) -> list[Pose]:
    """Return the zero pose and, on rigs with these joints, two poses that open cuffs, armpits, knees and mouth."""
    index = {name: i for i, name in enumerate(names)}
    poses = [Pose.zero(len(names))]
    if all(name in index for name in ("left_shoulder", "right_shoulder", "left_hip", "left_knee", "left_wrist")):
        for bend in (0.5, -0.5):
            rotations = np.zeros((len(names), 3))
            for side, sign in (("left", 1.0), ("right", -1.0)):
                rotations[index[f"{side}_shoulder"]] = (0, 0, -sign * 2 * bend)
                rotations[index[f"{side}_wrist"]] = (0, 0, -sign * bend)
                rotations[index[f"{side}_hip"]] = (-sign * bend, 0, sign * 0.3)
                rotations[index[f"{side}_knee"]] = (0.6, 0, 0)
                rotations[index[f"{side}_ankle"]] = (bend, 0, 0)
            if "jaw" in index:
                rotations[index["jaw"]] = (0.3, 0, 0)
            poses.append(Pose(rotations))
    return poses


def _gaze_poses(mesh: RiggedMesh) -> list[Pose]:
    """Return poses with eyes and lids turned to the sides, up and down, which reveal more of the whites."""
    names, moved = mesh.skeleton.names, np.unique(mesh.joints[np.unique(mesh.faces), 0])
    eyes = [names.index(name) for name in EYES if name in names and names.index(name) in moved]
    out = []
    for turn, lids in GAZE_LIDS.items() if eyes else ():
        rotations = np.zeros((len(names), 3))
        rotations[eyes] = np.radians((*turn, 0))
        out.append(Pose(rotations, expression=dict.fromkeys(lids, 1.0) if mesh.morphs else None))
    return out


def sphere(count: int) -> F64:
    """Return [count, 3] unit directions spread evenly over the sphere (Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    y, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(turn), y, r * np.sin(turn)], axis=1)


def sphere_around(points: F64) -> tuple[F64, float]:
    """Return the centre [3] of the box around ``points`` [N, 3] and their largest distance from it, at least 1e-6."""
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    return centre, max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-6)
