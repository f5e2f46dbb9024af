"""Rooms: the rooms of a server as a feature."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from glsplat.extras.rooms.member import Member
from glsplat.extras.rooms.room import Room
from glsplat.extras.rooms.seats import place_at
from glsplat.net.backend import AvatarInfo
from glsplat.net.client_stream import ClientStream
from glsplat.net.feature import Feature, ServerView
from glsplat.net.options import RequestedOptions, RoomError
from glsplat.net.rights import Thing
from glsplat.skinning.pose import Pose

if TYPE_CHECKING:
    from glsplat.net.rights import User

__all__ = ["Rooms"]


class Rooms(Feature):
    """Rooms by name with their number of ``seats``; those in ``furnished`` show the server's scene."""

    def __init__(self, seats: Mapping[str, int] | None = None, furnished: Collection[str] = ()) -> None:
        self._rooms = {name: Room(name, count) for name, count in (seats or {}).items()}
        self._furnished = frozenset(furnished)

    async def start(self, server: ServerView) -> None:
        """Use the server's clock and rights."""
        self._server = server

    def client_opened(self, client: ClientStream, asked: RequestedOptions) -> None:
        """Let a client that asks for a room enter it. Raises RoomError."""
        if asked.room is None:
            return
        end = partial(self._server.close_client, client.number, "connected anew elsewhere")
        member = self.join(asked, client.shown, client.number, self._server.clock(), end, client.notice())
        client.enter(asked.room, member, member.person.name)

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Remove the client's person, at once after a goodbye, else after a while."""
        if isinstance(client.member, Member):
            client.member.end(goodbye)

    def stats(self, user: User | None) -> Mapping[str, Any]:
        """Return ``rooms`` of /stats."""
        return {"rooms": self.status(self._server.clock(), partial(self._server.gate.rights.sees, user))}

    def session(self, user: User | None) -> Mapping[str, Any]:
        """Return ``rooms`` of /session."""
        return {"rooms": self.offer(self._server.clock(), self._enterable(user))}

    def worn_avatars(self, user: User | None) -> set[str]:
        """Return the avatars of the people in the rooms that an account may enter."""
        return self.worn(self._enterable(user))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all rooms."""
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
        """Return client ``number`` as a member of the room that it asks for, new or by its token. Raises RoomError.

        ``notice`` is shown over the head, beside the name.
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
        """Return the avatars of all people in the named rooms."""
        return {avatar for name in names for avatar in self._rooms[name].worn()}

    def offer(self, now: float, names: Sequence[str]) -> list[dict[str, Any]]:
        """Return the named rooms for /session."""
        rooms = [self._rooms[name] for name in names]
        return [
            {"name": one.name, "people": one.count(now), "seats": one.seats, "scene": one.name in self._furnished}
            for one in rooms
        ]

    def status(self, now: float, sees: Callable[[Thing, str], bool]) -> list[dict[str, Any]]:
        """Return the rooms that a user ``sees``, for /stats; ``people`` is null where names are hidden."""
        seen = [room for name, room in self._rooms.items() if sees("room", name)]
        return [room.status(now) | ({} if sees("people", room.name) else {"people": None}) for room in seen]

    def _enterable(self, user: User | None) -> tuple[str, ...]:
        return self._server.gate.rights.enterable(user, self.names)
