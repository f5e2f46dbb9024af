"""Seats of a room: on a circle, facing its centre, the first two opposite each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.scene import similarity

RADIUS = 1.2
"""Least radius of the circle in metres: people who stand opposite are at a talking distance."""

_ARC_PER_PERSON_M = 1.0


def seat(number: int, seats: int) -> NDArray[np.float64]:
    """Return room from user [4, 4]: the user's origin on the circle, their +z towards its centre.

    >>> glsplat.extras.rooms.seats.seat(0, 2)[:3, 3].round(6).tolist()
    [0.0, 0.0, -1.2]
    """
    radius = max(RADIUS, seats * _ARC_PER_PERSON_M / (2 * np.pi))
    angle = 2 * np.pi * number / seats
    return place_at(-radius * np.sin(angle), -radius * np.cos(angle), angle)


def place_at(x: float, z: float, turn: float) -> NDArray[np.float64]:
    """Return room from user [4, 4]: the origin at (x, 0, z) metres, turned by ``turn`` radians about y."""
    return similarity((x, 0, z), (0, np.sin(turn / 2), 0, np.cos(turn / 2)))


def free_seat(taken: set[int], seats: int) -> int:
    """Return the free seat farthest from those taken; the lowest of several. One has to be free.

    >>> [glsplat.extras.rooms.seats.free_seat(set(taken), 8) for taken in ([], [0], [0, 4], [0, 4, 2])]
    [0, 4, 2, 6]
    """

    def distance(number: int) -> int:
        steps = [(number - other) % seats for other in taken]
        return min((min(step, seats - step) for step in steps), default=seats)

    free = (number for number in range(seats) if number not in taken)
    return max(free, key=lambda number: (distance(number), -number))
