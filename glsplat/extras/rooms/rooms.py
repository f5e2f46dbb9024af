"""Rooms: the rooms of a server as a feature."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from glsplat.extras.rooms.member import Member
from glsplat.extras.rooms.room import Room
from glsplat.extras.rooms.seats import place_at
from glsplat.net.client_stream import ClientStream
from glsplat.net.feature import Feature, ServerView
from glsplat.net.options import RequestedOptions, RoomError
from glsplat.skinning.pose import Pose

if TYPE_CHECKING:
    from glsplat.net.rights import User


class Rooms(Feature):
    """Rooms by name with their number of ``seats``; those in ``furnished`` show the server's scene."""

    def __init__(self, seats: Mapping[str, int], furnished: Collection[str] = ()) -> None:
        self._rooms = {name: Room(name, count) for name, count in seats.items()}
        self._furnished = frozenset(furnished)

    async def start(self, server: ServerView) -> None:
        """Use the server's clock and rights."""
        self._server = server

    def query(self, query: Mapping[str, str], user: User | None) -> Mapping[str, str]:
        """Choose an avatar that nobody wears for a client that enters a room without naming one.

        Those of the default's joints are considered, the default first. Who comes back keeps the avatar.
        """
        room = self._rooms.get(query.get("room", ""))
        if room is None or "avatar" in query:
            return query
        catalogue = self._server.catalogue
        offered = [catalogue[name] for name in self._server.gate.rights.drivable(user, catalogue.names)]
        rigs = {one.name: None if one.skeleton is None else one.skeleton.names for one in offered}
        alike = [name for name in rigs if rigs[name] == rigs[offered[0].name]]
        return {**query, "avatar": room.avatar_for(query.get("resume", ""), alike)} if alike else query

    def client_opened(self, client: ClientStream, asked: RequestedOptions) -> None:
        """Let a client enter the room that it asks for, new or by its token. Raises RoomError."""
        if asked.room is None:
            return
        room = self._rooms.get(asked.room)
        if room is None:
            raise RoomError("no such room on this server", 404)
        shown = client.shown
        if shown.skeleton is None:
            raise RoomError("a room needs people: name an avatar with joints", 400)
        place = None if asked.place is None else place_at(*asked.place)
        leave = partial(self._server.close_client, client.number, "connected anew elsewhere")
        now = self._server.clock()
        person = room.join(
            *(asked.name, shown.name, now, asked.resume, place, leave, client.notice(), client.number),
            skeleton=shown.skeleton,
        )
        client.enter(asked.room, Member(room, person, Pose.zero(len(shown.skeleton))), person.name)

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Remove the client's person, at once after a goodbye, else after a while."""
        if isinstance(client.member, Member):
            client.member.end(goodbye)

    def stats(self, user: User | None) -> Mapping[str, Any]:
        """Return ``rooms`` of /stats: those that the account sees; ``people`` is null where names are hidden."""
        sees, now = partial(self._server.gate.rights.sees, user), self._server.clock()
        seen = [room for name, room in self._rooms.items() if sees("room", name)]
        return {"rooms": [r.status(now) | ({} if sees("people", r.name) else {"people": None}) for r in seen]}

    def session(self, user: User | None) -> Mapping[str, Any]:
        """Return ``rooms`` of /session: those that the account may enter."""
        now = self._server.clock()
        return {
            "rooms": [
                {"name": one.name, "people": one.count(now), "seats": one.seats, "scene": one.name in self._furnished}
                for one in self._enterable(user)
            ]
        }

    def worn_avatars(self, user: User | None) -> set[str]:
        """Return the avatars of the people in the rooms that an account may enter."""
        return {avatar for room in self._enterable(user) for avatar in room.worn()}

    def _enterable(self, user: User | None) -> list[Room]:
        return [self._rooms[name] for name in self._server.gate.rights.enterable(user, tuple(self._rooms))]
