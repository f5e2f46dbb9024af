"""What a picture of a room shows: values on their way from the server to what draws, and to the client."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.net.codec.body import place_of
from glsplat.net.rooms.person import Person
from glsplat.skinning.pose import Pose

__all__ = ["RoomView", "VisiblePerson", "people_fields"]


@dataclass(frozen=True, slots=True, eq=False)
class VisiblePerson:
    """A person as a picture shows them."""

    key: int  # of the person, never used again in this room
    name: str
    avatar: str  # which of those the server offers
    pose: Pose | None  # in the avatar's space; None: nothing has come yet, nobody is shown
    transform: NDArray[np.float64]  # [4, 4] room from avatar
    opacity: float = 1.0
    label: str = ""  # drawn near the head
    frame_id: int | None = None  # of the request that the pose comes from
    ahead: float = 0.0  # milliseconds by which the pose was extrapolated


@dataclass(frozen=True, slots=True, eq=False)
class RoomView:
    """Everybody in a room at one moment, for one of them. The cameras of the request are in the room's space."""

    room: str
    tick: int
    viewer: int  # key of who looks
    people: tuple[VisiblePerson, ...]
    from_room: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))  # [4, 4], to the viewer's own space

    def fields(self) -> dict[str, Any]:
        """``room`` of a reply: who is in the picture, where, and which request each pose comes from."""
        people = [
            {"name": one.name, "avatar": one.avatar, "you": one.key == self.viewer, "at": self._at(one)}
            | {"frame_id": one.frame_id, "ahead": one.ahead, "opacity": round(one.opacity, 3)}
            for one in self.people
        ]
        return {"name": self.room, "tick": self.tick, "people": people}

    def _at(self, one: VisiblePerson) -> list[float]:
        """[x, y, z] metres: the ground under the middle of who stands, higher for who jumps."""
        assert one.pose is not None  # who has none is not in the picture
        ground = self.from_room @ one.transform @ (*one.pose.trans, 1.0)
        return [round(float(v), 3) for v in ground[:3]]


def people_fields(
    room: str, viewer: Person, people: Sequence[Person], hashes: Mapping[str, bytes | None]
) -> dict[str, Any]:
    """``room`` of a reply in poses: who is there, what to draw each from, and where the viewer's own space stands.

    And the token that brings the viewer back.
    """
    translation, rotation, _ = place_of(viewer.seat)
    told = [
        {"key": one.key, "name": one.name, "avatar": one.avatar, "you": one is viewer, "label": one.label}
        | {"sha256": None if (digest := hashes[one.avatar]) is None else digest.hex()}
        for one in people
    ]
    return {"name": room, "place": [*translation, *rotation], "people": told, "resume": viewer.resume}
