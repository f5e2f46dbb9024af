"""Member: a client in a room. Turns what it sends into where its person is, and what it asks for into its view."""

from __future__ import annotations

from dataclasses import dataclass, replace

from glsplat.net.backend import Solved
from glsplat.net.messages import RenderRequest
from glsplat.net.rooms.person import Moved, Person
from glsplat.net.rooms.room import Room

__all__ = ["Member"]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One client's person in its room."""

    room: Room
    person: Person

    def solved(self, request: RenderRequest, solved: Solved, at: float) -> None:
        """Tracking that came ``at`` seconds was solved."""
        self.room.moved(self.person, _moved(request, solved, at))

    def received(self, request: RenderRequest, at: float) -> None:
        """A request came ``at`` seconds; its tracking is solved elsewhere, perhaps much later."""
        self.room.heard(self.person, at)
        if request.pose is not None:
            self.room.moved(self.person, _moved(request, None, at))

    def look(self, request: RenderRequest, solved: Solved | None, at: float, now: float) -> RenderRequest:
        """``request``, which came ``at`` seconds, with everybody in it."""
        own = None if request.pose is None and solved is None else _moved(request, solved, at)
        return self.room.look(self.person, replace(request, tracking=None), own, now)

    def end(self, goodbye: bool) -> None:
        """The connection is over; ``goodbye``: as the client wanted it."""
        if goodbye:
            self.room.left(self.person)
        else:
            self.room.lost(self.person)


def _moved(request: RenderRequest, solved: Solved | None, at: float) -> Moved:
    if solved is not None:
        return Moved(solved.pose, at, request.t, request.frame_id, solved.scale, solved.floor)
    assert request.pose is not None
    return Moved(request.pose, at, request.t, request.frame_id)
