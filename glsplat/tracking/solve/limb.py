"""Two-bone limbs (arm, leg): place the end exactly, bend like a hinge towards a pole."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sqrt

from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.quat import Quat, Vec, clamp, mul, unit


@dataclass(frozen=True, slots=True)
class Limb:
    """Rest measures of root - middle - end; ``frame`` has the upper bone as x and the hinge axis as y."""

    upper: float  # metres
    lower: float
    nearest: float  # distance root to end at the joint limit of the hinge
    farthest: float
    lower_dir: Vec  # rest direction of the lower bone
    frame: Quat  # conj of the rest frame (upper bone, hinge axis)

    @classmethod
    def of(cls, body: Body, joints: tuple[int, int, int], hinge: Vec, flexion: float, reach: float = 0.99995) -> Limb:
        """Measure a limb. ``hinge``: rest axis about which the lower bone flexes by at most ``flexion`` degrees."""
        a, b, c = joints
        upper, lower = body.distance(a, b), body.distance(b, c)
        along = body.direction(a, b)
        axis = perpendicular(hinge, along)
        nearest = sqrt(upper**2 + lower**2 + 2 * upper * lower * cos(radians(flexion)))
        frame = quat.conj(quat.from_axes(along, axis, quat.cross(along, axis)))
        return cls(upper, lower, nearest, (upper + lower) * reach, body.direction(b, c), frame)


def perpendicular(v: Vec, axis: Vec) -> Vec:
    """Return the unit vector of the part of v perpendicular to the unit vector ``axis``."""
    s = quat.dot(v, axis)
    return unit((v[0] - s * axis[0], v[1] - s * axis[1], v[2] - s * axis[2]), (0.0, 0.0, 1.0))


def two_bone(limb: Limb, root: Vec, end: Vec, pole: Vec) -> tuple[Quat, Quat, Vec]:
    """Return world rotation of the upper bone, local rotation of the hinge, world direction of the lower bone.

    ``pole``: unit vector towards which the middle joint bends; it need not be perpendicular to the limb. The distance
    is clamped to what the limb reaches, so a target out of reach gives a straight limb that points at it.
    """
    dx, dy, dz = end[0] - root[0], end[1] - root[1], end[2] - root[2]
    far = sqrt(dx * dx + dy * dy + dz * dz)
    if far < 1e-9:
        ux, uy, uz, far = 0.0, -1.0, 0.0, 1e-9
    else:
        ux, uy, uz = dx / far, dy / far, dz / far
    reach = clamp(far, limb.nearest, limb.farthest)
    s = pole[0] * ux + pole[1] * uy + pole[2] * uz
    px, py, pz = unit((pole[0] - s * ux, pole[1] - s * uy, pole[2] - s * uz), (0.0, 0.0, 1.0))
    along = (limb.upper * limb.upper - limb.lower * limb.lower + reach * reach) / (2 * reach)
    side = sqrt(max(limb.upper * limb.upper - along * along, 0.0))
    a, b = along / limb.upper, side / limb.upper
    c, d = (reach - along) / limb.lower, -side / limb.lower
    upper_dir = (ux * a + px * b, uy * a + py * b, uz * a + pz * b)
    lower_dir = (ux * c + px * d, uy * c + py * d, uz * c + pz * d)
    hinge = (py * uz - pz * uy, pz * ux - px * uz, px * uy - py * ux)  # pole x limb: the lower bone turns about it
    world = mul(quat.from_axes(upper_dir, hinge, quat.cross(upper_dir, hinge)), limb.frame)
    bend = quat.between(limb.lower_dir, quat.rotate(quat.conj(world), lower_dir))
    return world, bend, lower_dir
