"""Paint a dressed body's surface from the pictures of it, unseen sides included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import mirror_vertices, trunk_half_width, trunk_vertices
from glsplat.extras.authoring.compute.threads import map_threads, run_in_background
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.extras.authoring.networks.face import EyeLook
from glsplat.extras.authoring.paint.front_to_back_transfer import Front, FrontMatches, match_to_front
from glsplat.extras.authoring.paint.head import BackOfHead, back_of_head, vertices_of
from glsplat.extras.authoring.paint.inpaint.cloth import NECK, TRUNK, Cloth, cloth_of
from glsplat.extras.authoring.paint.inpaint.hands import Hands, hands_of
from glsplat.extras.authoring.paint.inpaint.material import Material
from glsplat.extras.authoring.paint.inpaint.sleeves import cut_sleeves
from glsplat.extras.authoring.paint.inpaint.tailoring import Tailoring, tailoring_of
from glsplat.extras.authoring.paint.lamp import Lamp, find_light
from glsplat.extras.authoring.paint.mouth_and_eyes import EyesAndMouth, eyes_and_mouth_of
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.shoes import ShoePainter, shoe_painter
from glsplat.extras.authoring.paint.skin_tone import likeness
from glsplat.extras.authoring.paint.smooth import fill_smoothly
from glsplat.extras.authoring.paint.view_sample import FittedPicture, ViewSample
from glsplat.meshes import RiggedMesh
from glsplat.pictures import to_srgb

F64 = NDArray[np.float64]

COLOUR_DIGITS = 6
"""Decimals of a colour; see optimize/colour_fit.py."""

# faces and chins have no counterpart at the back
_UNMATCHED = ("neck", *HEAD)
_GUESSED_DETAIL_FACTOR = 0.6  # guessed detail gets fewer splats than visible detail
_BLOCK_POINTS = 1 << 15  # painted together by one core
_MIRROR_WEIGHT = 0.003  # of the other half's colour for a vertex seen in no picture
_UNSEEN_CLOTH_DECAY = 1e-4  # pull of unseen cloth towards the colour of its row
_LIGHT_RANGE = 0.6, 1.6  # of guessed cloth, over its colour
_FLANK_SHADING = 0.4  # of a colour's brightness: light and shade of the visible cloth go on round the flank
_MIRROR_FADE = 0.35, 0.6  # of a trunk's half width: signs are in its middle, so nothing is mirrored there
_SHADE_RATIO_RANGE = 0.3, 1.4  # of an unseen point's light over that of its source


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """Known and guessed colours of M points."""

    rgb: F64  # [M, 3] sRGB in [0, 1]
    visibility: F64  # [M] from 0, guessed, to 1, visible
    detail: F64  # [M] from 0, plain, to 1, full of detail
    guessed: F64  # [M] from 0 to 1, of a trunk's plain cloth alone: on thin limbs wide splats blur


@dataclass(frozen=True, eq=False)
class Painter:
    """Colours of any points of a dressed body; ``painter_of`` makes one."""

    body: Body
    shots: Sequence[FittedPicture]  # the front first
    inside: EyesAndMouth
    light: Lamp
    cloth: Cloth
    plain: F64  # [V, 3] smooth unlit linear colours; where there is cloth, what is added to its colour
    matches: FrontMatches
    head: BackOfHead
    sleeves: SurfacePoints | None  # [V] point of the trunk whose cloth an arm's vertex takes; None for plain cloth
    mirror_weights: F64  # [V] weight of the body's other half for vertices seen in no picture
    hands: Hands
    tailoring: Tailoring
    shoes: ShoePainter | None  # of vertices after the body's
    bald: NDArray[np.bool_] | None  # [V] where hair is not painted

    def paint(self, points: SurfacePoints) -> Paint:
        """Return the colours of the points; only points not seen squarely are guessed."""
        starts = range(0, max(len(points.corners), 1), _BLOCK_POINTS)
        blocks = [points.take(slice(first, first + _BLOCK_POINTS)) for first in starts]
        parts = map_threads(self._paint_block, blocks)
        return Paint(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def _paint_block(self, points: SurfacePoints) -> tuple[F64, F64, F64, F64]:
        """Return the fields of ``Paint`` for one block of points."""
        worn = points.corners[:, 0] >= len(self.body.vertices)
        if self.shoes is not None and worn.any():
            own = self._paint_block(points.take(~worn))
            shoes = self.shoes.paint(points.take(worn))
            order = np.argsort(np.concatenate([np.flatnonzero(~worn), np.flatnonzero(worn)]))
            both = zip(own, (*shoes, np.zeros(len(shoes[0]))), strict=True)
            rgb, visibility, detail, guessed = (np.concatenate(each)[order] for each in both)
            return rgb, visibility, detail, guessed
        samples, material, shade = self._sample_pictures(points)
        visibility, colour = _mix_views(samples)
        detail = np.max([sample.detail * sample.visibility for sample in samples], axis=0)
        unsure = np.flatnonzero(visibility < 1)
        part = points.take(unsure)
        guess, guessed_detail = self._guess(part, material.at(unsure), shade[unsure])
        detail[unsure] = np.maximum(detail[unsure], _GUESSED_DETAIL_FACTOR * guessed_detail * (1 - visibility[unsure]))
        colour[unsure] = guess + visibility[unsure, None] * (colour[unsure] - guess)
        rgb = self.inside.over(to_srgb(colour), points)
        guessed = (1 - visibility) * (self.cloth.region(points) == TRUNK) * ~material.pattern
        return np.round(rgb, COLOUR_DIGITS), visibility, np.round(detail, COLOUR_DIGITS), guessed

    def colours(self, points: SurfacePoints) -> F64:
        """Return ``paint(points).rgb``, computed on one core."""
        return self._paint_block(points)[0]

    def _sample_pictures(self, points: SurfacePoints) -> tuple[list[ViewSample], Material, F64]:
        """Return each picture's sample (the front's without foreign colours), the material, and the light [M]."""
        samples = [shot.sample_surface(points) for shot in self.shots]
        shade = self.light.shade(points.directions(self.shots[0].normals))
        material, first = self.cloth.at(points), samples[0]
        foreign = self.cloth.foreign(self.shots[0], points, first.linear, shade, material)
        if self.cloth.skin is not None and not self.tailoring.trousers:  # the sheet of a skirt shows no leg
            worn, where, _ = self.tailoring.worn(points)
            bare = likeness(first.linear / shade[:, None], self.cloth.skin[None] ** 2)
            foreign = np.maximum(foreign, worn * bare * (where[:, 1] < self.tailoring.waist))
        samples[0] = replace(first, visibility=first.visibility * (1 - foreign))
        return samples, material, shade

    def _guess(self, points: SurfacePoints, material: Material, shade: F64) -> tuple[F64, F64]:
        """Return [M, 3] linear colours where no picture looks, and [M] their detail."""
        body, front = self.body, self.shots[0]
        # the front at the same place where it shows the same cloth, but for the head
        matched = self.matches.colours(front, points)
        source_shade = self.light.shade(matched.normals)
        ratio = (shade / source_shade).clip(*_SHADE_RATIO_RANGE)
        round_parts = vertices_of(body, *_UNMATCHED)
        trust = matched.visibility * (1 - points.at(round_parts.astype(float)[:, None])[:, 0])
        source = matched.linear / source_shade[:, None]
        same = trust * material.likeness(source, patterned=False)
        trust = trust * material.likeness(source)
        # shadows and prints of a front have no counterpart behind, patterns have; wrinkles are as likely there
        arms, cloth = self.cloth.on_sleeves(points), material.known > 0
        trust = trust * ~(cloth & ~material.pattern) * np.where(cloth & arms, matched.known, 1.0)
        covered, colour = self.head.at(points)
        if self.bald is not None:
            collar = (self.cloth.region(points) == TRUNK) & vertices_of(body, "neck")[points.corners[:, 0]]
            covered = covered * ~collar
        # added, not layered: layering would show a third colour where neck and back meet
        rest = 1 - trust - covered
        plain = points.at(self.plain) + material.known[:, None] * material.colour
        low, high = ((factor * material.known)[:, None] * material.colour for factor in _LIGHT_RANGE)
        plain = plain.clip(low, np.where(material.known[:, None] > 0, high, np.inf))
        sewn, seams = self.tailoring.at(points, matched.relief * same)
        plain *= sewn[:, None]
        guess = (rest[:, None] * plain + covered[:, None] * colour) * shade[:, None]
        guess += (trust * ratio)[:, None] * matched.linear
        # the other half of the body may show what this one hides
        across = SurfacePoints(mirror_vertices()[points.corners], points.weights)
        other = front.sample_surface(across)
        source_shade = self.light.shade(across.directions(front.normals))
        mirror_share = (
            other.visibility
            * points.at(self.mirror_weights[:, None])[:, 0]
            * material.likeness(other.linear / source_shade[:, None])
        )
        guess += mirror_share[:, None] * (
            (shade / source_shade).clip(*_SHADE_RATIO_RANGE)[:, None] * other.linear - guess
        )
        if self.sleeves is not None:
            some = np.flatnonzero(arms & material.pattern)
            guess[some] += ((1 - trust) * (1 - mirror_share))[some, None] * (
                self._sleeve_colours(points, some, shade) - guess[some]
            )
        guess = self.hands.over(points, guess)
        guessed = np.maximum(matched.detail * trust, other.detail * mirror_share)
        return guess, np.maximum(guessed, seams * (1 - trust))

    def _sleeve_colours(self, points: SurfacePoints, some: NDArray[np.intp], shade: F64) -> F64:
        """Return [K, 3] linear colours for ``some`` points of sleeves, taken from the trunk's cloth."""
        assert self.sleeves is not None
        front, part = self.shots[0], points.take(some)
        source_shade = self.light.shade(part.directions(self.sleeves.directions(front.normals)))
        cloth = front.sample(part.at(self.sleeves.at(front.view.pixels)))
        return np.asarray((shade[some] / source_shade).clip(*_SHADE_RATIO_RANGE)[:, None] * cloth)


