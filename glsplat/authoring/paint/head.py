"""The back of a head: hair and hats as they are seen beside the face, and below them the skin of the neck."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.fit.body import Body
from glsplat.authoring.fit.offsets import face_of
from glsplat.authoring.paint.layers.segments import trunk_of
from glsplat.authoring.paint.light import Light
from glsplat.authoring.paint.shot import FittedPicture, SurfacePoints
from glsplat.authoring.paint.smooth import smoothest
from glsplat.pictures import to_linear
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["BackOfHead", "back_of_head"]

F64 = NDArray[np.float64]

_CROWN = 0.12  # share of the head's height that hair is taken from
_NAPE = 0.2  # share of the head's height below which short hair ends
_STEP = 0.015  # metres of height in which hair and skin are told apart beside the face
_SOFT = 0.02  # metres over which one becomes the other
_SEEN = 0.1
_WORN = 0.75  # of the way from skin to hair: what is farther from skin is worn on the head
_LIKE = 0.5  # of the way from hair to skin or cloth: what is nearer is hair
_WIDE = 0.17  # metres from the middle within which long hair falls
_FEWEST = 4
_STRANDS = 17.0, 29.0, 43.0, 61.0  # of each kind around a head
_CURL = 40.0  # radians a metre of height by which they wander
_CONTRAST = 0.25  # of brightness, at most


@dataclass(frozen=True, slots=True, eq=False)
class BackOfHead:
    """What lies behind the face; ``back_of_head`` makes one."""

    rest: F64  # [V, 3] the dressed surface in the zero pose
    covered: F64  # [V] how much of each vertex is hair or neck that nobody looked at
    hair: F64  # [V] how much of that is hair
    colour: F64  # [V, 3] linear, without light
    contrast: F64  # of strands of hair, in shares of its brightness
    middle: F64  # [3] of the head

    def at(self, points: SurfacePoints) -> tuple[F64, F64]:
        """[M] how much of each point it is, and its colour [M, 3] in linear light, without light."""
        values = points.at(np.column_stack([self.covered, self.hair, self.colour]))
        where = points.at(self.rest) - self.middle
        angle = np.arctan2(where[:, 0], -where[:, 2])
        strands = sum(
            np.sin(number * angle + index + np.sin(_CURL * where[:, 1] + 2 * index) * (1 + index) / 2)
            for index, number in enumerate(_STRANDS)
        ) / np.sqrt(2 * len(_STRANDS))
        shade = 1 + self.contrast * values[:, 1] * (strands * 1.0).clip(-2, 2)
        return values[:, 0].clip(0, 1), values[:, 2:] * shade[:, None]


def back_of_head(body: Body, shot: FittedPicture, light: Light) -> BackOfHead:
    """Hair as the front ``shot`` has it beside the face, all around at the same height, and longer where that falls."""
    rest = shot.mesh.vertices
    count = len(rest)
    joints = shot.mesh.skeleton.joints
    middle = joints[JOINT_NAMES.index("head")]
    ear, nape = middle[2] + 0.02, joints[JOINT_NAMES.index("neck"), 2] + 0.02
    head, neck = _of(body, "head", "jaw") & body.skin, _of(body, "neck")
    low, top = rest[head, 1].min(), rest[head, 1].max()
    plain = shot.sample(shot.view.pixels, shot.layer) / light.shade(shot.normals)[:, None]
    look = np.sqrt(plain)  # about as eyes see it
    seen = shot.trust > _SEEN
    highest = rest[head & seen, 1].max(initial=low)  # a fitted skull may reach over the person's own
    crown = head & (rest[:, 1] > highest - _CROWN * (top - low)) & seen
    throat, face = neck & (shot.trust > 0.5), head & face_of(body) & (shot.trust > 0.5)
    if not crown.any() or not throat.any() or not face.any():
        return BackOfHead(rest, np.zeros(count), np.zeros(count), np.zeros((count, 3)), np.zeros(()), middle)
    hair, skin = np.median(look[crown], axis=0), np.median(look[face], axis=0)
    nearer = _away(look, hair) < _away(look, skin)
    beside = (head | neck) & (rest[:, 2] < ear + 0.02) & seen
    ends = _ends(rest[:, 1], beside, nearer, low + _NAPE * (top - low))
    # whatever is not skin beside a face is worn all around it: hair, and a hat above it
    worn = (head | neck) & ~face_of(body) & seen & (_away(look, skin) > _WORN * _away(hair, skin))
    worn &= rest[:, 1] > ends - _STEP
    chest = trunk_of(body) & (shot.trust > 0.5)
    cloth = np.median(look[chest], axis=0) if chest.any() else np.full(3, np.nan)  # unlike all
    for other in (cloth, _room(shot, head)):  # collars and walls are not hair
        worn &= ~(_away(look, other) < np.minimum(_away(look, hair), _LIKE * _away(hair, other)))
    trust = shot.trust * worn
    around = smoothest(body, trust, trust[:, None] * plain, True) if worn.any() else np.tile(hair**2, (count, 1))
    above = ((rest[:, 1] - ends) / _SOFT).clip(0, 1)
    behind = _ramp(ear - rest[:, 2]) * head + _ramp(nape - rest[:, 2]) * neck
    beside_face = above * (head & ~face_of(body))  # what nobody saw beside a face is hair, not hair and skin mixed
    covered = np.maximum.reduce([behind, _ramp(rest[:, 1] - top + 0.05) * head, beside_face])
    colour = above[:, None] * around + (1 - above[:, None]) * np.median(plain[throat], axis=0)
    fallen = _fallen(body, shot, look, hair, skin, ends, nape) if ends < rest[neck, 1].min() + 2 * _STEP else 0 * above
    colour = np.where((fallen > 0)[:, None], np.median(plain[worn], axis=0) if worn.any() else hair**2, colour)
    bright = plain[crown & (shot.trust > 0.5)].mean(axis=1)
    contrast = np.asarray(np.std(bright) / max(float(np.mean(bright)), 0.02) if len(bright) > _FEWEST else 0.0)
    return BackOfHead(
        rest,
        np.maximum(covered, fallen),
        np.maximum(above * (head | neck), fallen),
        colour,
        contrast.clip(0, _CONTRAST),
        middle,
    )


def _fallen(body: Body, shot: FittedPicture, look: F64, hair: F64, skin: F64, ends: float, nape: float) -> F64:
    """[V] where long hair lies on the back: as far down and aside as it is seen on the chest and shoulders."""
    rest, trunk = shot.mesh.vertices, trunk_of(body)
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


def _ends(height: F64, beside: NDArray[np.bool_], hair: NDArray[np.bool_], usual: float) -> float:
    """Metres above which there is hair: lower than usual where hair is seen beside the face farther down."""
    lowest = usual
    while True:
        row = beside & (height >= lowest - _STEP) & (height < lowest)
        if row.sum() < _FEWEST or hair[row].mean() < 0.6:
            return lowest
        lowest -= _STEP
