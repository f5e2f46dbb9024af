"""The body cut into segments that may lie before each other in a picture."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["FOREARMS", "HANDS", "LAYERS", "half_width", "layer_of", "segments_of", "trunk_of", "twins_across"]

LAYERS = 3
"""Trunk with head and legs, left arm, right arm."""

FOREARMS = 2, 4
"""Of ``segments_of``, left and right."""

HANDS = ("wrist", "index", "middle", "pinky", "ring", "thumb")
_SIDES = ("left", "right")
_TRUNK = ("pelvis", "spine", "collar")
_WITH_TRUNK = 0.35  # share of the upper arm whose cloth is the trunk's


@lru_cache(maxsize=1)
def segments_of() -> NDArray[np.intp]:
    """[V] of the open body: 0 trunk, head and legs; 1, 2 the left arm above and below the elbow; 3, 4 the right."""
    body = open_body()
    segment = np.zeros(len(body.vertices), np.intp)
    for index, side in enumerate(_SIDES):
        lower = _held(body, side, "elbow", *HANDS)
        first, last = (body.joints[JOINT_NAMES.index(f"{side}_{name}")] for name in ("shoulder", "elbow"))
        along = (body.vertices - first) @ (last - first) / ((last - first) @ (last - first))
        upper = (_held(body, side, "shoulder", "elbow", *HANDS) > 0.5) & (along > _WITH_TRUNK)
        segment[upper] = 2 * index + 1
        segment[lower > 0.5] = 2 * index + 2
    return frozen(segment)


def layer_of(segment: NDArray[np.intp]) -> NDArray[np.intp]:
    """The layer of each segment, any shape; below zero stays so."""
    return np.where(segment < 0, segment, (segment + 1) // 2)


def trunk_of(body: Body) -> NDArray[np.bool_]:
    """[V] the vertices of chest, belly and hips."""
    return np.asarray(np.array([any(word in name for word in _TRUNK) for name in JOINT_NAMES])[body.part])


def half_width(vertices: NDArray[np.float64], trunk: NDArray[np.bool_]) -> NDArray[np.float64]:
    """[V] half the width of the ``trunk`` [V] at each vertex's height, metres; ``vertices`` [V, 3] in the zero pose."""
    rows = np.round(vertices[:, 1] / 0.03).astype(np.intp)
    rows -= rows.min()
    widest = np.zeros(rows.max() + 3)
    np.maximum.at(widest, rows[trunk] + 1, np.abs(vertices[trunk, 0]))
    smooth = (widest[:-2] + widest[1:-1] + widest[2:]) / 3
    return np.asarray(smooth[rows])


@lru_cache(maxsize=1)
def twins_across() -> NDArray[np.intp]:
    """[V] of the open body: the vertex nearest to each one's mirror image."""
    from scipy.spatial import cKDTree

    body = open_body()
    return frozen(np.asarray(cKDTree(body.vertices).query(body.vertices * (-1.0, 1.0, 1.0))[1], np.intp))


def _held(body: Body, side: str, *names: str) -> NDArray[np.float64]:
    """[V] how much of each vertex these joints of one side hold."""
    mine = np.array([joint.startswith(f"{side}_") and any(n in joint for n in names) for joint in JOINT_NAMES])
    return np.asarray((body.skin_weights * mine[body.skin_joints]).sum(axis=1))
