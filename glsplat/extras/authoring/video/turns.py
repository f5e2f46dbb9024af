"""Which way somebody faces in each of many pictures, from what the networks say of each and from their order.

A network tells the turn of shoulders and hips to some ten degrees, and now and then takes a back for a front; the
face's own network does not. Who turns on the spot goes on turning: of all even turns, to the left or to the right, that
is taken which agrees with most frames (Viterbi's way through 72 directions).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.networks.face import find_face
from glsplat.extras.authoring.networks.hand import find_hand
from glsplat.extras.authoring.networks.people import DetectedPerson, degrees_between, swap_sides
from glsplat.extras.authoring.networks.person import LANDMARKS

__all__ = ["facing_as", "facings"]

F64 = NDArray[np.float64]

_DIRECTIONS = 72
_DOUBT = 15.0  # degrees that the network is off
_MOST = 16.0  # squared doubts; what is farther off is a mistake of any size
_BACK_FOR_FRONT = 4.0  # squared doubts that this mistake costs
_FACE, _FACELESS = 0.9, 0.2  # presence of a face that is seen, and of none
_SHOWN, _HIDDEN = 110.0, 60.0  # degrees: a face is seen up to the one, and may be missing from the other on
_AGAINST_FACE, _AGAINST_NONE = 9.0, 2.0  # squared doubts; hair hides faces
_STEPS = np.concatenate([np.arange(-48.0, -2.9, 3.0), np.arange(3.0, 48.1, 3.0)])  # degrees a frame
_UNEVEN = 0.5, 6.0  # share of a step, and degrees, that steps differ by


def facings(people: Sequence[DetectedPerson], *, in_order: bool) -> F64:
    """[N] degrees, 0 to 360, that each person has turned to their own left from facing the camera.

    ``in_order``: the pictures follow each other in time, in steps of less than an eighth of a turn.
    """
    grid = np.arange(_DIRECTIONS) * 360.0 / _DIRECTIONS
    costs = np.stack([_costs(person, grid) for person in people])  # [N, 72]
    if in_order and len(people) > 2:
        best = min((_way(costs, grid, float(step)) for step in _STEPS), key=lambda found: found[0])[1]
    else:
        best = costs.argmin(axis=1)
    # within a grid's step of the way, as the network has it
    told = np.array([_told(person) for person in people])
    off = (told - grid[best] + 180) % 360 - 180
    return np.asarray((grid[best] + np.clip(off, -_DOUBT, _DOUBT) / 2) % 360)


def facing_as(picture: NDArray[np.uint8], person: DetectedPerson, turn: float) -> DetectedPerson:
    """The person as somebody who has turned by so many degrees: left and right put right, and the face found again."""
    told = _told(person)
    if degrees_between(told, turn) <= degrees_between(180.0 - told, turn) + _DOUBT:
        return person
    body = swap_sides(person.body)
    return DetectedPerson(
        body, find_face(picture, body), find_hand(picture, body, "left"), find_hand(picture, body, "right")
    )


def _told(person: DetectedPerson) -> float:
    """Degrees: the middle of what shoulders and hips say."""
    world = person.body.world
    across = np.zeros(2)
    for name in ("shoulder", "hip"):
        pair = world[LANDMARKS.index(f"left_{name}")] - world[LANDMARKS.index(f"right_{name}")]
        across += pair[[0, 2]] / max(float(np.hypot(pair[0], pair[2])), 1e-9)
    return float(np.degrees(np.arctan2(across[1], across[0])))


def _costs(person: DetectedPerson, grid: F64) -> F64:
    """[72] squared doubts that the person faces each way."""
    told = _told(person)
    off = np.minimum((degrees_between(grid, told) / _DOUBT) ** 2, _MOST)
    other = np.minimum((degrees_between(grid, 180.0 - told) / _DOUBT) ** 2, _MOST) + _BACK_FOR_FRONT
    cost = np.minimum(off, other)
    front = degrees_between(grid, 0.0)
    if person.face.presence > _FACE:
        cost = cost + _AGAINST_FACE * (front > _SHOWN)
    elif person.face.presence < _FACELESS:
        cost = cost + _AGAINST_NONE * (front < _HIDDEN)
    return np.asarray(cost)


def _way(costs: F64, grid: F64, step: float) -> tuple[float, NDArray[np.intp]]:
    """The cheapest way [N] through the directions in steps of about ``step`` degrees, and what it costs."""
    change = (grid[None] - grid[:, None] - step + 180) % 360 - 180  # [from, to]
    price = (change / (_UNEVEN[0] * abs(step) + _UNEVEN[1])) ** 2
    total, back = costs[0], []
    for row in costs[1:]:
        sums = total[:, None] + price
        back.append(sums.argmin(axis=0))
        total = sums.min(axis=0) + row
    way = [int(total.argmin())]
    for row in reversed(back):
        way.append(int(row[way[-1]]))
    return float(total.min()), np.array(way[::-1], np.intp)
