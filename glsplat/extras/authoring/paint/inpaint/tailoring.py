"""Draw what the unseen back of a garment has: seams, hems, a collar's edge, and soft folds at joints.

All are factors of brightness on the cloth's own colour, drawn in the zero pose between the joints of the body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.cloth import LEGS, NECK, SLEEVES, TRUNK, Cloth
from glsplat.extras.authoring.paint.inpaint.rows import ROW_M, SAME_COLOUR_DISTANCE
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.skin_tone import likeness
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

# metres from a joint outwards and up, of both ends of a fold; its width in metres; its depth, a logarithm of brightness
_FOLDS = (
    ("shoulder", (-0.02, -0.10), (-0.13, -0.22), 0.024, 0.25),
    ("shoulder", (-0.01, -0.15), (-0.14, -0.31), 0.029, 0.21),
    ("shoulder", (-0.05, -0.01), (-0.09, -0.17), 0.051, 0.11),
    ("hip", (0.06, 0.21), (-0.06, 0.17), 0.024, 0.21),
    ("hip", (0.08, 0.15), (-0.04, 0.13), 0.027, 0.18),
    ("hip", (0.07, -0.03), (-0.06, -0.09), 0.027, 0.23),
    ("hip", (0.06, -0.08), (-0.05, -0.13), 0.024, 0.16),
    ("knee", (0.05, 0.05), (-0.05, 0.02), 0.020, 0.23),
    ("knee", (0.05, 0.00), (-0.04, -0.02), 0.020, 0.28),
    ("knee", (0.04, -0.06), (-0.05, -0.04), 0.020, 0.21),
    ("ankle", (0.05, 0.16), (-0.05, 0.13), 0.020, 0.18),
    ("ankle", (0.05, 0.07), (-0.05, 0.10), 0.020, 0.23),
    ("elbow", (-0.05, 0.05), (-0.02, -0.05), 0.020, 0.21),
    ("elbow", (0.01, 0.05), (0.01, -0.05), 0.020, 0.25),
    ("elbow", (0.07, 0.05), (0.05, -0.05), 0.020, 0.21),
)
_POCKET = (0.045, 0.035), (-0.035, 0.045)  # from the hip, as above
_UNEVEN_M, _UNEVEN_DEPTH = 0.012, (0.6, 1.2)  # differences between left and right folds
# standard deviations in metres and depths of lines: a seam, and the edge and the stitches of a hem
_SEAM, _EDGE, _STITCHES = (0.006, 0.5), (0.009, 0.6), (0.006, 0.2)
_STITCHES_M = 0.026  # from the edge of a hem
_ARMHOLE_M, _ARMPIT_M = 0.015, 0.11  # inside the shoulder joint, and below it
_WAIST_M, _MIN_WAIST_CHANGE = (0.0, 0.16), 0.03  # above the hips: where shirts of the trousers' colour end
_MIN_SHIRT_M = 0.1  # below the armpits
_BEHIND = -0.1, -0.5  # z of the normals from which on cloth counts as behind
_FULL_LINE = 0.3  # depth of lines that get as many splats as a picture's detail


@dataclass(frozen=True, eq=False)
class Tailoring:
    """Seams, hems and folds of the back; ``tailoring_of`` makes one."""

    rest: F64  # [V, 3] the dressed surface in the zero pose
    behind: F64  # [V] from 0, in front, to 1
    joints: F64  # [55, 3]
    cloth: Cloth
    worn: tuple[F64, ...]  # for each region [R] from 0, bare skin, to 1, cloth
    hems: tuple[F64, ...]  # for each region [H] places of hems along it, metres
    waist: float  # metres of height, where trousers begin
    trousers: bool

    def at(self, points: SurfacePoints) -> tuple[F64, F64]:
        """Return [M] the factors of the points' brightness, and [M] their detail, from 0, plain, to 1."""
        values, region = points.at(np.column_stack([self.rest, self.behind])), self.cloth.region(points)
        depth, lines = np.zeros(len(values)), np.zeros(len(values))
        some = np.flatnonzero((values[:, 3] > 0) & (region >= 0))
        where, region = values[some, :3], region[some]
        worn = np.zeros(len(some))
        for number, rows in enumerate(self.cloth.rows):
            mine = np.flatnonzero(region == number)
            if rows is None or not len(self.worn[number]) or not len(mine):
                continue
            along = np.abs(where[mine, 0]) if rows.axis == 0 else where[mine, 1]
            worn[mine] = self.worn[number][rows.index(along)]
            for hem in self.hems[number]:
                lines[some[mine]] += _line(along - hem, *_EDGE) + _line(np.abs(along - hem) - _STITCHES_M, *_STITCHES)
        lines[some] += sum(_line(*one) for one in self._seams(where))
        for first, last, width, deep in self._folds():
            depth[some] += _fold(where[:, :2], first, last, width, deep)
        share = np.zeros(len(values))
        share[some] = worn * values[some, 3]
        return np.exp(share * (depth - lines)), share * (lines / _FULL_LINE).clip(0, 1)

    def covers(self, points: SurfacePoints) -> F64:
        """Return [M] from 0 to 1: how surely the points are cloth below the waist."""
        height, region, out = points.at(self.rest)[:, 1], self.cloth.region(points), np.zeros(len(points.corners))
        for number in (TRUNK, *LEGS):
            rows, mine = self.cloth.rows[number], np.flatnonzero((region == number) & (height < self.waist))
            if rows is not None:
                out[mine] = self.worn[number][rows.index(height[mine])]
        return out

    def _seams(self, where: F64) -> Iterator[tuple[F64, float, float]]:
        """Yield distances [M] from each seam, metres, infinite beyond its ends, its width and its depth."""
        x, y = np.abs(where[:, 0]), where[:, 1]
        out, up = np.abs(self._joint("shoulder")[0]), self._joint("shoulder")[1]
        yield np.where(y > up - _ARMPIT_M, x - out + _ARMHOLE_M, np.inf), *_SEAM
        if self.trousers:
            below = y < self.waist
            yield np.where(below & (y > self._joint("hip")[1] - _ARMPIT_M), x, np.inf), *_SEAM
            hip = self._joint("hip")
            inside = (x > hip[0] + _POCKET[1][0]) & (x < hip[0] + _POCKET[0][0])
            tilt = (_POCKET[0][1] - _POCKET[1][1]) / (_POCKET[0][0] - _POCKET[1][0])
            yield np.where(below & inside, y - hip[1] - _POCKET[0][1] - tilt * (x - hip[0] - _POCKET[0][0]), np.inf), *_SEAM

    def _folds(self) -> Iterator[tuple[F64, F64, float, float]]:
        """Yield both ends of each fold [2], its width in metres, and its depth."""
        rng = np.random.default_rng(0)
        for name, first, last, width, deep in _FOLDS:
            for side, sign in (("left", 1.0), ("right", -1.0)):
                joint = self.joints[JOINT_NAMES.index(f"{side}_{name}"), :2]
                ends = np.array([first, last]) + rng.uniform(-_UNEVEN_M, _UNEVEN_M, (2, 2))
                yield *(joint + ends * (sign, 1.0)), width, deep * rng.uniform(*_UNEVEN_DEPTH)

    def _joint(self, name: str) -> F64:
        return self.joints[JOINT_NAMES.index(f"left_{name}")]


