"""Draw what the unseen back of a garment has: seams, hems, a collar's edge, and the front's weave and wrinkles.

All are factors of brightness on the cloth's own colour, drawn in the zero pose between the joints of the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.cloth import LEGS, NECK, SLEEVES, TRUNK, Cloth
from glsplat.extras.authoring.paint.inpaint.rows import ROW_M, SAME_COLOUR_DISTANCE, Rows
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.skin_tone import likeness
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

# standard deviations in metres and depths of lines: a seam, and the edge and the stitches of a hem
_SEAM, _EDGE, _STITCHES = (0.006, 0.3), (0.009, 0.6), (0.006, 0.2)
_LEGS_SHADE = 0.02, 0.7  # the same, of the shade on cloth where a leg meets the other one
_STITCHES_M = 0.026  # from the edge of a hem
_ARMHOLE_M, _ARMPIT_M = 0.015, 0.11  # inside the shoulder joints, and below them; trousers' seam ends below the hips
_MIN_SHIRT_M, _WAIST_M = 0.1, 0.18  # below the armpits, above the hips: highest and lowest hem of a shirt
_MIN_WAIST_LINE, _MIN_WAIST_CHANGE = 0.025, 0.03  # square roots of light: a belt's darkness; a change of colour
_BEHIND = -0.1, -0.5  # z of the normals from which on cloth counts as behind
_FULL_LINE = 0.3  # depth of lines and wrinkles that get as many splats as a picture's detail


@dataclass(frozen=True, eq=False)
class Tailoring:
    """Seams, hems and wrinkles of the back; ``tailoring_of`` makes one."""

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

    def at(self, points: SurfacePoints, relief: F64) -> tuple[F64, F64]:
        """Return [M] the factors of the points' brightness, and [M] their detail, from 0, plain, to 1.

        ``relief`` [M] is the ``relief_of`` the front at the same place, as a logarithm of brightness.
        """
        region, (share, where, lines) = self.cloth.region(points), self.worn(points)
        share *= points.at(self.behind[:, None])[:, 0]
        x, y, joints = np.abs(where[:, 0]), where[:, 1], self.mesh.skeleton.joints
        shoulder, hip = (joints[JOINT_NAMES.index(f"left_{name}")] for name in ("shoulder", "hip"))
        lines += _line(x - shoulder[0] + _ARMHOLE_M, *_SEAM) * (y > shoulder[1] - _ARMPIT_M)
        lines += _line(x, *_SEAM) * (y < self.waist) * (y > hip[1] - _ARMPIT_M) * self.trousers
        # metres from the plane between the legs; wide legs of shorts reach beyond it
        outside = np.select([region == number for number in LEGS], [where[:, 0], -where[:, 0]], np.inf).clip(0)
        lines += _line(outside, *_LEGS_SHADE) * self.trousers
        return np.exp(share * (relief - lines)), share * ((lines + np.abs(relief)) / _FULL_LINE).clip(0, 1)


def tailoring_of(mesh: RiggedMesh, cloth: Cloth, trousers: bool) -> Tailoring:
    """Return the seams, hems and wrinkles of the dressed ``mesh``; a body without ``trousers`` wears a skirt."""
    hems: dict[int, F64] = {}
    waist = float(mesh.skeleton.joints[JOINT_NAMES.index("left_hip"), 1])
    for number in (TRUNK, *LEGS, *SLEEVES):
        if (rows := cloth.rows[number]) is not None:
            hems[number] = rows.places[:-1][lengths(np.diff(rows.colour, axis=0)) > SAME_COLOUR_DISTANCE] + ROW_M / 2
    trunk, neck = cloth.rows[TRUNK], cloth.rows[NECK]
    if trunk is not None:
        low = hems[TRUNK][hems[TRUNK] < cloth.armpit - _MIN_SHIRT_M]
        if not len(low) and trousers:
            low = np.array([_waist(trunk, cloth.lines, waist)])
            hems[TRUNK] = np.append(hems[TRUNK], low)
        waist = float(low.min()) if len(low) else waist
        if neck is not None and lengths(neck.colour[:1] - trunk.colour[-1:])[0] > SAME_COLOUR_DISTANCE:
            hems[TRUNK] = np.append(hems[TRUNK][hems[TRUNK] < cloth.armpit], cloth.collar)
    behind = ramp(vertex_normals(mesh.vertices, mesh.faces)[:, 2], *_BEHIND)
    return Tailoring(mesh, behind, cloth, hems, waist, trousers)


def _waist(trunk: Rows, lines: F64, hips: float) -> float:
    """Return the height in metres where a shirt of the trousers' colour ends: at a belt or hem, or at the ``hips``."""
    some = 2 + np.flatnonzero((trunk.places[2:-2] > hips) & (trunk.places[2:-2] < hips + _WAIST_M))
    change = lengths(trunk.colour[some + 2] - trunk.colour[some - 2])
    for value, least in ((lines[some], _MIN_WAIST_LINE), (change, _MIN_WAIST_CHANGE)):
        if value.max(initial=0) > least:
            return float(trunk.places[some[value.argmax()]])
    return hips


def _line(away: F64, width: float, deep: float) -> F64:
    """Return the depths at distances ``away`` from a line, metres."""
    return np.asarray(deep * np.exp(-0.5 * (away / width) ** 2))
