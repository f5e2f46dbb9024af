"""Blinks that end where the lids meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.faces.eyeballs import Eyeball
from glsplat.authoring.faces.openings import Opening
from glsplat.authoring.visibility import EYES
from glsplat.meshes import Morphs, RiggedMesh
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


def blink_that_shuts(mesh: RiggedMesh, eyes: Sequence[Opening]) -> float:
    """The weight of eyeBlink at which the upper lids of the mesh meet the lower ones; 1 without ``eyes``.

    The open body's blink is made for its own eyes: in narrower ones the upper lid goes on over the cheek.
    """
    assert mesh.morphs is not None
    found = []
    for ball, edges in eyes:
        moves = mesh.morphs.dense(blink_of(ball), len(mesh.vertices))
        upper, lower = (moves[mesh.faces[face], 1].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
        opening = edges.upper_at[:, 1] - edges.lower_at[:, 1]
        found.append(np.quantile(opening / np.maximum(lower - upper, 1e-4), _SHUT))
    return min(float(np.mean(found)) + _OVER, 1.0) if found else 1.0


def with_blink(mesh: RiggedMesh, shares: Mapping[str, float]) -> RiggedMesh:
    """The mesh whose lids close by those shares of what they do, and whose eyeballs give way to them.

    Shapes are straight ways: half-way down a lid is where the front of the ball is.
    """
    morphs = mesh.morphs
    assert morphs is not None
    each = [shares.get(name, 1.0) for name in morphs.names]
    scaled = morphs.offsets * np.repeat(each, np.diff(morphs.starts))[:, None]
    found: dict[str, list[tuple[NDArray[np.integer], F64]]] = {}
    for target, name in enumerate(morphs.names):
        part = slice(*morphs.starts[target : target + 2])
        found[name] = [(morphs.vertices[part], scaled[part])]
    used = np.unique(mesh.faces)
    strongest = strongest_joint(mesh.joints, mesh.weights)[used]
    for eye, name in zip(EYES, BLINKS, strict=True):
        ball = used[strongest == mesh.skeleton.names.index(eye)]
        found[name].append((ball, np.tile(BACK, (len(ball), 1))))
    return replace(mesh, morphs=Morphs.of(found))
