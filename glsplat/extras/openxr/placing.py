"""Place the avatar: in the mirror, facing its user, or as the user's own body.

Twin of the page's net/web/space/placing.js. The renderer draws the avatar in its user's place. ``shown`` transforms
the user's room to the shown room; an eye sees in the shown room what inverse(shown) of it would see in the user's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from glsplat.arrays import F64

ViewName = Literal["mirror", "facing", "own"]
VIEWS: tuple[ViewName, ...] = ("mirror", "facing", "own")
"""Views in the order of the button."""

MIRROR = {"distance": 1.2, "width": 1.1, "bottom": 0.05, "top": 2.05}
"""Mirror's distance from the user, width and heights, metres."""

FACING = 1.8
"""Metres from the user to the avatar."""


@dataclass(frozen=True, eq=False)
class Glass:
    """An upright mirror: its foot on the floor, and its level unit normal."""

    foot: F64  # [3]
    normal: F64  # [3]

    @property
    def right(self) -> F64:
        """Unit vector [3] to the right, as seen by its user."""
        return np.array([self.normal[2], 0.0, -self.normal[0]])


@dataclass(frozen=True, eq=False)
class Place:
    """A view, which stays in place until it is chosen again."""

    view: ViewName
    shown: F64  # [4, 4] the user's room to the shown room
    glass: Glass | None = None
    whole: bool = False  # in a room with others: show all that is in sight


def heading(head: F64) -> F64:
    """Return the level unit direction [3] in which a head [4, 4] looks; (0, 0, -1) if that is undefined."""
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
    """Return a view for a user whose head is at ``head`` (room from head, [4, 4]).

    With others in a ``room`` there are only the mirror and the own body.
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
        shown[0, 0] = shown[2, 2] = -1.0  # half a turn about the vertical through the pivot
        shown[:3, 3] = 2 * pivot[0], 0.0, 2 * pivot[2]
    return Place(view, shown)


def standing(head: F64) -> tuple[float, float, float, float]:
    """Return the pose of a space in which this head is over the origin and looks along +z: x, z, and y and w of its
    quaternion (docs/protocol.md, 2.1)."""
    ahead = heading(head)
    yaw = np.arctan2(ahead[0], ahead[2])
    return float(head[0, 3]), float(head[2, 3]), float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
