"""Member: a client in a room. Adapts its requests to the room's methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from glsplat.camera import Camera
from glsplat.errors import PoseError
from glsplat.extras.rooms.person import Person, PoseSample
from glsplat.extras.rooms.room import Room
from glsplat.net.backend import Solved
from glsplat.net.codec.body import PoseHistory, Poses
from glsplat.net.messages import Request
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
