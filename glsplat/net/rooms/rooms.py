"""Rooms: all rooms of a server, and the way into them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from glsplat.net.backend import AvatarInfo
from glsplat.net.options import RequestedOptions
from glsplat.net.rights import Thing
from glsplat.net.rooms.member import Member
from glsplat.net.rooms.room import Room, RoomError
from glsplat.net.rooms.seats import place_at
from glsplat.skinning.pose import Pose

__all__ = ["Rooms"]


class Rooms:
    """``seats`` by the names of the rooms. Clients enter these and no others; in ``furnished`` ones are things, too."""

    def __init__(self, seats: Mapping[str, int] | None = None, furnished: Collection[str] = ()) -> None:
        self._rooms = {name: Room(name, count) for name, count in (seats or {}).items()}
        self._furnished = frozenset(furnished)

    @property
    def names(self) -> tuple[str, ...]:
        """Of all rooms."""
        return tuple(self._rooms)

    def join(
        self,
        asked: RequestedOptions,
        shown: AvatarInfo,
        number: int,
        now: float,
        leave: Callable[[], None],
        notice: str = "",
    ) -> Member:
        """Return client ``number`` as a member of the room that it asks for: a newcomer, or whose token it has.

        ``notice`` stands over their head, beside the name. Raises RoomError.
        """
        room = self._rooms.get(asked.room or "")
        if room is None:
            raise RoomError("there is no such room here", 404)
        if shown.skeleton is None:
            raise RoomError("a room needs people: name an avatar with joints", 400)
        place = None if asked.place is None else place_at(*asked.place)
        person = room.join(asked.name, shown.name, now, asked.resume, place, leave, notice, number)
        return Member(room, person, Pose.zero(len(shown.skeleton)))

    def worn(self, names: Sequence[str]) -> set[str]:
        """The avatars of all who are in those."""
        return {avatar for name in names for avatar in self._rooms[name].worn()}

    def offer(self, now: float, names: Sequence[str]) -> list[dict[str, Any]]:
        """What /session says of those."""
        rooms = [self._rooms[name] for name in names]
        return [
            {"name": one.name, "people": one.count(now), "seats": one.seats, "scene": one.name in self._furnished}
            for one in rooms
        ]

    def status(self, now: float, sees: Callable[[Thing, str], bool]) -> list[dict[str, Any]]:
        """What /stats says of those that whoever asks ``sees``; ``people`` is null where their names are not seen."""
        seen = [room for name, room in self._rooms.items() if sees("room", name)]
        return [room.status(now) | ({} if sees("people", room.name) else {"people": None}) for room in seen]