def painter_of(
    body: Body,
    shots: Sequence[FittedPicture],
    points: SurfacePoints,
    looks: Mapping[str, EyeLook] | None = None,
    shod: RiggedMesh | None = None,
    hand_texture: NDArray[np.uint8] | None = None,
    bald: NDArray[np.bool_] | None = None,
) -> Painter:
    """Return a painter of the body in ``shots``, the front first; ``looks`` are the eyes in it.

    Light and cloth are estimated at ``points``, which should lie evenly over its surface. ``shod`` is the body with
    shoes, if it has any; ``hand_texture`` that of the open body's skin. Vertices that are ``bald`` [V]
    get skin, not hair.
    """
    front = shots[0]
    start_front = run_in_background(lambda: Front(front.mesh))
    sample = front.sample_surface(points)
    normals, up = points.directions(front.normals), front.view.root[:, 1]
    light = find_light(normals, sample.linear, sample.visibility, up, np.array([0.0, 0, -1]))
    cloth = cloth_of(body, front, points, sample, light.shade(normals))
    head = run_in_background(lambda: back_of_head(body, front, light, cloth.nape, bald=bald))
    plain, view = _smooth_colours(body, shots, light, cloth), start_front()
    matches, span = match_to_front(front.mesh, trunk_vertices(body), view), cloth.patterned
    sleeves = None if span is None else cut_sleeves(front.mesh, view, span)
    inside = eyes_and_mouth_of(body, front, looks or {})
    shoes = None if shod is None else shoe_painter(body, front, light, shod)
    weights = _mirror_weights(body, front)
    hands = hands_of(body, front, light, hand_texture)
    tailoring = tailoring_of(front.mesh, cloth, len(front.mesh.faces) == len(body.faces))
    return Painter(
        body, shots, inside, light, cloth, plain, matches, head(), sleeves, weights, hands, tailoring, shoes, bald
    )


