"""Blinks that end where the lids meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.extras.authoring.faces.openings import Opening
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import strongest_joint

__all__ = ["BACK", "BLINKS", "blink_of", "blink_that_shuts", "with_blink"]

F64 = NDArray[np.float64]

BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")
BACK = np.array([0.0, 0.0, -0.003])
"""Metres by which eyeballs give way to lids that close: as eyes do (Evinger, Shaw, Peck, Manning and Baker 1984)."""
_SHUT = 0.8  # of the opening's width, which has to be shut; lashes cover what is left in the corners
_OVER = 0.02  # of the shape, further: lids press


def blink_of(ball: Eyeball) -> str:
    """The expression that shuts an eye."""
    return BLINKS[EYES.index(ball.joint)]


def blink_that_shuts(mesh: RiggedMesh, eye: Opening) -> float:
    """The weight of eyeBlink at which the upper lid of an eye of the mesh meets the lower one.

    The open body's blink is made for its own eyes: in narrower ones the upper lid goes on over the cheek.
    """
    assert mesh.morphs is not None
    edges, moves = eye.edges, mesh.morphs.dense(blink_of(eye.ball), len(mesh.vertices))
    upper, lower = (moves[mesh.faces[face], 1].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
    opening = edges.upper_at[:, 1] - edges.lower_at[:, 1]
    return min(float(np.quantile(opening / np.maximum(lower - upper, 1e-4), _SHUT)) + _OVER, 1.0)


def with_blink(mesh: RiggedMesh, shares: Mapping[str, float]) -> RiggedMesh:
    """The mesh whose lids close by those shares of what they do, and whose eyeballs give way to them.

    Shapes are straight ways: half-way down a lid is where the front of the ball is.
    """
    morphs = mesh.morphs
    assert morphs is not None
    each = [shares.get(name, 1.0) for name in morphs.names]
    scaled = replace(morphs, offsets=morphs.offsets * np.repeat(each, np.diff(morphs.starts))[:, None])
    balls = {}
    used = np.unique(mesh.faces)
    strongest = strongest_joint(mesh.joints, mesh.weights)[used]
    for eye, name in zip(EYES, BLINKS, strict=True):
        ball = used[strongest == mesh.skeleton.names.index(eye)]
        balls[name] = ball, np.tile(BACK, (len(ball), 1))
    return replace(mesh, morphs=scaled.plus(balls))
