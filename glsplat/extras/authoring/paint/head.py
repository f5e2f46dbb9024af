"""Colour the back of a head: hair and hats as seen beside the face, and the neck's skin below them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import trunk_vertices
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.smooth import fill_smoothly
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_linear
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_CROWN_FRACTION = 0.12  # of the head's height, from the top: where hair is sampled
_NAPE_FRACTION = 0.2  # of the head's height, from the chin: lowest hair of short hair
_ROW_M = 0.015  # height of the rows in which hair and skin are classified beside the face
_BLEND_M = 0.02  # between hair and skin
_MIN_VISIBILITY, _MIN_CLEAR_VISIBILITY = 0.1, 0.5
_SKIN_FRACTION = 0.5  # of the distance from skin to hair: colours farther from skin are not skin
_OUTLINE_FRACTION = 0.7  # of the width at a height: the outline starts here
_HAIR_TO_CLOTH_RATIO = 0.7  # of colour distances, at most, for hair
_NECK_HALF_WIDTH_M = 0.085  # anything wider is no neck
_WORN_FRACTION = 0.75  # of the distance from skin to hair: colours farther from skin are hair or a hat
_SHADED_SKIN_RANGE = 0.6, 1.2  # brightness of skin against the face's median
_SIMILAR_FRACTION = 0.5  # of the distance from hair to skin or cloth: nearer colours are hair
_LONG_HAIR_HALF_WIDTH_M = 0.17
_MIN_VERTICES = 4
_MIN_LONG_HAIR_FRACTION, _MIN_OUTLINE_HAIR_FRACTION = 0.15, 0.6  # of a row's vertices
_BEHIND_JOINT_M = 0.02  # before the joints of head and neck: surface farther back is never visible
_CAP_M = 0.05  # of the crown that the front does not show
# the box of an ear in the zero pose and mean shape: |x| at least, y and z between
_EAR_MIN_X_M, _EAR_Y_M, _EAR_Z_M = 0.055, (0.825, 0.9), (0.028, 0.078)
_EAR_EDGE_M = 0.006  # mesh edges on ears are shorter
_BARE_EAR_FRACTION = 0.3  # of its visible vertices that are skin, at least, where no hair covers an ear


@dataclass(frozen=True, slots=True, eq=False)
class BackOfHead:
    """Colours of a head behind the face; ``back_of_head`` makes one."""

    covered: F64  # [V] fraction of each vertex that is unseen hair or neck
    hair: F64  # [V] fraction of that which is hair
    colour: F64  # [V, 3] linear, without light

    def at(self, points: SurfacePoints) -> tuple[F64, F64]:
        """Return [M] the fraction of each point that is hair or neck, and its unlit linear colour [M, 3]."""
        values = points.at(np.column_stack([self.covered, self.colour]))
        return values[:, 0].clip(0, 1), values[:, 1:]


def back_of_head(
    body: Body,
    shot: FittedPicture,
    light: Lamp,
    nape_colour: F64 | None = None,
    blended: bool = True,
    bald: NDArray[np.bool_] | None = None,
) -> BackOfHead:
    """Return hair as the front ``shot`` shows it beside the face, at the same heights all around.

    Long hair reaches down the back. Below the hair a head has ``nape_colour`` [3], linear and unlit; None: that of the
    throat. ``blended=False`` gives the hair one colour, which is faster. Vertices that are ``bald`` [V] have skin: a
    template is their hair.
    """
    rest = shot.mesh.vertices
    count = len(rest)
    joints = shot.mesh.skeleton.joints
    middle = joints[JOINT_NAMES.index("head")]
    ear, nape = middle[2] + _BEHIND_JOINT_M, joints[JOINT_NAMES.index("neck"), 2] + _BEHIND_JOINT_M
    head, neck = vertices_of(body, "head", "jaw") & body.skin, vertices_of(body, "neck")
    low, top = rest[head, 1].min(), rest[head, 1].max()
    nape_height = low + _NAPE_FRACTION * (top - low)
    unlit = shot.sample(shot.view.pixels, shot.layer) / light.shade(shot.normals)[:, None]
    # perceptual, and independent of the light, so that hair ends at the same place
    look = np.sqrt(shot.sample(shot.view.pixels, shot.layer) / _diffuse_light(shot).shade(shot.normals)[:, None])
    visible = shot.visibility > _MIN_VISIBILITY
    highest = rest[head & visible, 1].max(initial=low)  # a fitted skull may reach over the person's own
    crown = head & (rest[:, 1] > highest - _CROWN_FRACTION * (top - low)) & visible
    clear = shot.visibility > _MIN_CLEAR_VISIBILITY
    throat, face, chest = neck & clear, head & face_vertices(body) & clear, trunk_vertices(body) & clear
    if not crown.any() or not throat.any() or not face.any():
        return BackOfHead(np.zeros(count), np.zeros(count), np.zeros((count, 3)))
    hair, skin = np.median(look[crown], axis=0), np.median(look[face], axis=0)
    nearer_skin = _distance(look, hair) > _distance(look, skin)
    unlike_skin = _distance(look, skin) > _SKIN_FRACTION * _distance(hair, skin)  # hair below a hat is not like the hat
    cloth = np.median(look[chest], axis=0) if chest.any() else np.full(3, np.nan)  # no cloth: nothing is similar
    unlike_cloth = ~(_distance(look, hair) > _HAIR_TO_CLOTH_RATIO * _distance(look, cloth))
    beside = (rest[:, 2] < ear + _BLEND_M) & visible
    hair_end = _hair_end(rest, head | neck, beside, unlike_skin, unlike_cloth, nape_height)
    # colours beside a face that are not skin go all around it: hair, and a hat above it
    off_skin = _distance(look, skin) > _WORN_FRACTION * _distance(hair, skin)
    worn = (head | neck) & ~face_vertices(body) & visible & off_skin
    worn &= rest[:, 1] > hair_end - _ROW_M
    shaded = (look @ skin / (skin @ skin)).clip(*_SHADED_SKIN_RANGE)[:, None] * skin
    worn &= ~(_distance(look, shaded) < _SIMILAR_FRACTION * _distance(look, hair))  # shaded ears and jaws are skin
    for other in (cloth, _background(shot, head)):  # collars and walls are not hair
        nearest = np.minimum(_distance(look, hair), _SIMILAR_FRACTION * _distance(hair, other))
        worn &= ~(_distance(look, other) < nearest)
    below_hat = worn & (rest[:, 1] < nape_height)
    fallen_colour = np.median(unlit[worn], axis=0) if worn.any() else hair**2
    if below_hat.sum() > _MIN_VERTICES:
        hair, fallen_colour = np.median(look[below_hat], axis=0), np.median(unlit[below_hat], axis=0)
    around = np.tile(hair**2, (count, 1))
    if worn.any() and blended:
        trust = shot.visibility * worn
        around[head | neck] = fill_smoothly(body, trust, trust[:, None] * unlit, True, some=head | neck)
    above = _ramp(rest[:, 1] - hair_end)
    neck_behind = _ramp(nape - rest[:, 2]) * neck
    behind = _ramp(ear - rest[:, 2]) * head + neck_behind * (above if nape_colour is not None else 1.0)
    beside_face = above * (head & ~face_vertices(body))  # unseen surface beside a face is hair, not a mix with skin
    covered = np.maximum.reduce([behind, _ramp(rest[:, 1] - top + _CAP_M) * head, beside_face])
    below = np.median(unlit[throat], axis=0) if nape_colour is None else nape_colour
    colour = above[:, None] * around + (1 - above[:, None]) * below
    hair_on_back = np.zeros(count)
    if bald is None and hair_end < rest[neck, 1].min() + 2 * _ROW_M:
        hair_on_back = _long_hair_on_back(body, shot, look, hair, skin, hair_end, nape)
    if below_hat.sum() > _MIN_VERTICES:  # falling hair has no colour of the hat above it
        share = _ramp(nape_height - rest[:, 1]) * (head | neck) * above
        colour += share[:, None] * (fallen_colour - colour)
    colour = np.where((hair_on_back > 0)[:, None], fallen_colour, colour)
    covered, hair_share = np.maximum(covered, hair_on_back), np.maximum(above * (head | neck), hair_on_back)
    if bald is not None:
        colour, hair_share = np.where(bald[:, None], below, colour), hair_share * ~bald
    for ears in ears_of(body):
        shown = np.flatnonzero(ears & visible)
        bare = shown[nearer_skin[shown]]
        if len(bare) > max(_BARE_EAR_FRACTION * len(shown), _MIN_VERTICES):
            colour[ears], hair_share[ears], covered[ears] = np.median(unlit[bare], axis=0), 0.0, 1.0
    return BackOfHead(covered, hair_share, colour)


def ears_of(body: Body) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return [V] the vertices of the left and the right ear."""
    edges = body.neighbours.tocoo()
    length = np.linalg.norm(body.vertices[edges.row] - body.vertices[edges.col], axis=1)
    mean = np.bincount(edges.row, length, len(body.vertices)) / np.maximum(np.bincount(edges.row), 1)
    x, y, z = body.vertices.T
    box = (y > _EAR_Y_M[0]) & (y < _EAR_Y_M[1]) & (z > _EAR_Z_M[0]) & (z < _EAR_Z_M[1]) & (mean < _EAR_EDGE_M)
    box &= vertices_of(body, "head") & body.skin
    return box & (x > _EAR_MIN_X_M), box & (x < -_EAR_MIN_X_M)


