"""The people of a room at one moment, as one picture shows them, and their labels (docs/consent.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.skinning.pose import Pose

__all__ = ["Label", "RoomView", "VisiblePerson", "driven_by"]


@dataclass(frozen=True, slots=True, eq=False)
class VisiblePerson:
    """A person as a picture shows them."""

    key: int  # never used again in this room
    name: str
    avatar: str  # name of an offered one
    pose: Pose | None  # in the avatar's space; None: unknown yet, the person is not shown
    transform: NDArray[np.float64]  # [4, 4] room from avatar
    opacity: float = 1.0
    label: str = ""  # drawn near the head
    frame_id: int | None = None  # of the request that the pose comes from
    ahead: float = 0.0  # milliseconds by which the pose was extrapolated


@dataclass(frozen=True, slots=True, eq=False)
class RoomView:
    """All people of a room at one moment, for one viewer. The viewer's cameras are in the room's space."""

    room: str
    tick: int
    viewer: int  # key of the viewer
    people: tuple[VisiblePerson, ...]
    from_room: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))  # [4, 4] viewer's own space from room

    def fields(self) -> dict[str, Any]:
        """Return ``room`` of a reply: the people, their positions, and the request of each pose."""
        people = [
            {"name": one.name, "avatar": one.avatar, "you": one.key == self.viewer, "at": self._at(one)}
            | {"frame_id": one.frame_id, "ahead": one.ahead, "opacity": round(one.opacity, 3)}
            for one in self.people
        ]
        return {"name": self.room, "tick": self.tick, "people": people}

    def _at(self, one: VisiblePerson) -> list[float]:
        """Return [x, y, z] in metres in the viewer's space: the ground below the pelvis, or higher in a jump."""
        assert one.pose is not None  # people without a pose are not in the picture
        ground = self.from_room @ one.transform @ (*one.pose.trans, 1.0)
        return [round(float(v), 3) for v in ground[:3]]


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """Text over ``position`` [3] (metres), in every picture that shows any part of its thing."""

    text: str
    position: NDArray[np.float64]
    height: float = 0.045  # metres of a line, within limits of readable pixels (backends/lettering.py)
    opacity: float = 1.0
    box: Callable[[], NDArray[np.float64] | None] | None = None
    """Returns the thing's bounding box [2, 3], None for an empty thing. Without it the thing is ``position``."""


def driven_by(name: str, notice: str = "") -> str:
    """Return the label of a synthetic person whom ``name`` drives, with ``notice`` at its end."""
    return ", ".join([f"driven by {name or 'somebody'}", "synthetic", *([notice] if notice else [])])
