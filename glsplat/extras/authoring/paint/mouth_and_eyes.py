"""What has colours of its own: eyes, and the mouth's inside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.mouth_lining import mouth_lining
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.eyes import EyeLook
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.eyes import eye_colours
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_srgb
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Inside", "inside_of"]

F64 = NDArray[np.float64]

_EYES = [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")]
# sRGB, which pictures of whole people do not show: a tongue where light falls on it, the mouth's lining deep inside,
# and lips where nobody sees any
_TONGUE, _DEEP, _LIPS = (0.64, 0.34, 0.33), (0.10, 0.035, 0.035), (0.55, 0.30, 0.28)
_BACK, _UNDER = 0.3, 0.55  # share of light at the back of the tongue, and below it
_WITHIN = 0.014  # metres from the lips' rim, over which the lining becomes as dark as it is
_SHADED = 0.8  # of the lips' light, at their rim
_TURNED = 0.005  # metres from the rim, over which lips turn in
_AHEAD = 0.7  # of a normal: what looks ahead so far is seen
_SEEN = 0.3  # trust in a vertex's colour above which it tells of lips


@dataclass(frozen=True, eq=False)
class Inside:
    """The colours of what no picture of the outside shows; ``inside_of`` makes one."""

    body: Body
    front: FittedPicture
    looks: Mapping[str, EyeLook]  # the eyes in it
    lips: F64  # [3] their colour, sRGB
    tongue: NDArray[np.bool_]  # [V] of the open body
    normals: F64  # [V, 3] of the open body

    def over(self, rgb: F64, points: SurfacePoints) -> F64:
        """``rgb`` [M, 3] in sRGB with eyes as they look in the front, and with the mouth's inside."""
        rgb, lining, corners = rgb.copy(), mouth_lining(), points.corners
        tongue = self.tongue[corners[:, 0]]
        rgb[tongue] = self._tongue(points.take(tongue))
        within = np.all(lining.inside[corners], axis=1)
        turned = np.all(lining.far[corners] < 2 * _TURNED, axis=1) & ~within & ~tongue
        deep = (points.take(within).at(lining.far[:, None]) / _WITHIN).clip(0, 1) ** 0.5
        rgb[within] = _SHADED * self.lips * (1 - deep) + np.array(_DEEP) * deep
        rgb[turned] += self._inwards(points.take(turned)) * (self.lips - rgb[turned])
        if self.looks:
            eyes, colours = eye_colours(self.body, self.front, self.looks, points)
            rgb[eyes] = colours
        return rgb

    def _inwards(self, points: SurfacePoints) -> F64:
        """[M, 1] by how much points about a mouth that is shut are of lips that meet, which no picture shows."""
        ahead = points.directions(self.normals)[:, 2:]
        close = 1 - points.at(mouth_lining().far[:, None]) / _TURNED
        return np.asarray(close.clip(0, 1) ** 0.5 * ((_AHEAD - ahead) / _AHEAD).clip(0, 1) ** 0.5)

    def _tongue(self, points: SurfacePoints) -> F64:
        """[M, 3] of points on the tongue: darker towards the back, and below."""
        far = self.body.vertices[self.tongue, 2]  # of all of it, whichever points are painted now
        back, front = far.min(), far.max()
        ahead = points.at(self.body.vertices[:, 2:])
        up = points.directions(self.normals)[:, 1:2]
        light = _BACK + (1 - _BACK) * ((ahead - back) / max(front - back, 1e-9)) ** 1.5
        return np.asarray(_TONGUE * light * (_UNDER + (1 - _UNDER) * (0.5 + 0.5 * up)))


def inside_of(body: Body, front: FittedPicture, looks: Mapping[str, EyeLook]) -> Inside:
    """What is inside a ``body`` whose ``front`` shows eyes with these ``looks``, none where these stay as painted."""
    tongue = ~body.skin & ~np.isin(body.part, _EYES)
    return Inside(body, front, looks, _lips(front), tongue, vertex_normals(body.vertices, body.faces))


def _lips(front: FittedPicture) -> F64:
    """[3] the colour of the lips that the picture shows: of their fairer half, since between them it is dark."""
    seen = np.flatnonzero(mouth_lining().lips & (front.trust[: len(mouth_lining().lips)] > _SEEN))
    if not len(seen):
        return np.array(_LIPS)
    shown = to_srgb(front.sample(front.view.pixels[seen], front.layer[seen]))
    light = shown.sum(axis=1)
    return np.asarray(np.median(shown[light >= np.median(light)], axis=0))