def _mirror_weights(body: Body, shot: FittedPicture) -> F64:
    """Return [V] 1, but 0 about the middle of the trunk and on hair, whose edges are mixed with the background."""
    trunk, rest = trunk_vertices(body), shot.mesh.vertices
    hair = vertices_of(body, "neck", "head") & ~face_vertices(body)
    share = np.abs(rest[:, 0]) / np.maximum(trunk_half_width(rest, trunk), 1e-3)
    return np.where(hair, 0.0, np.where(trunk, ramp(share, *_MIRROR_FADE), 1.0))


def _mix_views(samples: Sequence[ViewSample]) -> tuple[F64, F64]:
    """Return [M] the visibility of the points, and their linear colours [M, 3], mixed from all pictures."""
    count = len(samples[0].visibility)
    total = sum((sample.visibility**2 for sample in samples), np.zeros(count))
    mixed = sum((sample.linear * (sample.visibility**2)[:, None] for sample in samples), np.zeros((count, 3)))
    return np.max([sample.visibility for sample in samples], axis=0), mixed / np.maximum(total, 1e-9)[:, None]


def _smooth_colours(body: Body, shots: Sequence[FittedPicture], light: Lamp, cloth: Cloth) -> F64:
    """Return [V, 3] offsets to the cloth's unlit linear colours: as seen at the vertices, smooth between.

    Where no cloth is known they are the colours themselves.
    """
    count = len(body.vertices)
    known, target = np.zeros(count), np.zeros((count, 3))
    first = shots[0]
    vertices = SurfacePoints(np.repeat(np.arange(count)[:, None], 3, axis=1), np.full((count, 3), 1 / 3))
    material = cloth.at(vertices)
    shading = np.where(cloth.region(vertices) == NECK, 0, _FLANK_SHADING)  # hair on a neck is no shade
    clothed = material.known > 0
    for shot in shots:
        trust = shot.visibility * body.skin
        # one room for all pictures: normals are turned into the first camera's axes
        shade = light.shade(shot.normals @ (shot.view.root @ first.view.root.T))
        plain = shot.sample(shot.view.pixels, shot.layer) / shade[:, None]
        trust = trust * material.likeness(plain, patterned=False, shading=shading)  # a print does not flow on
        known += trust
        target += trust[:, None] * plain
    mirrored = mirror_vertices()
    mirror_share = _MIRROR_WEIGHT * known[mirrored] * (known < _MIRROR_WEIGHT)
    known, target = known + mirror_share, target + _MIRROR_WEIGHT * target[mirrored] * (known < _MIRROR_WEIGHT)[:, None]
    offsets = fill_smoothly(
        body, known * clothed, (target - known[:, None] * material.colour) * clothed[:, None], decay=_UNSEEN_CLOTH_DECAY
    )
    offsets[~clothed] = fill_smoothly(body, known, target, some=~clothed)
    return offsets
