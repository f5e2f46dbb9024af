"""Colour hands that the picture hardly shows: the skin's tone with the texture of nails, knuckles and palms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import HANDS, joint_weights
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.skin_tone import face_colour, likeness, unlit
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import MeshPart
from glsplat.pictures import to_linear

F64 = NDArray[np.float64]

_MIN_VISIBILITY, _MIN_VERTICES = 0.3, 40
_MIN_SKIN_FRACTION, _MIN_KEPT_FRACTION = 0.5, 0.6  # of a hand's visible vertices, for its tone, and to keep its pixels
_MAX_GLOVE_SKIN_FRACTION, _MAX_GLOVE_SPREAD = 0.15, 0.45  # of gloves: visible skin, and deviation of log brightness
_WRIST = 0.5, 0.75  # skinning weights of the hand's joints: hands begin softly above the cut of the arm's rows
_RIM = 0.0, 0.002  # of the person's height: pixels nearer to an arm's outline are mixed with others
_TEXTURE_RANGE = 0.5, 1.6  # of the texture over its median
_HUE_FRACTION, _CONTRAST = 0.5, 1.4  # of the texture's own hue (red palms and knuckles), and exponent
_SHADE_EXPONENT = 0.5  # of light over the face's: hands turn as they are posed, and must not be black


@dataclass(frozen=True, eq=False)
class Hands:
    """Colours of bare hands or gloves; ``hands_of`` makes one."""

    share: F64  # [V] 0 on arms, 1 on hands
    colour: F64  # [V, 3] linear, unlit
    trust: F64  # [V] 1 where the picture's pixels like ``colour`` are kept, else 0
    usual_shade: float  # of the face

    def foreign(self, shot: FittedPicture, points: SurfacePoints, plain: F64) -> F64:
        """Return [M] from 0 to 1: how surely unlit linear colours [M, 3] of ``shot`` are not the hands'."""
        values = points.at(np.column_stack([self.share, self.share * self.trust, self.colour]))
        out = values[:, 0].copy()
        some = np.flatnonzero(values[:, 1] > 0)
        part = points.take(some)
        inside = shot.outline_distance(shot.project(part.at(shot.view.vertices)), shot.layers_at(part))
        out[some] -= values[some, 1] * likeness(plain[some], values[some, 2:]) * ramp(inside, *_RIM)
        return np.asarray(out.clip(0, 1))

    def over(self, points: SurfacePoints, guess: F64, shade: F64) -> F64:
        """Return linear colours ``guess`` [M, 3] with hands in a light of ``shade`` [M] over them."""
        values = points.at(np.column_stack([self.share, self.colour]))
        soft = self.usual_shade * (shade / self.usual_shade) ** _SHADE_EXPONENT
        return guess + values[:, :1] * (values[:, 1:] * soft[:, None] - guess)


def hands_of(body: Body, shot: FittedPicture, light: Lamp, texture: NDArray[np.uint8] | None = None) -> Hands:
    """Return the hands in the front ``shot``: in their own tone if it shows enough skin, else in the face's.

    ``texture`` [H, W, 3] is the open body's skin in sRGB; None: plain skin. Gloves are taken for gloves only if both
    hands agree; one alone is a sleeve.
    """
    uv = np.zeros((len(body.vertices), 2))
    uv[body.faces.ravel()] = body.uv.reshape(-1, 2)
    picture = np.full((1, 1, 3), 255, np.uint8) if texture is None else texture
    opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
    skin = to_linear(MeshPart("", np.zeros((0, 3), np.int32), np.zeros((0, 3, 2)), opaque).sample(uv)[:, :3])
    share, colour, trust = np.zeros(len(uv)), np.zeros((len(uv), 3)), np.zeros(len(uv))
    face = face_colour(body, shot, light)
    found = []
    for side in ("left", "right"):
        weight = joint_weights(body, side, *HANDS) * body.skin
        hand = weight > 0.5
        detail = ((skin / np.median(skin[hand], axis=0)) ** _CONTRAST).clip(*_TEXTURE_RANGE)
        detail = detail.mean(axis=1, keepdims=True) * (1 - _HUE_FRACTION) + _HUE_FRACTION * detail
        seen = hand & (shot.visibility > _MIN_VISIBILITY)
        plain = unlit(shot, light, seen)
        like = np.zeros(0) if face is None or not len(plain) else likeness(plain / detail[seen], face[None])
        found.append((weight, detail, seen, plain, like))
    gloves = all(
        len(like) > _MIN_VERTICES
        and like.mean() < _MAX_GLOVE_SKIN_FRACTION
        and np.log(plain + 0.01).std(axis=0).mean() < _MAX_GLOVE_SPREAD
        for _, _, _, plain, like in found
    )
    own = [
        np.median((plain / detail[seen])[like > 0.5], axis=0)
        for _, detail, seen, plain, like in found
        if len(like) > _MIN_VERTICES and like.mean() > _MIN_SKIN_FRACTION
    ]
    for weight, detail, _, plain, like in found:
        kept = len(like) > _MIN_VERTICES and like.mean() > _MIN_KEPT_FRACTION
        if gloves or (face is None and len(plain) > _MIN_VERTICES):
            tone, detail, kept = np.median(plain, axis=0), np.ones_like(detail), True
        elif own:
            tone = np.mean(own, axis=0)
        elif face is not None:
            tone = face
        else:
            continue
        part = ramp(weight, *_WRIST)
        share += part
        half = body.vertices[:, 0] * body.vertices[weight > 0, 0].mean() > 0  # also beyond the wrist: colours are mixed
        colour[half] = (tone * detail)[half]
        trust += (part > 0) * float(kept)
    shade = light.shade(shot.normals[face_vertices(body)])
    return Hands(share, colour, trust, float(np.median(shade)))
