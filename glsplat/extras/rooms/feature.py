"""Rooms in which clients meet, as a feature of a server."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from glsplat.camera import Camera
from glsplat.errors import PoseError
from glsplat.extras.rooms.person import Person, PoseSample
from glsplat.extras.rooms.room import Room, place_at
from glsplat.net.backend import Solved
from glsplat.net.client_stream import ClientStream
from glsplat.net.codec.body import PoseHistory, Poses
from glsplat.net.feature import Feature, ServerView
from glsplat.net.messages import Request
from glsplat.net.options import RequestedOptions, RoomError, ServerConfig
from glsplat.net.rights import User
from glsplat.net.room_view import RoomView
from glsplat.net.wire_schema import PictureOptions
from glsplat.skinning.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One client's person in its room; ``rest`` is the pose of requests without one."""

    room: Room
    person: Person
    rest: Pose

    @property
    def own_fields(self) -> dict[str, Any]:
        """``place`` and ``resume`` of the ``room`` in a reply."""
        return self.person.own_fields

    def solved(self, request: Request, solved: Solved, at: float) -> None:
        """Record the solution of tracking that arrived at ``at`` seconds. Raises PoseError if it cannot be drawn."""
        self.room.add_sample(self.person, self._sample(request, solved, at))

    def meeting(self, request: Request) -> Request:
        """Return a request with tracking, with the faces of the others for gaze.

        Without the arrival time: the room itself makes up for the lateness of others.
        """
        assert request.tracking is not None
        faces = self.room.faces(self.person, request.tracking.head)
        return replace(request, faces=(*request.faces, *faces), arrival=None)

    def received(self, request: Request, at: float) -> None:
        """Record a request that arrived at ``at`` seconds; its tracking is solved elsewhere, perhaps much later."""
        self.room.touch(self.person, at)
        if request.tracking is None:
            self.room.add_sample(self.person, self._sample(request, None, at))

    def options(self, request: Request) -> PictureOptions:
        """Return the picture options of a request in the room's space."""
        light = request.options.light
        if light is None:
            return request.options
        return replace(request.options, light=light.turned(self.person.seat[:3, :3]))

    def look(
        self, request: Request, cameras: Sequence[Camera], solved: Solved | None, at: float, now: float
    ) -> tuple[tuple[Camera, ...], RoomView]:
        """Return the ``cameras`` in the room's space and the view of everybody in it, at time ``now``.

        ``at`` is the arrival of the request in seconds. Raises PoseError for a solution that cannot be drawn.
        """
        return self.room.look(self.person, cameras, self._sample(request, solved, at), now)

    def poses(self, history: PoseHistory, sha256: Callable[[str], bytes | None], now: float) -> Poses:
        """Return the poses that changed since the client's last reply, by its ``history``."""
        return self.room.poses(self.person, history, sha256, now)

    def posed(self, count: int) -> None:
        """Count people skinned for a picture."""
        self.room.posed(count)

    def fair_cost(self, seconds: float) -> float:
        """Return the seconds charged to a viewer for a picture: the mean of this room."""
        return self.room.fair_cost(seconds)

    def end(self, goodbye: bool) -> None:
        """Handle the end of the connection; ``goodbye``: the client closed it on purpose."""
        if goodbye:
            self.room.leave(self.person)
        else:
            self.room.disconnect(self.person)

    def _sample(self, request: Request, solved: Solved | None, at: float) -> PoseSample:
        if solved is None:
            return PoseSample(self.rest if request.pose is None else request.pose, at, request.t, request.frame_id)
        if (found := len(solved.pose.rotations)) != len(self.rest.rotations):
            raise PoseError(f"the solver's pose has {found} joints, the avatar {len(self.rest.rotations)}")
        return PoseSample(solved.pose, at, request.t, request.frame_id, solved.scale, solved.floor)


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


def features(config: ServerConfig) -> list[Feature]:
    """Return the rooms that ``config`` names."""
    return [Rooms(config.rooms, config.furnished)] if config.rooms else []