def _long_hair_on_back(
    body: Body, shot: FittedPicture, look: F64, hair: F64, skin: F64, hair_end: float, nape: float
) -> F64:
    """Return [V] where long hair lies on the back: as far down and to the sides as on chest and shoulders."""
    rest, trunk = shot.mesh.vertices, trunk_vertices(body)
    chest = trunk & (shot.visibility > _MIN_VISIBILITY) & (rest[:, 1] < hair_end)
    out = np.zeros(len(rest))
    if not chest.any():
        return out
    cloth = np.median(look[chest], axis=0)
    like = _distance(look, hair) < _SIMILAR_FRACTION * min(_distance(hair, skin), _distance(hair, cloth))
    beside = chest & (np.abs(rest[:, 0]) < _LONG_HAIR_HALF_WIDTH_M)
    mine = beside & like
    lowest = hair_end
    while (row := beside & (rest[:, 1] < lowest) & (rest[:, 1] >= lowest - _ROW_M)).any():
        if (row & mine).sum() < _MIN_VERTICES or mine[row].mean() < _MIN_LONG_HAIR_FRACTION:
            break
        lowest -= _ROW_M
    if lowest == hair_end:
        return out
    wide = float(np.quantile(np.abs(rest[mine & (rest[:, 1] > lowest), 0]), 0.9))
    back = _ramp(nape - rest[:, 2]) * trunk
    return np.asarray(back * _ramp(rest[:, 1] - lowest) * _ramp(wide - np.abs(rest[:, 0])))


