"""Colour the eyes and the mouth's inside, which have colours of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.open_face import mouth_lining
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.networks.face import EyeLook
from glsplat.extras.authoring.paint.eyes import eye_colours
from glsplat.extras.authoring.paint.head import vertices_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_srgb

F64 = NDArray[np.float64]

# sRGB; pictures of whole people do not show them: a lit tongue, the lining deep inside, and lips where none are visible
_TONGUE_RGB, _DEEP_LINING_RGB, _LIPS_RGB = (0.64, 0.34, 0.33), (0.10, 0.035, 0.035), (0.55, 0.30, 0.28)
_TONGUE_BACK_LIGHT, _TONGUE_UNDERSIDE_LIGHT = 0.3, 0.55  # of the light on its tip and on its top
_LINING_FADE_M = 0.014  # inwards from the lips' rim, until the lining is darkest
_RIM_LIGHT = 0.8  # of the lips'
_LIP_TURN_M = 0.005  # from the rim, where lips turn in
_VISIBLE_NORMAL_Z = 0.7  # lips that face ahead more than this are visible
_MIN_LIP_VISIBILITY = 0.3


@dataclass(frozen=True, eq=False)
class EyesAndMouth:
    """Colours of eyes and of the mouth's inside; ``eyes_and_mouth_of`` makes one."""

    body: Body
    front: FittedPicture
    looks: Mapping[str, EyeLook]  # by side
    lips: F64  # [3] sRGB
    tongue: NDArray[np.bool_]  # [V] of the open body
    normals: F64  # [V, 3] of the open body

    def over(self, rgb: F64, points: SurfacePoints) -> F64:
        """Return ``rgb`` [M, 3], sRGB, with the front's eye colours and with the mouth's inside."""
        rgb, lining, corners = rgb.copy(), mouth_lining(), points.corners
        tongue = self.tongue[corners[:, 0]]
        rgb[tongue] = self._tongue_colours(points.take(tongue))
        within = np.all(lining.inside[corners], axis=1)
        turned = np.all(lining.far[corners] < 2 * _LIP_TURN_M, axis=1) & ~within & ~tongue
        deep = (points.take(within).at(lining.far[:, None]) / _LINING_FADE_M).clip(0, 1) ** 0.5
        rgb[within] = _RIM_LIGHT * self.lips * (1 - deep) + np.array(_DEEP_LINING_RGB) * deep
        rgb[turned] += self._hidden_lip(points.take(turned)) * (self.lips - rgb[turned])
        if self.looks:
            eyes, colours = eye_colours(self.body, self.front, self.looks, points)
            rgb[eyes] = colours
        return rgb

    def _hidden_lip(self, points: SurfacePoints) -> F64:
        """Return [M, 1] the fraction of each point that is lip hidden by the other lip of a shut mouth."""
        ahead = points.directions(self.normals)[:, 2:]
        close = 1 - points.at(mouth_lining().far[:, None]) / _LIP_TURN_M
        return np.asarray(close.clip(0, 1) ** 0.5 * ((_VISIBLE_NORMAL_Z - ahead) / _VISIBLE_NORMAL_Z).clip(0, 1) ** 0.5)

    def _tongue_colours(self, points: SurfacePoints) -> F64:
        """Return [M, 3] sRGB of points on the tongue, darker towards the back and below."""
        far = self.body.vertices[self.tongue, 2]  # of all of it, whichever points are painted now
        back, front = far.min(), far.max()
        ahead = points.at(self.body.vertices[:, 2:])
        up = points.directions(self.normals)[:, 1:2]
        light = _TONGUE_BACK_LIGHT + (1 - _TONGUE_BACK_LIGHT) * ((ahead - back) / max(front - back, 1e-9)) ** 1.5
        shade = _TONGUE_UNDERSIDE_LIGHT + (1 - _TONGUE_UNDERSIDE_LIGHT) * (0.5 + 0.5 * up)
        return np.asarray(_TONGUE_RGB * light * shade)


def eyes_and_mouth_of(body: Body, front: FittedPicture, looks: Mapping[str, EyeLook]) -> EyesAndMouth:
    """Return the colours inside a ``body`` with the eyes ``looks``; without looks eyes keep their paint."""
    tongue = ~body.skin & ~vertices_of(body, *EYES)
    return EyesAndMouth(body, front, looks, _lip_colour(front), tongue, vertex_normals(body.vertices, body.faces))


def _lip_colour(front: FittedPicture) -> F64:
    """Return [3] sRGB of the picture's lips: of their brighter half, since between lips it is dark."""
    seen = np.flatnonzero(mouth_lining().lips & (front.visibility[: len(mouth_lining().lips)] > _MIN_LIP_VISIBILITY))
    if not len(seen):
        return np.array(_LIPS_RGB)
    shown = to_srgb(front.sample(front.view.pixels[seen], front.layer[seen]))
    light = shown.sum(axis=1)
    return np.asarray(np.median(shown[light >= np.median(light)], axis=0))
