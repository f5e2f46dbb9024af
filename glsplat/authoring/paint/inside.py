"""What has colours of its own: eyes, and the mouth's inside."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.fit.body import Body
from glsplat.authoring.fit.eyes import EyeLook
from glsplat.authoring.paint.eyes import eye_colours
from glsplat.authoring.paint.shot import FittedPicture, SurfacePoints
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["with_inside"]

F64 = NDArray[np.float64]

_EYES = [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")]
_MOUTH = (0.30, 0.12, 0.11)  # sRGB of its inside, which pictures of whole people do not show


def with_inside(body: Body, front: FittedPicture, looks: Mapping[str, EyeLook], points: SurfacePoints, rgb: F64) -> F64:
    """``rgb`` [M, 3] in sRGB with eyes as they look in the ``front``, and with the mouth's inside."""
    rgb = rgb.copy()
    rgb[(~body.skin & ~np.isin(body.part, _EYES))[points.corners[:, 0]]] = _MOUTH
    if looks:
        eyes, colours = eye_colours(body, front, looks, points)
        rgb[eyes] = colours
    return rgb
