"""The colours of a dressed body's surface from the pictures of it, the unseen sides included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import half_width, trunk_of, twins_across
from glsplat.extras.authoring.compute.threads import abreast, aside
from glsplat.extras.authoring.fit.eyes import EyeLook
from glsplat.extras.authoring.fit.offsets import face_of
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.front_to_back_transfer import Front, Twins, find_twins
from glsplat.extras.authoring.paint.head import BackOfHead, back_of_head
from glsplat.extras.authoring.paint.inpaint.cloth import Cloth, cloth_of
from glsplat.extras.authoring.paint.inpaint.material import Ground
from glsplat.extras.authoring.paint.inpaint.sleeves import cut_sleeves
from glsplat.extras.authoring.paint.lamp import Lamp, find_light
from glsplat.extras.authoring.paint.mouth_and_eyes import Inside, inside_of
from glsplat.extras.authoring.paint.smooth import smoothest
from glsplat.extras.authoring.paint.view_sample import FittedPicture, Sight
from glsplat.pictures import to_srgb
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Paint", "Painter", "paint", "painter_of"]

F64 = NDArray[np.float64]

_NO_TWINS = ("neck", "head", "jaw", "left_eye_smplhf", "right_eye_smplhf")  # faces and chins have no counterpart
_GUESSED = 0.6  # of the splats that detail is worth, where it is a guess
_DIGITS = 6  # of a colour; see optimize/colour_fit.py
_BLOCK = 1 << 15  # points that one core paints together
_LENT = 0.003  # what one half of the body says of the other, where nobody looks
_FORGETS = 3e-4  # how soon cloth that nobody looks at is as it is elsewhere at that height
_ASIDE = 0.35, 0.6  # of the trunk's half width: nearer to its middle than that nothing is mirrored, for signs are there
_SHADE = 0.3, 1.4  # brightness of an unseen point against the seen one its colour comes from


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """What is known and guessed of M points."""

    rgb: F64  # [M, 3] sRGB in [0, 1]
    seen: F64  # [M] from 0, guessed, to 1, seen
    busy: F64  # [M] from 0, plain, to 1, full of detail


@dataclass(frozen=True, eq=False)
class Painter:
    """Gives the colours of any points of a dressed body; ``painter_of`` makes one."""

    body: Body
    shots: Sequence[FittedPicture]  # the front first
    inside: Inside
    light: Lamp
    cloth: Cloth
    plain: F64  # [V, 3] smooth linear colours without light; where there is cloth, what is added to it
    twins: Twins
    head: BackOfHead
    sleeves: SurfacePoints | None  # [V] where the trunk shows the cloth of an arm's vertex; None where it is plain
    aside: F64  # [V] how much the other half of the body says of a vertex that is not seen

    def paint(self, points: SurfacePoints) -> Paint:
        """What is known and guessed of the points; what is seen squarely is not guessed."""
        starts = range(0, max(len(points.corners), 1), _BLOCK)
        blocks = [points.take(slice(first, first + _BLOCK)) for first in starts]
        parts = abreast(self._painted, blocks)
        return Paint(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def _painted(self, points: SurfacePoints) -> tuple[F64, F64, F64]:
        """As ``Paint`` has it, of points that are looked at together."""
        sights, ground, shade = self._looked(points)
        seen, colour = _mixed(sights)
        busy = np.max([sight.busy * sight.trust for sight in sights], axis=0)
        doubt = np.flatnonzero(seen < 1)
        part = points.take(doubt)
        guess, there = self._guess(part, ground.at(doubt), shade[doubt])
        busy[doubt] = np.maximum(busy[doubt], _GUESSED * there * (1 - seen[doubt]))
        colour[doubt] = guess + seen[doubt, None] * (colour[doubt] - guess)
        rgb = self.inside.over(to_srgb(colour), points)
        return np.round(rgb, _DIGITS), seen, np.round(busy, _DIGITS)

    def colours(self, points: SurfacePoints) -> F64:
        """``paint(points).rgb``, on one core."""
        return self._painted(points)[0]

    def _looked(self, points: SurfacePoints) -> tuple[list[Sight], Ground, F64]:
        """What each picture shows, the front without what is not the body's; the cloth there, and the light [M]."""
        sights = [shot.look(points) for shot in self.shots]
        shade = self.light.shade(points.directions(self.shots[0].normals))
        ground, first = self.cloth.at(points), sights[0]
        strange = self.cloth.strange(self.shots[0], points, first.linear, shade, ground)
        sights[0] = replace(first, trust=first.trust * (1 - strange))
        return sights, ground, shade

    def _guess(self, points: SurfacePoints, ground: Ground, shade: F64) -> tuple[F64, F64]:
        """[M, 3] linear colours where nobody looks, and [M] how much detail they have."""
        body, front = self.body, self.shots[0]
        # the front at the same place, for all but the head, where it is the same cloth
        behind = self.twins.colours(front, points, ground.pattern)
        lit = self.light.shade(behind.normals)
        ratio = (shade / lit).clip(*_SHADE)
        round_parts = np.isin(body.part, [JOINT_NAMES.index(name) for name in _NO_TWINS])
        trust = behind.trust * (1 - points.at(round_parts.astype(float)[:, None])[:, 0])
        trust = trust * ground.alike(behind.linear / lit[:, None])
        # what was continued into a hole is worth less than the cloth, unless that has a pattern
        arms = self.cloth.sleeves(points)
        trust = np.where((ground.there > 0) & (~ground.pattern | arms), trust * behind.known, trust)
        covered, colour = self.head.at(points)
        # side by side, not one over the other: where neck and back meet, no third colour shows between them
        rest = 1 - trust - covered
        plain = np.maximum(points.at(self.plain) + ground.there[:, None] * ground.colour, 0)
        guess = (rest[:, None] * plain + covered[:, None] * colour) * shade[:, None]
        guess += (trust * ratio)[:, None] * behind.linear
        # what one half of the body hides, the other one shows
        across = SurfacePoints(twins_across()[points.corners], points.weights)
        other = front.look(across)
        lit = self.light.shade(across.directions(front.normals))
        lent = other.trust * points.at(self.aside[:, None])[:, 0] * ground.alike(other.linear / lit[:, None])
        guess += lent[:, None] * ((shade / lit).clip(*_SHADE)[:, None] * other.linear - guess)
        if self.sleeves is not None:
            some = np.flatnonzero(arms & ground.pattern)
            guess[some] += ((1 - trust) * (1 - lent))[some, None] * (self._cut(points, some, shade) - guess[some])
        return guess, np.maximum.reduce([behind.busy * trust, other.busy * lent, covered * self.head.lively])

    def _cut(self, points: SurfacePoints, some: NDArray[np.intp], shade: F64) -> F64:
        """[K, 3] linear colours of ``some`` points of sleeves, as the trunk's cloth has them."""
        assert self.sleeves is not None
        front, part = self.shots[0], points.take(some)
        lit = self.light.shade(part.directions(self.sleeves.directions(front.normals)))
        cloth = front.sample(part.at(self.sleeves.at(front.view.pixels)))
        return np.asarray((shade[some] / lit).clip(*_SHADE)[:, None] * cloth)


