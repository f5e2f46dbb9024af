"""Draw what the unseen back of a garment has: seams, hems, a collar's edge, and soft folds at joints.

All are factors of brightness on the cloth's own colour, drawn in the zero pose between the joints of the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.cloth import LEGS, NECK, SLEEVES, TRUNK, Cloth
from glsplat.extras.authoring.paint.inpaint.rows import ROW_M, SAME_COLOUR_DISTANCE
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.skin_tone import likeness
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

# both ends of a fold in metres from a joint, outwards and up; its width in metres; its depth, a logarithm of brightness
_FOLDS = (
    ("shoulder", (-0.02, -0.10), (-0.13, -0.22), 0.024, 0.19),
    ("shoulder", (-0.01, -0.15), (-0.14, -0.31), 0.029, 0.16),
    ("hip", (0.06, 0.21), (-0.06, 0.17), 0.024, 0.16),
    ("hip", (0.08, 0.15), (-0.04, 0.13), 0.027, 0.14),
    ("hip", (0.07, -0.03), (-0.06, -0.09), 0.027, 0.17),
    ("knee", (0.05, 0.05), (-0.05, 0.02), 0.020, 0.17),
    ("knee", (0.05, 0.00), (-0.04, -0.02), 0.020, 0.21),
    ("ankle", (0.05, 0.16), (-0.05, 0.13), 0.020, 0.14),
    ("ankle", (0.05, 0.07), (-0.05, 0.10), 0.020, 0.17),
    ("elbow", (-0.05, 0.05), (-0.02, -0.05), 0.020, 0.16),
    ("elbow", (0.01, 0.05), (0.01, -0.05), 0.020, 0.19),
)
_UNEVEN_M, _UNEVEN_DEPTH = 0.012, (0.6, 1.2)  # differences between left and right folds
# standard deviations in metres and depths of lines: a seam, and the edge and the stitches of a hem
_SEAM, _EDGE, _STITCHES = (0.006, 0.5), (0.009, 0.6), (0.006, 0.2)
_STITCHES_M = 0.026  # from the edge of a hem
_ARMHOLE_M, _ARMPIT_M = 0.015, 0.11  # inside the shoulder joints, and below them; trousers' seam ends below the hips
_MIN_SHIRT_M, _WAIST_M = 0.1, 0.16  # below the armpits, above the hips: highest and lowest hem of a shirt
_MIN_WAIST_CHANGE = 0.03  # of colour, where a shirt of the trousers' colour ends
_BEHIND = -0.1, -0.5  # z of the normals from which on cloth counts as behind
_FULL_LINE = 0.3  # depth of lines that get as many splats as a picture's detail


@dataclass(frozen=True, eq=False)
class Tailoring:
    """Seams, hems and folds of the back; ``tailoring_of`` makes one."""

    mesh: RiggedMesh  # the dressed body
    behind: F64  # [V] from 0, in front, to 1
    cloth: Cloth
    hems: dict[int, F64]  # for each clothed region the places of hems along it, metres
    waist: float  # metres of height, where trousers begin
    trousers: bool

    def worn(self, points: SurfacePoints) -> tuple[F64, F64, F64]:
        """Return [M] from 0, bare skin, to 1, cloth; the places [M, 3] at rest; and [M] the depths of hems there."""
        where, region = points.at(self.mesh.vertices), self.cloth.region(points)
        share, lines = np.zeros((2, len(where)))
        for number, hems in self.hems.items():
            rows, mine = self.cloth.rows[number], np.flatnonzero(region == number)
            assert rows is not None
            along = np.abs(where[mine, 0]) if rows.axis == 0 else where[mine, 1]
            bare = 0 if self.cloth.skin is None else likeness(rows.colour**2, self.cloth.skin[None] ** 2)
            share[mine] = (np.ones(len(rows.colour)) - bare)[rows.index(along)]
            away = np.abs(along[:, None] - hems)
            lines[mine] = (_line(away, *_EDGE) + _line(away - _STITCHES_M, *_STITCHES)).sum(axis=1)
        return share, where, lines

    def at(self, points: SurfacePoints) -> tuple[F64, F64]:
        """Return [M] the factors of the points' brightness, and [M] their detail, from 0, plain, to 1."""
        share, where, lines = self.worn(points)
        share *= points.at(self.behind[:, None])[:, 0]
        x, y, joints = np.abs(where[:, 0]), where[:, 1], self.mesh.skeleton.joints
        shoulder, hip = (joints[JOINT_NAMES.index(f"left_{name}")] for name in ("shoulder", "hip"))
        lines += _line(x - shoulder[0] + _ARMHOLE_M, *_SEAM) * (y > shoulder[1] - _ARMPIT_M)
        lines += _line(x, *_SEAM) * (y < self.waist) * (y > hip[1] - _ARMPIT_M) * self.trousers
        folds, rng = np.zeros(len(y)), np.random.default_rng(0)
        some = np.flatnonzero(share > 0)
        for name, first, last, width, deep in _FOLDS:
            for side, sign in (("left", 1.0), ("right", -1.0)):
                ends = np.array([first, last]) + rng.uniform(-_UNEVEN_M, _UNEVEN_M, (2, 2))
                begin, end = joints[JOINT_NAMES.index(f"{side}_{name}"), :2] + ends * (sign, 1.0)
                folds[some] += _fold(where[some, :2], begin, end, width, deep * rng.uniform(*_UNEVEN_DEPTH))
        return np.exp(share * (folds - lines)), share * (lines / _FULL_LINE).clip(0, 1)