def tailoring_of(mesh: RiggedMesh, cloth: Cloth, trousers: bool) -> Tailoring:
    """Return the seams, hems and folds of the dressed ``mesh``; a body without ``trousers`` wears a skirt."""
    worn: list[F64] = []
    hems: list[F64] = []
    for number, rows in enumerate(cloth.rows):
        if rows is None or number not in (TRUNK, *LEGS, *SLEEVES):
            worn.append(np.zeros(0))
            hems.append(np.zeros(0))
            continue
        skin = None if cloth.skin is None else cloth.skin**2
        worn.append(np.ones(len(rows.colour)) if skin is None else 1 - likeness(rows.colour**2, skin[None]))
        step = np.linalg.norm(np.diff(rows.colour, axis=0), axis=1)
        hems.append(rows.places[:-1][step > SAME_COLOUR_DISTANCE] + ROW_M / 2)
    trunk, hip = cloth.rows[TRUNK], mesh.skeleton.joints[JOINT_NAMES.index("left_hip"), 1]
    waist = float(hip)
    if trunk is not None:
        low = hems[TRUNK][hems[TRUNK] < cloth.armpit - _MIN_SHIRT_M]
        if not len(low) and trousers:
            low = hems[TRUNK] = np.append(hems[TRUNK], _hidden_hem(trunk.places, trunk.colour, float(hip)))
        waist = float(low.min()) if len(low) else waist
        top, neck = trunk.colour[-1], cloth.rows[NECK]
        if neck is not None and np.linalg.norm(neck.colour[0] - top) > SAME_COLOUR_DISTANCE:
            hems[TRUNK] = np.append(hems[TRUNK][hems[TRUNK] < cloth.armpit], cloth.collar)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    behind = ramp(normals[:, 2], *_BEHIND)
    return Tailoring(
        mesh.vertices, behind, mesh.skeleton.joints, cloth, tuple(worn), tuple(hems), waist, trousers
    )


def _hidden_hem(places: F64, colour: F64, hip: float) -> float:
    """Return the height of a shirt's hem over trousers of its colour: where rows [R] change most, or the hips."""
    some = np.flatnonzero((places > hip + _WAIST_M[0]) & (places < hip + _WAIST_M[1]))
    some = some[(some > 1) & (some < len(places) - 2)]
    if not len(some):
        return hip
    change = np.linalg.norm(colour[some + 2] - colour[some - 2], axis=1)
    return float(places[some[change.argmax()]]) if change.max() > _MIN_WAIST_CHANGE else hip


def _line(away: F64, width: float, deep: float) -> F64:
    """Return the depth [M] at distances ``away`` [M] from a line, metres."""
    return np.asarray(deep * np.exp(-0.5 * (away / width) ** 2))


def _fold(where: F64, first: F64, last: F64, width: float, deep: float) -> F64:
    """Return [M] logarithms of brightness at places [M, 2] of a fold: light above, dark below, none at its ends."""
    along = last - first
    length = float(np.hypot(*along))
    t = ((where - first) @ along / length**2).clip(0, 1)
    away = ((where - first) @ (-along[1], along[0])) / length * (-1.0 if along[0] < 0 else 1.0)
    shape = away / width
    return np.asarray(deep * shape * np.exp(0.5 - 0.5 * shape**2) * np.sqrt(4 * t * (1 - t)))
