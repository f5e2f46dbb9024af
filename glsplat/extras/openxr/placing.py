"""Where the avatar is shown: in the mirror, facing its user, or as the user's own body.

As the page has it (net/web/space/placing.js). The renderer draws the avatar where its user is. ``shown`` takes that
room to the room as it is shown; an eye that looks at the shown room sees what inverse(shown) of it would see in the
user's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from glsplat.arrays import F64

ViewName = Literal["mirror", "facing", "own"]
VIEWS: tuple[ViewName, ...] = ("mirror", "facing", "own")
"""In the order in which a button goes through them."""

MIRROR = {"distance": 1.2, "width": 1.1, "bottom": 0.05, "top": 2.05}
"""Metres."""

FACING = 1.8
"""Metres from the user to the avatar."""


@dataclass(frozen=True, eq=False)
class Glass:
    """An upright mirror: its foot on the floor, and the level unit vector that it looks along."""

    foot: F64  # [3]
    normal: F64  # [3]

    @property
    def right(self) -> F64:
        """[3] unit, to the right as its user sees it."""
        return np.array([self.normal[2], 0.0, -self.normal[0]])


@dataclass(frozen=True, eq=False)
class Place:
    """A view: it stays where it is until it is chosen again."""

    view: ViewName
    shown: F64  # [4, 4] the user's room to the room as it is shown
    glass: Glass | None = None
    whole: bool = False  # of a room with others: all that is in sight


def heading(head: F64) -> F64:
    """[3] the level unit direction that a head [4, 4] looks in; 0, 0, -1 if it looks straight up or down."""
    back, up = head[:3, 2], head[:3, 1]
    level = np.array([-back[0], 0.0, -back[2]])
    if np.hypot(level[0], level[2]) > 0.1:
        return level / np.linalg.norm(level)
    sign = 1.0 if back[1] > 0 else -1.0  # looking down, the head's up is ahead; looking up, behind
    level = sign * np.array([up[0], 0.0, up[2]])
    if np.hypot(level[0], level[2]) > 0.1:
        return level / np.linalg.norm(level)
    return np.array([0.0, 0.0, -1.0])


def placing(view: ViewName, head: F64, room: bool = False) -> Place:
    """A view for a user whose head is at ``head`` (room from head, [4, 4]).

    With others in a ``room`` there are the mirror and the own body.
    """
    if room:
        return replace(placing("mirror" if view == "mirror" else "own", head), whole=True)
    ahead, ground = heading(head), np.array([head[0, 3], 0.0, head[2, 3]])
    shown = np.eye(4)
    if view == "mirror":
        glass = Glass(ground + MIRROR["distance"] * ahead, -ahead)
        shown[:3, :3] -= 2 * np.outer(glass.normal, glass.normal)
        shown[:3, 3] = 2 * (glass.foot @ glass.normal) * glass.normal
        return Place(view, shown, glass)
    if view == "facing":
        pivot = ground + FACING / 2 * ahead
        shown[0, 0] = shown[2, 2] = -1.0  # half a turn about the vertical through it
        shown[:3, 3] = 2 * pivot[0], 0.0, 2 * pivot[2]
    return Place(view, shown)


def standing(head: F64) -> tuple[float, float, float, float]:
    """x, z, and the y and w of a quaternion about the vertical: where a space has to be put for this head to be over
    its origin, looking along +z (docs/protocol.md, 2.1)."""
    ahead = heading(head)
    yaw = np.arctan2(ahead[0], ahead[2])
    return float(head[0, 3]), float(head[2, 3]), float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
