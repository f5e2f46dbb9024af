"""Splats that give back the photographs they were made from, and elsewhere the painted body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.making.optimize.compiled import available
from glsplat.making.paint.sharpen import sharpened
from glsplat.making.paint.shot import Shot
from glsplat.making.reconstruct.reconstructor import Options
from glsplat.making.texture import baked
from glsplat.making.texture.bake import Colours
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose

if TYPE_CHECKING:
    from glsplat.making.optimize.pictures import Picture

__all__ = ["sharp"]

_ROUNDS = 8  # of matching colours alone
_FIGURE = 1536  # pixels of the person's height that are looked at
_AGAIN = 5  # times that a round of all pictures shows photographs
_EDGE = 4  # pixels inside the outline, whose colours are mixed with the room's


def sharp(avatar: Avatar, mesh: RiggedMesh, colours: Colours, shots: Sequence[Shot], options: Options) -> Avatar:
    """The avatar fitted to ``shots``, and to ``mesh`` in those ``colours`` where they show nothing.

    All of the splats is fitted where numba is installed, their colours alone where it is not.
    """
    if not options.steps:
        return avatar
    if not available():
        options.progress("fitting colours", 0.0)
        return sharpened(avatar, shots, _ROUNDS)
    from glsplat.making.optimize.fit import FitConfig, fitted
    from glsplat.making.optimize.pictures import pictures_of

    options.progress("painting the body", 0.0)
    truth = baked(mesh, colours, options.texture)
    pictures = pictures_of(truth, options.seed, progress=options.progress)
    photographs = [_picture(avatar, shot) for shot in shots]
    pictures += photographs * max(1, _AGAIN // len(photographs))
    return fitted(avatar, pictures, options.seed, FitConfig(steps=options.steps), options.progress)


def _picture(avatar: Avatar, shot: Shot) -> Picture:
    """The photograph as a picture that counts inside the person only."""
    rows, columns = np.flatnonzero(shot.mask.any(axis=1)), np.flatnonzero(shot.mask.any(axis=0))
    scale = min(1.0, _FIGURE / (rows[-1] - rows[0] + 1))
    height, width = (round(side * scale) for side in shot.mask.shape)
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = shot.view.root, shot.view.pelvis - shot.view.root @ avatar.skeleton.joints[0]
    focal = shot.focal * scale
    box = [int(edge * scale) for edge in (rows[0], rows[-1] + 1, columns[0], columns[-1] + 1)]
    K = np.array([[focal, 0, width / 2 - box[2]], [0, focal, height / 2 - box[0]], [0, 0, 1]])
    part = slice(box[0], box[1]), slice(box[2], box[3])
    small = cv2.resize(shot.rgb, (width, height), interpolation=cv2.INTER_AREA)[part]
    mask = cv2.resize(shot.mask.astype(np.uint8) * 255, (width, height), interpolation=cv2.INTER_AREA)[part]
    inside, kernel = (mask == 255).astype(np.float32), np.ones((2 * _EDGE + 1,) * 2, np.uint8)
    trust = cv2.erode(inside, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    target = np.full((*mask.shape, 4), 255, np.uint8)
    target[:, :, :3] = small
    camera = Camera(view, K, mask.shape[1], mask.shape[0])
    from glsplat.making.optimize.pictures import Picture

    return Picture(camera, target, float(shot.view.pelvis[2]) / focal, Pose(shot.view.rotations), trust)
