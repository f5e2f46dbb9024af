"""Estimate the facing direction in each of many pictures of a turning person.

The body network measures the turn of shoulders and hips to about ten degrees, and sometimes mistakes a back for a
front; the face network does not. A person turns evenly: of all even turns to the left or right, the one that agrees
with most frames is chosen (Viterbi path through 72 directions).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.networks.face import find_face
from glsplat.extras.authoring.networks.people import DetectedPerson, degrees_between, find_hand, swap_sides
from glsplat.extras.authoring.networks.person import LANDMARKS

_DIRECTIONS = 72
_SIGMA_DEG = 15.0  # of the network's error; costs are squared errors in sigmas
_MAX_COST = 16.0  # of an outlier of any size
_FLIP_COST = 4.0  # of a back taken for a front
_MIN_FACE, _MAX_FACELESS = 0.9, 0.2  # presence of a visible face, and of none
_FACE_UP_TO_DEG, _FACELESS_FROM_DEG = 110.0, 60.0  # turns that show a face, and that may hide it
_FACE_COST, _FACELESS_COST = 9.0, 2.0  # of a contradiction to these; hair hides faces
_STEPS_DEG = np.concatenate([np.arange(-48.0, -2.9, 3.0), np.arange(3.0, 48.1, 3.0)])  # between frames
_STEP_TOLERANCE = 0.5, 6.0  # sigma of steps: fraction of a step, plus degrees


def facings(people: Sequence[DetectedPerson], *, in_order: bool) -> F64:
    """Return the turn of each person [N], 0 to 360 degrees to their own left from facing the camera.

    ``in_order``: the pictures follow each other in time, in steps of less than an eighth of a turn.
    """
    grid = np.arange(_DIRECTIONS) * 360.0 / _DIRECTIONS
    costs = np.stack([_costs(person, grid) for person in people])  # [N, 72]
    if in_order and len(people) > 2:
        best = min((_path(costs, grid, float(step)) for step in _STEPS_DEG), key=lambda found: found[0])[1]
    else:
        best = costs.argmin(axis=1)
    # pulled towards the measurements, at most half a sigma off the path
    measured = np.array([_measured_turn(person) for person in people])
    off = (measured - grid[best] + 180) % 360 - 180
    return np.asarray((grid[best] + np.clip(off, -_SIGMA_DEG, _SIGMA_DEG) / 2) % 360)


def facing_as(picture: NDArray[np.uint8], person: DetectedPerson, turn: float) -> DetectedPerson:
    """Return the person for a known turn, degrees: swaps left and right if they disagree, and finds the face again."""
    measured = _measured_turn(person)
    if degrees_between(measured, turn) <= degrees_between(180.0 - measured, turn) + _SIGMA_DEG:
        return person
    body = swap_sides(person.body)
    return DetectedPerson(
        body, find_face(picture, body), find_hand(picture, body, "left"), find_hand(picture, body, "right")
    )


def _measured_turn(person: DetectedPerson) -> float:
    """Return the mean turn of shoulders and hips, degrees."""
    world = person.body.world
    across = np.zeros(2)
    for name in ("shoulder", "hip"):
        pair = world[LANDMARKS.index(f"left_{name}")] - world[LANDMARKS.index(f"right_{name}")]
        across += pair[[0, 2]] / max(float(np.hypot(pair[0], pair[2])), 1e-9)
    return float(np.degrees(np.arctan2(across[1], across[0])))


def _costs(person: DetectedPerson, grid: F64) -> F64:
    """Return the cost [72] of each facing direction."""
    measured = _measured_turn(person)
    off = np.minimum((degrees_between(grid, measured) / _SIGMA_DEG) ** 2, _MAX_COST)
    other = np.minimum((degrees_between(grid, 180.0 - measured) / _SIGMA_DEG) ** 2, _MAX_COST) + _FLIP_COST
    cost = np.minimum(off, other)
    front = degrees_between(grid, 0.0)
    if person.face.presence > _MIN_FACE:
        cost = cost + _FACE_COST * (front > _FACE_UP_TO_DEG)
    elif person.face.presence < _MAX_FACELESS:
        cost = cost + _FACELESS_COST * (front < _FACELESS_FROM_DEG)
    return np.asarray(cost)


def _path(costs: F64, grid: F64, step: float) -> tuple[float, NDArray[np.intp]]:
    """Return the cost of the cheapest path through the directions, in steps of about ``step`` degrees, and the path."""
    change = (grid[None] - grid[:, None] - step + 180) % 360 - 180  # [from, to]
    price = (change / (_STEP_TOLERANCE[0] * abs(step) + _STEP_TOLERANCE[1])) ** 2
    total, back = costs[0], []
    for row in costs[1:]:
        sums = total[:, None] + price
        back.append(sums.argmin(axis=0))
        total = sums.min(axis=0) + row
    path = [int(total.argmin())]
    for row in reversed(back):
        path.append(int(row[path[-1]]))
    return float(total.min()), np.array(path[::-1], np.intp)
