"""Room: who is in it, and what each of them is shown. May be used by several threads; times are seconds that come in.

Time in a room goes by ticks: a tick ends when somebody is to be shown a second picture. In each, everybody's pose
changes once, so that everybody is skinned once however many look at them: with their own picture, at the pose it was
asked for, so that nobody's own hands lag behind; who asked for none in the last tick at the beginning of the next.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count, takewhile
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.rooms.person import Moved, Person, people_fields
from glsplat.extras.rooms.seats import free_seat, seat
from glsplat.net.codec.body import MAX_BODIES, PoseHistory, Poses, for_recipient
from glsplat.net.options import RoomError
from glsplat.net.room_view import RoomView, VisiblePerson, driven_by
from glsplat.net.wire_schema import Position

__all__ = ["Room"]


_TOKEN_BYTES = 16  # of randomness in the token that brings a person back
_SWEEP = 0.03  # seconds
_LEARN = 0.1  # how far each picture moves what one is expected to take


@dataclass(slots=True, eq=False)
class _Guest:
    person: Person
    seat: int | None  # None: chose a place
    leave: Callable[[], None]  # ends the connection of somebody who comes back on another one
    shown: VisiblePerson
    faded: int = 255  # opacity that the others were told


class Room:
    """People by name. ``seats`` bounds their number."""

    def __init__(self, name: str, seats: int = 8) -> None:
        self.name, self.seats = name, seats
        self._guests: dict[str, _Guest] = {}
        self._lock = Lock()
        self._keys = 0
        self._version = 0  # of who is there
        self._worn: tuple[int, tuple[str, ...]] = (-1, ())  # their avatars, each once, at that version
        self._change = 0  # of how somebody stands
        self._news: dict[int, tuple[int, Person]] = {}  # by key: the last change of each, the newest last
        self._swept = float("-inf")
        self._tick = 0
        self._seconds = 0.0  # that a picture takes
        self._drawn: set[int] = set()  # keys of who was shown a picture in this tick
        self._posed = 0  # poses drawn anew, for all viewers together

    def join(
        self,
        name: str,  # "": a free "guest N", counted from ``guest``
        avatar: str,
        now: float,
        resume: str = "",  # token of the person to come back as, "": a newcomer
        place: NDArray[np.float64] | None = None,  # [4, 4] room from user; None: the place they had, or a free seat
        leave: Callable[[], None] = lambda: None,
        notice: str = "",  # over their head, beside the name
        guest: int = 1,
    ) -> Person:
        """Add a person, or bring one back: a name belongs to the connection that has it, however silent that is.

        Its token alone brings the person back, at once, to their place, on another connection; ``leave`` of the one
        before is called. After a connection that broke the name stays taken until its person has faded.

        Raises RoomError: the name is taken, the room is full.
        """
        with self._lock:
            self._forget(now)
            before = self._whose(resume, name)
            if before is None and name in self._guests:
                raise RoomError(f'there is somebody called "{name}" in this room; choose another name', 409)
            if before is None and len(self._guests) >= self.seats:
                raise RoomError(f"the room is full ({self.seats} people); try again later", 503)
            if before is None:
                name = name or next(free for n in count(guest) if (free := f"guest {n}") not in self._guests)
                number, token = None, secrets.token_urlsafe(_TOKEN_BYTES)
                if place is None:
                    number = free_seat({one.seat for one in self._guests.values() if one.seat is not None}, self.seats)
                    place = seat(number, self.seats)
            else:
                name, number, token = before.person.name, before.seat, before.person.resume
                place = before.person.seat if place is None else place
                self._news.pop(before.person.key, None)
            self._keys += 1
            self._version += 1
            person = Person(self._keys, name, avatar, place, token, now, driven_by(name, notice))
            shown = VisiblePerson(person.key, name, avatar, None, place, label=person.label)
            self._guests[name] = _Guest(person, number, leave, shown)
        if before is not None and before.person.connected:
            before.leave()
        return person

    def left(self, person: Person) -> None:
        """They said goodbye: gone at once."""
        with self._lock:
            person.connected = False
            if self._is_here(person):
                del self._guests[person.name]
                self._news.pop(person.key, None)
                self._version += 1

    def lost(self, person: Person) -> None:
        """Their connection broke: they stay for a while, fade, and may come back."""
        with self._lock:
            person.connected = False

    def heard(self, person: Person, now: float) -> None:
        """Somebody is there, whether or not they move."""
        with self._lock:
            person.heard(now)

    def moved(self, person: Person, sample: Moved) -> None:
        """A sample of somebody's tracking was solved, or a pose of theirs came. PoseError: it is none to be shown."""
        with self._lock:
            last = person.newest
            person.moved(sample)
            # who only listens is at rest in each request, which is no news
            if last is None or (last.pose, last.scale, last.floor) != (sample.pose, sample.scale, sample.floor):
                self._changed(person)

    def faces(self, person: Person, head: Sequence[float] | None) -> list[Position]:
        """Between the eyes of all others whose tracking came, in the space of a ``person`` whose own head is there."""
        with self._lock:
            person.looked(head)
            others = [one.person.face for one in self._guests.values() if one.person is not person]
        from_room = person.from_room()
        places = [face for face in others if face is not None]
        return [] if not places else list(map(tuple, (places @ from_room[:3, :3].T + from_room[:3, 3]).tolist()))

    def look(
        self, person: Person, cameras: Sequence[Camera], own: Moved, now: float
    ) -> tuple[tuple[Camera, ...], RoomView]:
        """The ``cameras`` of a ``person`` in the room's space, and everybody in it; ``own`` is their own pose then."""
        with self._lock:
            self._forget(now)
            if person.key in self._drawn:
                self._next_tick(now)
            self._drawn.add(person.key)
            guest = self._guests.get(person.name)
            if guest is not None and guest.person is person:
                transform = person.place(own)[1]
                guest.shown = replace(guest.shown, pose=own.pose, transform=transform, frame_id=own.frame_id, ahead=0.0)
            people = tuple(
                replace(guest.shown, opacity=guest.person.opacity(now))
                for guest in self._guests.values()
                if guest.shown.pose is not None
            )
            view = RoomView(self.name, self._tick, person.key, people, person.from_room())
        from_room = person.from_room()
        return tuple(_moved(camera, from_room) for camera in cameras), view

    def poses(self, person: Person, history: PoseHistory, sha256: Callable[[str], bytes | None], now: float) -> Poses:
        """How everybody stands of whom a ``person`` was not told yet, and who is there where that changed.

        ``sha256`` is of the file of an avatar; who wears one that is not handed out (None) has no body.
        """
        with self._lock:
            self._sweep(now)
            if self._worn[0] != self._version:
                names = dict.fromkeys(guest.person.avatar for guest in self._guests.values())
                self._worn = self._version, tuple(names)
            hashes = {name: sha256(name) for name in self._worn[1]}
            room = None
            if history.room != (self._version, *hashes.values()):
                history.room, history.change = (self._version, *hashes.values()), 0
                room = people_fields(self.name, person, [guest.person for guest in self._guests.values()], hashes)
            fresh = list(takewhile(lambda news: news[0] > history.change, reversed(self._news.values())))
            bodies = []
            for change, one in fresh[: -MAX_BODIES - 1 : -1]:
                history.change = change
                digest = hashes.get(one.avatar)
                body = None if digest is None else one.packed(digest)
                if body is not None:
                    bodies.append(for_recipient(body, one is person, one.opacity(now)))
        return Poses(bodies, room)

    def posed(self, count: int) -> None:
        """A picture took so many people to be skinned anew."""
        with self._lock:
            self._posed += count

    def fair_cost(self, seconds: float) -> float:
        """Return the seconds that a picture counts for its viewer: those of a mean picture of this room.

        So a viewer who sees more people than the others does not get fewer pictures.
        """
        with self._lock:
            self._seconds += (seconds - self._seconds) * (_LEARN if self._seconds else 1.0)
            return self._seconds

    def status(self, now: float) -> dict[str, Any]:
        """Numbers for /stats."""
        with self._lock:
            self._forget(now)
            people = [
                {"name": g.person.name, "avatar": g.person.avatar, "connected": g.person.connected}
                | {"silent": round(g.person.silent(now), 2)}
                for g in self._guests.values()
            ]
            return {
                "name": self.name,
                "seats": self.seats,
                "ticks": self._tick,
                "posed": self._posed,
                "people": people,
            }

    def worn(self) -> list[str]:
        """The avatars of those who are here."""
        with self._lock:
            return [guest.person.avatar for guest in self._guests.values()]

    def count(self, now: float) -> int:
        """People in the room."""
        with self._lock:
            self._forget(now)
            return len(self._guests)

    def _next_tick(self, now: float) -> None:
        """Who asked for no picture in the last tick is shown where they should be by now."""
        self._tick += 1
        for guest in self._guests.values():
            person = guest.person
            if person.key in self._drawn:
                continue
            found, newest = person.at(now), person.newest
            if found is not None and newest is not None:
                pose, ahead = found
                guest.shown = replace(
                    guest.shown,
                    pose=pose,
                    transform=person.place(newest)[1],
                    frame_id=newest.frame_id,
                    ahead=round(ahead * 1e3, 1),
                )
        self._drawn.clear()

    def _forget(self, now: float) -> None:
        for name in [name for name, guest in self._guests.items() if guest.person.gone(now)]:
            self._news.pop(self._guests.pop(name).person.key, None)
            self._version += 1

    def _changed(self, person: Person) -> None:
        if self._is_here(person):
            self._change += 1
            self._news.pop(person.key, None)
            self._news[person.key] = self._change, person

    def _sweep(self, now: float) -> None:
        """Now and then, however many ask: who is gone, and who fades or is back."""
        if now - self._swept < _SWEEP:
            return
        self._swept = now
        self._forget(now)
        for guest in self._guests.values():
            byte = round(255 * guest.person.opacity(now))
            if byte != guest.faded:
                guest.faded = byte
                self._changed(guest.person)

    def _whose(self, resume: str, name: str) -> _Guest | None:
        """Whom a token belongs to, if they are here under that name; "" is any name."""
        for one in self._guests.values():
            if secrets.compare_digest(one.person.resume.encode(), resume.encode(errors="replace")):
                return one if name in ("", one.person.name) else None
        return None

    def _is_here(self, person: Person) -> bool:
        guest = self._guests.get(person.name)
        return guest is not None and guest.person is person


def _moved(camera: Camera, from_room: NDArray[np.float64]) -> Camera:
    viewmat = np.eye(4)  # the last row of a client's may be off by rounding, which a place far away would multiply
    viewmat[:3] = camera.viewmat[:3] @ from_room
    return replace(camera, viewmat=viewmat)