def _diffuse_light(shot: FittedPicture) -> Lamp:
    """Return a room without a lamp."""
    return Lamp(np.array([0.0, 0.0, -1.0]), shot.view.root[:, 1], 0.0)


def _background(shot: FittedPicture, head: NDArray[np.bool_]) -> F64:
    """Return [3] the square root of the background's colour beside the head; NaN where there is none."""
    height, width = shot.mask.shape
    pixels = shot.view.pixels[head].astype(np.intp).clip(0, (width - 1, height - 1))
    box = np.s_[pixels[:, 1].min() : pixels[:, 1].max() + 1, pixels[:, 0].min() : pixels[:, 0].max() + 1]
    beside = shot.rgb[box][~shot.mask[box]]
    return np.sqrt(to_linear(np.median(beside, axis=0) / 255)) if len(beside) else np.full(3, np.nan)


def _distance(colours: F64, other: F64) -> F64:
    return np.asarray(np.linalg.norm(colours - other, axis=-1))


def vertices_of(body: Body, *names: str) -> NDArray[np.bool_]:
    """Return [V] the vertices that are bound most to these joints."""
    return np.isin(body.part, [JOINT_NAMES.index(name) for name in names])


def _ramp(metres: F64) -> F64:
    return np.asarray((metres / _BLEND_M).clip(0, 1))


def _hair_end(
    rest: F64,
    part: NDArray[np.bool_],
    beside: NDArray[np.bool_],
    hair: NDArray[np.bool_],
    unlike_cloth: NDArray[np.bool_],
    usual: float,
) -> float:
    """Return the height in metres where hair ends: below ``usual`` while the outline beside the face is hair.

    Colours that may as well be a collar count as hair where the outline is wider than necks are.
    """
    lowest = usual
    aside = np.abs(rest[:, 0])
    while True:
        ring = part & (rest[:, 1] >= lowest - 2 * _ROW_M) & (rest[:, 1] < lowest)
        row, wide = ring & beside, float(aside[ring].max(initial=0.0))
        row &= aside > _OUTLINE_FRACTION * aside[row].max(initial=0.0)
        hairy = hair & (unlike_cloth | (wide > _NECK_HALF_WIDTH_M))
        if row.sum() < _MIN_VERTICES or hairy[row].mean() < _MIN_OUTLINE_HAIR_FRACTION:
            return lowest
        lowest -= _ROW_M