def tailoring_of(mesh: RiggedMesh, cloth: Cloth, trousers: bool) -> Tailoring:
    """Return the seams, hems and folds of the dressed ``mesh``; a body without ``trousers`` wears a skirt."""
    hems: dict[int, F64] = {}
    waist = float(mesh.skeleton.joints[JOINT_NAMES.index("left_hip"), 1])
    for number in (TRUNK, *LEGS, *SLEEVES):
        if (rows := cloth.rows[number]) is not None:
            hems[number] = rows.places[:-1][lengths(np.diff(rows.colour, axis=0)) > SAME_COLOUR_DISTANCE] + ROW_M / 2
    trunk, neck = cloth.rows[TRUNK], cloth.rows[NECK]
    if trunk is not None:
        low = hems[TRUNK][hems[TRUNK] < cloth.armpit - _MIN_SHIRT_M]
        if not len(low) and trousers:  # a shirt of the trousers' colour ends where this changes most, or at the hips
            some = 2 + np.flatnonzero((trunk.places[2:-2] > waist) & (trunk.places[2:-2] < waist + _WAIST_M))
            change = lengths(trunk.colour[some + 2] - trunk.colour[some - 2])
            clear = change.max(initial=0) > _MIN_WAIST_CHANGE
            low = trunk.places[some[[change.argmax()]]] if clear else np.array([waist])
            hems[TRUNK] = np.append(hems[TRUNK], low)
        waist = float(low.min()) if len(low) else waist
        if neck is not None and lengths(neck.colour[:1] - trunk.colour[-1:])[0] > SAME_COLOUR_DISTANCE:
            hems[TRUNK] = np.append(hems[TRUNK][hems[TRUNK] < cloth.armpit], cloth.collar)
    behind = ramp(vertex_normals(mesh.vertices, mesh.faces)[:, 2], *_BEHIND)
    return Tailoring(mesh, behind, cloth, hems, waist, trousers)


def _line(away: F64, width: float, deep: float) -> F64:
    """Return the depths at distances ``away`` from a line, metres."""
    return np.asarray(deep * np.exp(-0.5 * (away / width) ** 2))


def _fold(where: F64, first: F64, last: F64, width: float, deep: float) -> F64:
    """Return [M] logarithms of brightness at places [M, 2] of a fold: light above, dark below, none at its ends."""
    along = last - first
    length = float(np.hypot(*along))
    t = ((where - first) @ along / length**2).clip(0, 1)
    away = (where - first) @ (-along[1], along[0]) / length / width * (-1.0 if along[0] < 0 else 1.0)
    return np.asarray(deep * away * np.exp(0.5 - 0.5 * away**2) * np.sqrt(4 * t * (1 - t)))
