"""Make blinks that end where the lids meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.extras.authoring.faces.openings import Opening
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import strongest_joint

BLINK_SHAPES = ("eyeBlinkLeft", "eyeBlinkRight")
EYEBALL_RETREAT_M = np.array([0.0, 0.0, -0.003])
"""Movement of eyeballs as lids close, as real eyes have (Evinger, Shaw, Peck, Manning and Baker 1984)."""
_CLOSED_QUANTILE = 0.8  # of the opening's width that must be closed; lashes cover the corners
_PRESSURE = 0.02  # added to the shape's weight: lids press


def blink_shape_of(ball: Eyeball) -> str:
    """Return the expression that closes an eye."""
    return BLINK_SHAPES[EYES.index(ball.joint)]


def closing_weight(mesh: RiggedMesh, eye: Opening) -> float:
    """Return the weight of eyeBlink at which the upper lid of an eye of the mesh meets the lower one.

    The open body's blink fits its own eyes; in narrower ones the upper lid would move on over the cheek.
    """
    assert mesh.morphs is not None
    edges, moves = eye.edges, mesh.morphs.dense(blink_shape_of(eye.ball), len(mesh.vertices))
    upper, lower = (moves[mesh.faces[face], 1].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
    opening = edges.upper_at[:, 1] - edges.lower_at[:, 1]
    return min(float(np.quantile(opening / np.maximum(lower - upper, 1e-4), _CLOSED_QUANTILE)) + _PRESSURE, 1.0)


def with_blink(mesh: RiggedMesh, shares: Mapping[str, float]) -> RiggedMesh:
    """Return the mesh with blinks scaled by ``shares``, and eyeballs that retreat from closing lids.

    Shapes are linear: half-way down, a lid passes the front of the eyeball.
    """
    morphs = mesh.morphs
    assert morphs is not None
    weights = [shares.get(name, 1.0) for name in morphs.names]
    scaled_morphs = replace(morphs, offsets=morphs.offsets * np.repeat(weights, np.diff(morphs.starts))[:, None])
    balls = {}
    vertices = np.unique(mesh.faces)
    strongest = strongest_joint(mesh.joints, mesh.weights)[vertices]
    for eye, name in zip(EYES, BLINK_SHAPES, strict=True):
        ball = vertices[strongest == mesh.skeleton.names.index(eye)]
        balls[name] = ball, np.tile(EYEBALL_RETREAT_M, (len(ball), 1))
    return replace(mesh, morphs=scaled_morphs.plus(balls))
