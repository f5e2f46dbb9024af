"""Member: a client in a room. Turns what it sends into where its person is, and what it asks for into its view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from glsplat.camera import Camera
from glsplat.errors import PoseError
from glsplat.extras.rooms.person import Moved, Person
from glsplat.extras.rooms.room import Room
from glsplat.net.backend import Solved
from glsplat.net.codec.body import PoseHistory, Poses
from glsplat.net.messages import Request
from glsplat.net.room_view import RoomView
from glsplat.net.wire_schema import PictureOptions
from glsplat.skinning.pose import Pose

__all__ = ["Member"]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One client's person in its room, in the pose ``rest`` where requests say none."""

    room: Room
    person: Person
    rest: Pose

    @property
    def resume(self) -> str:
        """The token by which the person comes back on another connection."""
        return self.person.resume

    def solved(self, request: Request, solved: Solved, at: float) -> None:
        """Tracking that came ``at`` seconds was solved. Raises PoseError for what the others cannot be shown."""
        self.room.moved(self.person, self._moved(request, solved, at))

    def meeting(self, request: Request) -> Request:
        """A request with tracking, and in it where the others' faces are.

        Without what its client says of its own pictures: how late others are is the room's to make up for.
        """
        assert request.tracking is not None
        faces = self.room.faces(self.person, request.tracking.head)
        return replace(request, faces=(*request.faces, *faces), arrival=None)

    def received(self, request: Request, at: float) -> None:
        """A request came ``at`` seconds; its tracking is solved elsewhere, perhaps much later."""
        self.room.heard(self.person, at)
        if request.tracking is None:
            self.room.moved(self.person, self._moved(request, None, at))

    def options(self, request: Request) -> PictureOptions:
        """How a request wants its picture, in the room's space."""
        light = request.options.light
        if light is None:
            return request.options
        return replace(request.options, light=light.turned(self.person.seat[:3, :3]))

    def look(
        self, request: Request, cameras: Sequence[Camera], solved: Solved | None, at: float, now: float
    ) -> tuple[tuple[Camera, ...], RoomView]:
        """The ``cameras`` of a request that came ``at`` seconds, in the room's space, and everybody in it.

        Raises PoseError for a solution that the others cannot be shown.
        """
        return self.room.look(self.person, cameras, self._moved(request, solved, at), now)

    def poses(self, history: PoseHistory, sha256: Callable[[str], bytes | None], now: float) -> Poses:
        """How everybody stands of whom the client has not been told so yet, by its ``history``."""
        return self.room.poses(self.person, history, sha256, now)

    def posed(self, count: int) -> None:
        """Count people who were skinned anew for a picture."""
        self.room.posed(count)

    def fair_cost(self, seconds: float) -> float:
        """Return the seconds that a picture counts for its viewer: those of a mean picture of this room."""
        return self.room.fair_cost(seconds)

    def end(self, goodbye: bool) -> None:
        """The connection is over; ``goodbye``: as the client wanted it."""
        if goodbye:
            self.room.left(self.person)
        else:
            self.room.lost(self.person)

    def _moved(self, request: Request, solved: Solved | None, at: float) -> Moved:
        if solved is None:
            return Moved(self.rest if request.pose is None else request.pose, at, request.t, request.frame_id)
        if (found := len(solved.pose.rotations)) != len(self.rest.rotations):
            raise PoseError(f"the solver's pose has {found} joints, the avatar {len(self.rest.rotations)}")
        return Moved(solved.pose, at, request.t, request.frame_id, solved.scale, solved.floor)