def painter_of(
    body: Body, shots: Sequence[FittedPicture], points: SurfacePoints, looks: Mapping[str, EyeLook] | None = None
) -> Painter:
    """A painter of the body in ``shots``, the front first; ``looks`` are the eyes in it.

    Light and cloth are found on ``points``, which should lie evenly over the surface.
    """
    front = shots[0]
    seen_from_afar = aside(lambda: Front(front.mesh))
    sight = front.look(points)
    normals, up = points.directions(front.normals), front.view.root[:, 1]
    light = find_light(normals, sight.linear, sight.trust, up, np.array([0.0, 0, -1]))
    cloth = cloth_of(body, front, points, sight, light.shade(normals))
    head = aside(lambda: back_of_head(body, front, light, cloth.nape))
    plain, seen = _smooth_colours(body, shots, light, cloth), seen_from_afar()
    twins, span = find_twins(front.mesh, trunk_of(body), seen), cloth.patterned
    sleeves = None if span is None else cut_sleeves(front.mesh, seen, span)
    inside = inside_of(body, front, looks or {})
    return Painter(body, shots, inside, light, cloth, plain, twins, head(), sleeves, _aside(body, front))


def _aside(body: Body, shot: FittedPicture) -> F64:
    """[V] 1, but 0 about the middle of the trunk and on hair, whose edges are mixed with the room."""
    trunk, rest = trunk_of(body), shot.mesh.vertices
    hair = np.isin(body.part, [JOINT_NAMES.index(name) for name in ("neck", "head")]) & ~face_of(body)
    share = np.abs(rest[:, 0]) / np.maximum(half_width(rest, trunk), 1e-3)
    return np.where(hair, 0.0, np.where(trunk, ((share - _ASIDE[0]) / (_ASIDE[1] - _ASIDE[0])).clip(0, 1), 1.0))


def paint(
    body: Body, shots: Sequence[FittedPicture], points: SurfacePoints, looks: Mapping[str, EyeLook] | None = None
) -> Paint:
    """Colours of ``points`` of the dressed body; ``shots`` begin with the front, ``looks`` are the eyes in it."""
    return painter_of(body, shots, points, looks).paint(points)


def _mixed(sights: Sequence[Sight]) -> tuple[F64, F64]:
    """[M] how well the points are seen, and their linear colours [M, 3] by all who see them."""
    count = len(sights[0].trust)
    total = sum((sight.trust**2 for sight in sights), np.zeros(count))
    mixed = sum((sight.linear * (sight.trust**2)[:, None] for sight in sights), np.zeros((count, 3)))
    return np.max([sight.trust for sight in sights], axis=0), mixed / np.maximum(total, 1e-9)[:, None]


def _smooth_colours(body: Body, shots: Sequence[FittedPicture], light: Lamp, cloth: Cloth) -> F64:
    """[V, 3] what is added to the cloth's linear colours without light: as seen at the vertices, the smoothest between.

    Where no cloth is known it is the colours themselves.
    """
    count = len(body.vertices)
    known, target = np.zeros(count), np.zeros((count, 3))
    first = shots[0]
    ground = cloth.at(SurfacePoints(np.repeat(np.arange(count)[:, None], 3, axis=1), np.full((count, 3), 1 / 3)))
    worn = ground.there > 0
    for shot in shots:
        trust = shot.trust * body.skin
        # every picture is of the same room: normals are turned back into the first camera's axes
        shade = light.shade(shot.normals @ (shot.view.root @ first.view.root.T))
        plain = shot.sample(shot.view.pixels, shot.layer) / shade[:, None]
        trust = trust * ground.alike(plain, patterned=False)  # a print does not flow into the cloth beside it
        known += trust
        target += trust[:, None] * plain
    twin = twins_across()
    lent = _LENT * known[twin] * (known < _LENT)
    known, target = known + lent, target + _LENT * target[twin] * (known < _LENT)[:, None]
    added = smoothest(body, known * worn, (target - known[:, None] * ground.colour) * worn[:, None], shy=_FORGETS)
    added[~worn] = smoothest(body, known, target, some=~worn)
    return added
