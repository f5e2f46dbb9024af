"""Where people stand in a room: on a circle, facing its centre, those who come first opposite each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.scene import similarity

__all__ = ["RADIUS", "free_seat", "place_at", "seat"]

RADIUS = 1.2
"""Metres from the centre at least: who stands opposite is at a talking distance."""

_ELBOW_ROOM = 1.0  # metres of the circle a person


def seat(number: int, seats: int) -> NDArray[np.float64]:
    """[4, 4] room from user: the user's origin on the circle, their +z towards its centre.

    >>> glsplat.extras.rooms.seats.seat(0, 2)[:3, 3].round(6).tolist()
    [0.0, 0.0, -1.2]
    """
    radius = max(RADIUS, seats * _ELBOW_ROOM / (2 * np.pi))
    angle = 2 * np.pi * number / seats
    return place_at(-radius * np.sin(angle), -radius * np.cos(angle), angle)


def place_at(x: float, z: float, turn: float) -> NDArray[np.float64]:
    """[4, 4] room from user: the origin at (x, 0, z) metres, turned by ``turn`` radians about y."""
    return similarity((x, 0, z), (0, np.sin(turn / 2), 0, np.cos(turn / 2)))


def free_seat(taken: set[int], seats: int) -> int:
    """The free one of ``seats`` numbers that is farthest from those taken; the lowest of several. One has to be free.

    >>> [glsplat.extras.rooms.seats.free_seat(set(taken), 8) for taken in ([], [0], [0, 4], [0, 4, 2])]
    [0, 4, 2, 6]
    """

    def room(number: int) -> int:
        steps = [(number - other) % seats for other in taken]
        return min((min(step, seats - step) for step in steps), default=seats)

    return max((number for number in range(seats) if number not in taken), key=lambda number: (room(number), -number))
