"""The people of a room at one moment, as one picture shows them, and the words about them (docs/consent.md)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.skinning.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class VisiblePerson:
    """A person as a picture shows them."""

    key: int  # never used again in this room
    name: str
    avatar: str  # name of an offered one
    pose: Pose | None  # in the avatar's space; None: unknown yet, the person is not shown
    transform: NDArray[np.float64]  # [4, 4] room from avatar
    opacity: float = 1.0
    notice: str = ""  # that has to be shown with the person; "": none
    frame_id: int | None = None  # of the request that the pose comes from
    ahead: float = 0.0  # milliseconds by which the pose was extrapolated
    head: NDArray[np.float64] | None = None  # [3] joint of the head in the avatar's space; None: unknown


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
            | {"head": None if one.head is None else self._place(one, one.head)}
            | {"label": driven_by([one.name], one.notice)}
            for one in self.people
        ]
        return {"name": self.room, "tick": self.tick, "people": people}

    def words(self, label: bool) -> str:
        """Return the text for the picture: the notices of all people in it and, with ``label``, who drives them."""
        people = [one for one in self.people if one.opacity > 0]
        notice = ", ".join(dict.fromkeys(one.notice for one in people if one.notice))
        return driven_by([one.name for one in people], notice) if label and people else notice

    def _at(self, one: VisiblePerson) -> list[float]:
        """Return [x, y, z] in metres in the viewer's space: the ground below the pelvis, or higher in a jump."""
        assert one.pose is not None  # people without a pose are not in the picture
        return self._place(one, one.pose.trans)

    def _place(self, one: VisiblePerson, point: NDArray[np.float64]) -> list[float]:
        """Return a point of a person's own space in the viewer's, in metres rounded to millimetres."""
        placed = self.from_room @ one.transform @ (*point, 1.0)
        return [round(float(v), 3) for v in placed[:3]]


def driven_by(names: Iterable[str], notice: str = "") -> str:
    """Return the label of synthetic people whom ``names`` drive, with ``notice`` at its end."""
    drivers = ", ".join(name or "somebody" for name in names)
    return ", ".join([f"driven by {drivers}", "synthetic", *([notice] if notice else [])])
