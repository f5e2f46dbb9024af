"""The back of a head: hair and hats as they are seen beside the face, and below them the skin of the neck."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import trunk_vertices
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.strands import Strands, strands_of
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.smooth import smoothest
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_linear
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["BackOfHead", "back_of_head", "ears_of"]

F64 = NDArray[np.float64]

_CROWN = 0.12  # share of the head's height that hair is taken from
_NAPE = 0.2  # share of the head's height below which short hair ends
_STEP = 0.015  # metres of height in which hair and skin are told apart beside the face
_SOFT = 0.02  # metres over which one becomes the other
_SEEN = 0.1
_HALF = 0.5  # of that way: what is farther from skin is not skin
_OUTLINE = 0.7  # of the width at a height: farther aside is the outline
_SURE = 0.7  # nearer to hair than to cloth by that factor
_STOUT = 0.085  # metres: half the width of what is no neck
_WORN = 0.75  # of the way from skin to hair: what is farther from skin is worn on the head
_IN_SHADE = 0.6, 1.2  # of a face's usual brightness: what other skin of it has
_LIKE = 0.5  # of the way from hair to skin or cloth: what is nearer is hair
_WIDE = 0.17  # metres from the middle within which long hair falls
_FEWEST = 4
_ROUND = 0.09  # metres between the crown and the middle of the head's round part
_EAR = 0.055, (0.825, 0.9), (0.028, 0.078)  # metres in the zero pose and shape: beside, in y and in z
_LIVELY = 2.5  # detail of hair against the spread of its brightness
_FINE = 0.006  # metres of an edge; on ears they are shorter
_BARE = 0.3  # share of an ear that is skin where no hair lies over it


@dataclass(frozen=True, slots=True, eq=False)
class BackOfHead:
    """What lies behind the face; ``back_of_head`` makes one."""

    rest: F64  # [V, 3] the dressed surface in the zero pose
    covered: F64  # [V] how much of each vertex is hair or neck that nobody looked at
    hair: F64  # [V] how much of that is hair
    colour: F64  # [V, 3] linear, without light
    strands: Strands | None

    @property
    def lively(self) -> float:
        """From 0 to 1, how much detail there is."""
        return 0.0 if self.strands is None else min(1.0, _LIVELY * float(self.strands.texture.std()))

    def at(self, points: SurfacePoints) -> tuple[F64, F64]:
        """[M] how much of each point it is, and its colour [M, 3] in linear light, without light."""
        values = points.at(np.column_stack([self.covered, self.hair, self.colour]))
        colour = values[:, 2:]
        if self.strands is not None:
            some = np.flatnonzero((values[:, 0] > 0) & (values[:, 1] > 0))
            part = points.take(some)
            colour[some] *= (1 + values[some, 1] * (self.strands.at(part.at(self.rest)) - 1))[:, None]
        return values[:, 0].clip(0, 1), colour


def back_of_head(
    body: Body, shot: FittedPicture, light: Lamp, nape_colour: F64 | None = None, locks: bool = True
) -> BackOfHead:
    """Hair as the front ``shot`` has it beside the face, all around at the same height, and longer where that falls.

    Below it a head has ``nape_colour`` [3], linear and without light; None: that of the throat. Without
    ``locks`` its hair is smooth, which is quicker.
    """
    rest = shot.mesh.vertices
    count = len(rest)
    joints = shot.mesh.skeleton.joints
    middle = joints[JOINT_NAMES.index("head")]
    ear, nape = middle[2] + 0.02, joints[JOINT_NAMES.index("neck"), 2] + 0.02
    head, neck = _of(body, "head", "jaw") & body.skin, _of(body, "neck")
    low, top = rest[head, 1].min(), rest[head, 1].max()
    plain = shot.sample(shot.view.pixels, shot.layer) / light.shade(shot.normals)[:, None]
    # about as eyes see it, and the same in any light, so that hair ends at the same place
    look = np.sqrt(shot.sample(shot.view.pixels, shot.layer) / _sky(shot).shade(shot.normals)[:, None])
    seen = shot.trust > _SEEN
    highest = rest[head & seen, 1].max(initial=low)  # a fitted skull may reach over the person's own
    crown = head & (rest[:, 1] > highest - _CROWN * (top - low)) & seen
    throat, face = neck & (shot.trust > 0.5), head & face_vertices(body) & (shot.trust > 0.5)
    if not crown.any() or not throat.any() or not face.any():
        return BackOfHead(rest, np.zeros(count), np.zeros(count), np.zeros((count, 3)), None)
    hair, skin = np.median(look[crown], axis=0), np.median(look[face], axis=0)
    nearer_skin = _away(look, hair) > _away(look, skin)
    unlike_skin = _away(look, skin) > _HALF * _away(hair, skin)  # hair below a hat is not like the hat
    chest = trunk_vertices(body) & (shot.trust > 0.5)
    cloth = np.median(look[chest], axis=0) if chest.any() else np.full(3, np.nan)  # unlike all
    unlike_cloth = ~(_away(look, hair) > _SURE * _away(look, cloth))
    beside = (rest[:, 2] < ear + 0.02) & seen
    ends = _ends(rest, head | neck, beside, unlike_skin, unlike_cloth, low + _NAPE * (top - low))
    # whatever is not skin beside a face is worn all around it: hair, and a hat above it
    worn = (head | neck) & ~face_vertices(body) & seen & (_away(look, skin) > _WORN * _away(hair, skin))
    worn &= rest[:, 1] > ends - _STEP
    shaded = (look @ skin / (skin @ skin)).clip(*_IN_SHADE)[:, None] * skin
    worn &= ~(_away(look, shaded) < _LIKE * _away(look, hair))  # nor are ears and jaws in the shade
    for other in (cloth, _room(shot, head)):  # collars and walls are not hair
        worn &= ~(_away(look, other) < np.minimum(_away(look, hair), _LIKE * _away(hair, other)))
    below_hat = worn & (rest[:, 1] < low + _NAPE * (top - low))
    fell = np.median(plain[worn], axis=0) if worn.any() else hair**2
    if below_hat.sum() > _FEWEST:
        hair, fell = np.median(look[below_hat], axis=0), np.median(plain[below_hat], axis=0)
    around = np.tile(hair**2, (count, 1))
    if worn.any() and locks:
        trust = shot.trust * worn
        around[head | neck] = smoothest(body, trust, trust[:, None] * plain, True, some=head | neck)
    above = ((rest[:, 1] - ends) / _SOFT).clip(0, 1)
    neck_behind = _ramp(nape - rest[:, 2]) * neck
    behind = _ramp(ear - rest[:, 2]) * head + neck_behind * (above if nape_colour is not None else 1.0)
    beside_face = above * (
        head & ~face_vertices(body)
    )  # what nobody saw beside a face is hair, not hair and skin mixed
    covered = np.maximum.reduce([behind, _ramp(rest[:, 1] - top + 0.05) * head, beside_face])
    below = np.median(plain[throat], axis=0) if nape_colour is None else nape_colour
    colour = above[:, None] * around + (1 - above[:, None]) * below
    fallen = _fallen(body, shot, look, hair, skin, ends, nape) if ends < rest[neck, 1].min() + 2 * _STEP else 0 * above
    if below_hat.sum() > _FEWEST:  # what falls is not mixed with a hat above
        share = _ramp(low + _NAPE * (top - low) - rest[:, 1])[:, None] * (head | neck)[:, None] * above[:, None]
        colour += share * (fell - colour)
    colour = np.where((fallen > 0)[:, None], fell, colour)
    covered, hairy = np.maximum(covered, fallen), np.maximum(above * (head | neck), fallen)
    for ears in ears_of(body):
        shown = np.flatnonzero(ears & seen)
        bare = shown[nearer_skin[shown]]
        if len(bare) > max(_BARE * len(shown), _FEWEST):
            colour[ears], hairy[ears], covered[ears] = np.median(plain[bare], axis=0), 0.0, 1.0
    round_part = np.array([middle[0], top - _ROUND, middle[2]])
    if not locks:
        return BackOfHead(rest, covered, hairy, colour, None)
    strands = strands_of(shot, np.flatnonzero(head | (neck & (fallen.max() > 0))), hair, skin, round_part)
    return BackOfHead(rest, covered, hairy, colour, strands)


def ears_of(body: Body) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """[V] the vertices of the left and the right ear."""
    edges = body.neighbours.tocoo()
    length = np.linalg.norm(body.vertices[edges.row] - body.vertices[edges.col], axis=1)
    mean = np.bincount(edges.row, length, len(body.vertices)) / np.maximum(np.bincount(edges.row), 1)
    x, y, z = body.vertices.T
    box = (y > _EAR[1][0]) & (y < _EAR[1][1]) & (z > _EAR[2][0]) & (z < _EAR[2][1]) & (mean < _FINE)
    box &= _of(body, "head") & body.skin
    return box & (x > _EAR[0]), box & (x < -_EAR[0])


def _fallen(body: Body, shot: FittedPicture, look: F64, hair: F64, skin: F64, ends: float, nape: float) -> F64:
    """[V] where long hair lies on the back: as far down and aside as it is seen on the chest and shoulders."""
    rest, trunk = shot.mesh.vertices, trunk_vertices(body)
    chest = trunk & (shot.trust > _SEEN) & (rest[:, 1] < ends)
    out = np.zeros(len(rest))
    if not chest.any():
        return out
    cloth = np.median(look[chest], axis=0)
    like = _away(look, hair) < _LIKE * min(_away(hair, skin), _away(hair, cloth))
    beside = chest & (np.abs(rest[:, 0]) < _WIDE)
    mine = beside & like
    lowest = ends
    while (row := beside & (rest[:, 1] < lowest) & (rest[:, 1] >= lowest - _STEP)).any():
        if (row & mine).sum() < _FEWEST or mine[row].mean() < 0.15:
            break
        lowest -= _STEP
    if lowest == ends:
        return out
    fell = mine & (rest[:, 1] > lowest)
    wide = float(np.quantile(np.abs(rest[fell, 0]), 0.9))
    back = _ramp(nape - rest[:, 2]) * trunk
    return np.asarray(back * _ramp(rest[:, 1] - lowest) * _ramp(wide - np.abs(rest[:, 0])))


def _sky(shot: FittedPicture) -> Lamp:
    """A room without a lamp."""
    return Lamp(np.array([0.0, 0.0, -1.0]), shot.view.root[:, 1], 0.0)


def _room(shot: FittedPicture, head: NDArray[np.bool_]) -> F64:
    """[3] what lies beside the head, as ``look`` in ``back_of_head``; not a number where nothing does."""
    height, width = shot.mask.shape
    pixels = shot.view.pixels[head].astype(np.intp).clip(0, (width - 1, height - 1))
    box = np.s_[pixels[:, 1].min() : pixels[:, 1].max() + 1, pixels[:, 0].min() : pixels[:, 0].max() + 1]
    beside = shot.rgb[box][~shot.mask[box]]
    return np.sqrt(to_linear(np.median(beside, axis=0) / 255)) if len(beside) else np.full(3, np.nan)


def _away(colours: F64, other: F64) -> F64:
    return np.asarray(np.linalg.norm(colours - other, axis=-1))


def _of(body: Body, *names: str) -> NDArray[np.bool_]:
    """[V] the vertices that these joints hold most of."""
    return np.isin(body.part, [JOINT_NAMES.index(name) for name in names])


def _ramp(metres: F64) -> F64:
    return np.asarray((metres / _SOFT).clip(0, 1))


def _ends(
    rest: F64,
    part: NDArray[np.bool_],
    beside: NDArray[np.bool_],
    hair: NDArray[np.bool_],
    unlike_cloth: NDArray[np.bool_],
    usual: float,
) -> float:
    """Metres above which there is hair: lower than usual where the outline beside the face is hair farther down.

    What may as well be a collar is hair where it is wider than necks are.
    """
    lowest = usual
    aside = np.abs(rest[:, 0])
    while True:
        all_of_it = part & (rest[:, 1] >= lowest - 2 * _STEP) & (rest[:, 1] < lowest)
        row, wide = all_of_it & beside, float(aside[all_of_it].max(initial=0.0))
        row &= aside > _OUTLINE * aside[row].max(initial=0.0)
        if row.sum() < _FEWEST or (hair & (unlike_cloth | (wide > _STOUT)))[row].mean() < 0.6:
            return lowest
        lowest -= _STEP
