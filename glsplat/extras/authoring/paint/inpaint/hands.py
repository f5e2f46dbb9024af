"""Colour hands: the texture of nails, knuckles and palms in the skin's tone, or the tone of gloves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import joint_weights
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.skin_tone import face_colour, likeness, unlit
from glsplat.extras.authoring.paint.view_sample import FittedPicture, hand_shares
from glsplat.meshes import MeshPart
from glsplat.pictures import to_linear

F64 = NDArray[np.float64]

_MIN_VISIBILITY, _MIN_VERTICES = 0.3, 40
_MIN_SKIN_FRACTION = 0.5  # of a hand's visible vertices, for its tone
_MAX_SKIN_FRACTION = 0.15  # of the vertices of gloves, or of hands below a painted face
_TEXTURE_RANGE = 0.4, 1.8  # of the texture over its median
_HUE_FRACTION, _CONTRAST = 0.2, 1.7  # of the texture's own hue (red palms and knuckles), and exponent


@dataclass(frozen=True, eq=False)
class Hands:
    """Colours of bare hands or gloves; ``hands_of`` makes one."""

    share: F64  # [V] 0 on arms, 1 on hands
    colour: F64  # [V, 3] linear, in the face's light: hands turn as they are posed

    def over(self, points: SurfacePoints, linear: F64) -> F64:
        """Return ``linear`` colours [M, 3] with hands over them."""
        values = points.at(np.column_stack([self.share, self.colour]))
        return linear + values[:, :1] * (values[:, 1:] - linear)


def hands_of(body: Body, shot: FittedPicture, light: Lamp, texture: NDArray[np.uint8] | None = None) -> Hands:
    """Return the hands in the front ``shot``: in their own tone if it shows enough skin, else in the face's.

    ``texture`` [H, W, 3] is the open body's skin in sRGB; None: plain skin. Hands unlike the face have their own
    colour, as gloves do, only if both agree and are unlike the forearms; else a sleeve lies over them.
    """
    uv = np.zeros((len(body.vertices), 2))
    uv[body.faces.ravel()] = body.uv.reshape(-1, 2)
    picture = np.full((1, 1, 3), 255, np.uint8) if texture is None else texture
    opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
    skin = to_linear(MeshPart("", np.zeros((0, 3), np.int32), np.zeros((0, 3, 2)), opaque).sample(uv)[:, :3])
    share, colour = np.zeros(len(uv)), np.zeros((len(uv), 3))
    face = face_colour(body, shot, light)
    found = []
    for part in hand_shares(body):
        hand = part > 0
        detail = ((skin / np.median(skin[hand], axis=0)) ** _CONTRAST).clip(*_TEXTURE_RANGE)
        detail = detail.mean(axis=1, keepdims=True) * (1 - _HUE_FRACTION) + _HUE_FRACTION * detail
        seen = hand & (shot.visibility > _MIN_VISIBILITY)
        plain = unlit(shot, light, seen)
        like = np.zeros(0) if face is None or not len(plain) else likeness(plain / detail[seen], face[None])
        found.append((part, detail, seen, plain, like))
    bare = [
        np.median((plain / detail[seen])[like > 0.5], axis=0)
        for _, detail, seen, plain, like in found
        if len(like) > _MIN_VERTICES and like.mean() > _MIN_SKIN_FRACTION
    ]
    worn = [np.median(plain, axis=0) for *_, plain, _ in found if len(plain) > _MIN_VERTICES]
    alike = len(worn) == 2 and likeness(worn[0][None], worn[1][None])[0] > 0.5
    alike &= sum(like.sum() for *_, like in found) < _MAX_SKIN_FRACTION * sum(len(like) for *_, like in found)
    for side in ("left", "right"):
        forearm = (joint_weights(body, side, "elbow") > 0.5) & (shot.visibility > _MIN_VISIBILITY)
        if alike and forearm.sum() > _MIN_VERTICES:
            sleeve = np.median(unlit(shot, light, forearm), axis=0)
            alike &= likeness(np.mean(worn, axis=0)[None], sleeve[None])[0] < 0.5
    tone = np.mean(bare, axis=0) if bare else np.mean(worn, axis=0) if alike else face
    if tone is None:
        return Hands(share, colour)
    for part, detail, _, _, _ in found:
        share += part
        half = body.vertices[:, 0] * body.vertices[part > 0, 0].mean() > 0  # also beyond the wrist: colours are mixed
        colour[half] = (tone * detail)[half]
    return Hands(share, colour * np.median(light.shade(shot.normals[face_vertices(body)])))
