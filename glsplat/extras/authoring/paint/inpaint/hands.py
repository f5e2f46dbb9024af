"""Colour hands: the texture of nails, knuckles and palms in the skin's tone, or the tone of gloves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import joint_weights
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.rows import SAME_COLOUR_DISTANCE
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.skin_tone import face_colour, likeness, unlit
from glsplat.extras.authoring.paint.view_sample import FittedPicture, hand_shares
from glsplat.meshes import MeshPart
from glsplat.pictures import to_linear

F64 = NDArray[np.float64]

_MIN_VISIBILITY, _MIN_VERTICES = 0.3, 40
_TEXTURE_RANGE = 0.4, 1.8  # of the texture over its median
_MIN_BRIGHTNESS = 0.75  # of a hand's tone, over the face's
_SHADES = 0.75, 1.6  # of the light on hands, over the face's: more would look wrong once hands turn
_HUE_FRACTION, _CONTRAST = 0.2, 1.7  # of the texture's own hue (red palms and knuckles), and exponent


@dataclass(frozen=True, eq=False)
class Hands:
    """Colours of bare hands or gloves; ``hands_of`` makes one."""

    share: F64  # [V] 0 on arms, 1 on hands
    colour: F64  # [V, 3] linear, in the picture's light

    def over(self, points: SurfacePoints, linear: F64) -> F64:
        """Return ``linear`` colours [M, 3] with hands over them."""
        values = points.at(np.column_stack([self.share, self.colour]))
        return linear + values[:, :1] * (values[:, 1:] - linear)


def hands_of(body: Body, shot: FittedPicture, light: Lamp, texture: NDArray[np.uint8] | None = None) -> Hands:
    """Return the hands in the front ``shot``, in the tone of the face or of gloves.

    ``texture`` [H, W, 3] is the open body's skin in sRGB; None: plain skin.
    """
    uv = np.zeros((len(body.vertices), 2))
    uv[body.faces.ravel()] = body.uv.reshape(-1, 2)
    picture = np.full((1, 1, 3), 255, np.uint8) if texture is None else texture
    opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
    skin = to_linear(MeshPart("", np.zeros((0, 3), np.int32), np.zeros((0, 3, 2)), opaque).sample(uv)[:, :3])
    share, colour, covered = np.zeros(len(uv)), np.zeros((len(uv), 3)), False
    face = face_colour(body, shot, light)
    details, seen = [], []
    for side, part in zip(("left", "right"), hand_shares(body), strict=True):
        hand = part > 0
        detail = ((skin / np.median(skin[hand], axis=0)) ** _CONTRAST).clip(*_TEXTURE_RANGE)
        detail = detail.mean(axis=1, keepdims=True) * (1 - _HUE_FRACTION) + _HUE_FRACTION * detail
        details.append((part, detail))
        forearm = joint_weights(body, side, "elbow") > 0.5
        both = [_tone(shot, light, some) for some in (hand, forearm)]
        seen.append(both[0])
        if both[0] is not None and both[1] is not None:
            covered |= float(np.linalg.norm(np.sqrt(both[0]) - np.sqrt(both[1]))) < SAME_COLOUR_DISTANCE
    tone = _skin_tone(face, [one for one in seen if one is not None], covered)
    if tone is None:
        return Hands(share, colour)
    for part, detail in details:
        share += part
        half = body.vertices[:, 0] * body.vertices[part > 0, 0].mean() > 0  # also beyond the wrist: colours are mixed
        colour[half] = (tone * detail)[half]
    shade = light.shade(shot.normals)
    usual = float(np.median(shade[face_vertices(body)]))
    return Hands(share, colour * shade.clip(_SHADES[0] * usual, _SHADES[1] * usual)[:, None])


def _tone(shot: FittedPicture, light: Lamp, some: NDArray[np.bool_]) -> F64 | None:
    """Return [3] the median unlit colour of the visible ones of ``some`` [V] vertices; None for too few of them."""
    seen = some & (shot.visibility > _MIN_VISIBILITY)
    return np.asarray(np.median(unlit(shot, light, seen), axis=0)) if seen.sum() > _MIN_VERTICES else None


def _skin_tone(face: F64 | None, hands: list[F64], covered: bool) -> F64 | None:
    """Return [3] the tone of both hands: their own, or the face's if shade darkens them.

    Hands of another hue than the face have it, below gloves or a painted face, if both agree and neither is
    ``covered`` by a sleeve.
    """
    if face is None:
        return None
    bare = [one for one in hands if likeness(one[None] * face.sum() / max(one.sum(), 1e-6), face[None])[0] > 0.5]
    if len(hands) == 2 and not bare and not covered and likeness(hands[0][None], hands[1][None])[0] > 0.5:
        return np.asarray(np.mean(hands, axis=0))
    near = [one for one in bare if one.sum() > _MIN_BRIGHTNESS * face.sum()]
    return np.asarray(np.mean(near, axis=0)) if near else face
