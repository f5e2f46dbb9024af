"""Divide the body into segments that may hide each other in a picture."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64, frozen
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.skinning.smplx import JOINT_NAMES

LAYER_COUNT = 3
"""0 trunk with head and legs, 1 left arm, 2 right arm."""

FOREARMS = 2, 4
"""Values of ``arm_segments``, left and right."""

HANDS = ("wrist", "index", "middle", "pinky", "ring", "thumb")
"""Parts of the names of a hand's joints."""

_SLEEVE_START_FRACTION = 0.35  # of the upper arm, whose cloth above belongs to the trunk


@lru_cache(maxsize=1)
def arm_segments(body: Body) -> NDArray[np.intp]:
    """Return the segments [V]: 0 trunk, head and legs; 1, 2 the left arm above and below the elbow; 3, 4 the right."""
    segment = np.zeros(len(body.vertices), np.intp)
    for index, side in enumerate(("left", "right")):
        lower = joint_weights(body, side, "elbow", *HANDS)
        first, last = (body.joints[JOINT_NAMES.index(f"{side}_{name}")] for name in ("shoulder", "elbow"))
        along = (body.vertices - first) @ (last - first) / ((last - first) @ (last - first))
        upper = (joint_weights(body, side, "shoulder", "elbow", *HANDS) > 0.5) & (along > _SLEEVE_START_FRACTION)
        segment[upper] = 2 * index + 1
        segment[lower > 0.5] = 2 * index + 2
    return frozen(segment)


@lru_cache(maxsize=1)
def arm_layers(body: Body) -> NDArray[np.intp]:
    """Return the layer [V] of each vertex; see LAYER_COUNT."""
    return frozen(layer_of(arm_segments(body)))


def hand_weights(body: Body) -> F64:
    """Return [V] the weights of both hands' joints."""
    return np.asarray(sum(joint_weights(body, side, *HANDS) for side in ("left", "right")))


def forearms(body: Body) -> NDArray[np.bool_]:
    """Return a mask [V] of forearms and hands."""
    return np.isin(arm_segments(body), FOREARMS)


def layer_of(segment: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the layer of each segment, in any shape; negative values are kept."""
    return np.where(segment < 0, segment, (segment + 1) // 2)


def trunk_vertices(body: Body) -> NDArray[np.bool_]:
    """Return a mask [V] of the vertices of chest, belly and hips."""
    trunk = ("pelvis", "spine", "collar")
    return np.asarray(np.array([any(word in name for word in trunk) for name in JOINT_NAMES])[body.part])


def trunk_half_width(vertices: F64, trunk: NDArray[np.bool_]) -> F64:
    """Return half the width of the ``trunk`` [V] at each vertex's height [V], metres, in the zero pose."""
    rows = np.round(vertices[:, 1] / 0.03).astype(np.intp)
    rows -= rows.min()
    widest = np.zeros(rows.max() + 3)
    np.maximum.at(widest, rows[trunk] + 1, np.abs(vertices[trunk, 0]))
    smooth = (widest[:-2] + widest[1:-1] + widest[2:]) / 3
    return np.asarray(smooth[rows])


@lru_cache(maxsize=1)
def mirror_vertices() -> NDArray[np.intp]:
    """Return for each vertex of the open body [V] the vertex nearest to its mirror image."""
    body = open_body()
    return frozen(np.asarray(cKDTree(body.vertices).query(body.vertices * (-1.0, 1.0, 1.0))[1], np.intp))


def joint_weights(body: Body, side: str, *names: str) -> F64:
    """Return the total skinning weight [V] of the joints of a ``side`` whose names contain one of ``names``."""
    chosen = np.array([joint.startswith(f"{side}_") and any(n in joint for n in names) for joint in JOINT_NAMES])
    return np.asarray((body.skin_weights * chosen[body.skin_joints]).sum(axis=1))
