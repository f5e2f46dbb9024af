"""Fit splats to the photographs they were made from, and elsewhere to the painted body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.extras.authoring.compute.compiled import available
from glsplat.extras.authoring.optimize.colour_fit import fit_colours
from glsplat.extras.authoring.paint.bake import Colours, bake
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose

if TYPE_CHECKING:
    from glsplat.extras.authoring.optimize.target_pictures import TargetPicture

_COLOUR_ROUNDS = 8  # where colours alone are fitted
_PERSON_HEIGHT_PX = 1536  # in the resampled photographs
_PHOTO_REPEATS = 5  # photographs in each pass over all pictures
_BODY_PX = 512  # side of the pictures of the painted body
_TEXTURE_PX = 1024  # side of its texture
_UNUSED_TRUST = 0.01  # of pixels that are not painted; see ``FittedPicture.unused``
_EDGE_PX = 4  # inside the outline, where colours are mixed with the background


def fitted_to_photos(
    avatar: Avatar,
    mesh: RiggedMesh,
    colours: Colours,
    shots: Sequence[FittedPicture],
    seed: int,
    steps: int,
    progress: Callable[[str, float], None],
) -> Avatar:
    """Return the avatar fitted to ``shots`` and, where they show nothing, to ``mesh`` in ``colours``.

    Without numba only colours are fitted.
    """
    if not steps:
        return avatar
    if not available():
        progress("fitting colours", 0.0)
        return fit_colours(avatar, shots, _COLOUR_ROUNDS)
    from glsplat.extras.authoring.optimize.splat_fit import FitConfig, fitted
    from glsplat.extras.authoring.optimize.target_pictures import ViewConfig, pictures_of

    progress("painting the body", 0.0)
    truth = bake(mesh, colours, _TEXTURE_PX)
    pictures = pictures_of(truth, seed, ViewConfig(size=_BODY_PX, supersample=2), progress=progress)
    photographs = [_picture(avatar, shot) for shot in shots]
    pictures += photographs * max(1, _PHOTO_REPEATS // len(photographs))
    return fitted(avatar, pictures, seed, FitConfig(steps=steps), progress)


def _picture(avatar: Avatar, shot: FittedPicture) -> TargetPicture:
    """Return the photograph as a target that is trusted inside the person only."""
    from glsplat.extras.authoring.optimize.target_pictures import TargetPicture

    camera = shot.camera(avatar.skeleton.joints[0], _PERSON_HEIGHT_PX)
    small, mask = shot.resized(camera)
    top, left, high, wide = (int(n) for n in _box(mask))
    part = slice(top, top + high), slice(left, left + wide)
    K = camera.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
    kernel = np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)
    trust = cv2.erode(mask[part].astype(np.float32), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    trust[shot.unused_pixels(camera)[part]] *= _UNUSED_TRUST
    target = np.full((*trust.shape, 4), 255, np.uint8)
    target[:, :, :3] = small[part]
    share = float(shot.view.pelvis[2]) / float(K[0, 0])
    return TargetPicture(Camera(camera.viewmat, K, wide, high), target, share, Pose(shot.view.rotations), trust)


def _box(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the first row and column of the person, and the number of rows and columns."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return rows[0], columns[0], rows[-1] - rows[0] + 1, columns[-1] - columns[0] + 1
