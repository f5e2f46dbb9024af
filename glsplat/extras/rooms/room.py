"""Room: its people and each person's view. Thread-safe; times are seconds, passed in.

Time passes in ticks: a tick ends when a person asks for a second picture. Poses change once per tick, so each person is
skinned once for all viewers. A viewer's own pose is that of the request, so own hands do not lag; people without a
request in the last tick are extrapolated at the start of the next.
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
from glsplat.extras.rooms.person import Person, PoseSample, people_fields
from glsplat.net.codec.body import MAX_BODIES, PoseHistory, Poses, for_recipient
from glsplat.net.options import RoomError
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.net.wire_schema import Position
from glsplat.scene import similarity
from glsplat.skinning.skeleton import Skeleton

RADIUS = 1.2
"""Least radius of the circle in metres: people who stand opposite are at a talking distance."""

_ARC_PER_PERSON_M = 1.0


def seat(number: int, seats: int) -> NDArray[np.float64]:
    """Return room from user [4, 4]: the user's origin on the circle, their +z towards its centre.

    The first two seats are opposite each other.

    >>> glsplat.extras.rooms.room.seat(0, 2)[:3, 3].round(6).tolist()
    [0.0, 0.0, -1.2]
    """
    radius = max(RADIUS, seats * _ARC_PER_PERSON_M / (2 * np.pi))
    angle = 2 * np.pi * number / seats
    return place_at(-radius * np.sin(angle), -radius * np.cos(angle), angle)


def place_at(x: float, z: float, turn: float) -> NDArray[np.float64]:
    """Return room from user [4, 4]: the origin at (x, 0, z) metres, turned by ``turn`` radians about y."""
    return similarity((x, 0, z), (0, np.sin(turn / 2), 0, np.cos(turn / 2)))


def free_seat(taken: set[int], seats: int) -> int:
    """Return the free seat farthest from those taken; the lowest of several. One has to be free.

    >>> [glsplat.extras.rooms.room.free_seat(set(taken), 8) for taken in ([], [0], [0, 4], [0, 4, 2])]
    [0, 4, 2, 6]
    """

    def distance(number: int) -> int:
        steps = [(number - other) % seats for other in taken]
        return min((min(step, seats - step) for step in steps), default=seats)

    free = (number for number in range(seats) if number not in taken)
    return max(free, key=lambda number: (distance(number), -number))


_TOKEN_BYTES = 16
_SWEEP_INTERVAL_S = 0.03
_COST_SMOOTHING = 0.1  # weight of the newest picture in the mean drawing time


@dataclass(slots=True, eq=False)
class _Guest:
    person: Person
    seat: int | None  # None: at a place of their choice
    leave: Callable[[], None]  # ends the connection when the person comes back on another one
    shown: VisiblePerson
    sent_opacity: int = 255  # last one sent to the others


class Room:
    """At most ``seats`` people, by name."""

    def __init__(self, name: str, seats: int = 8) -> None:
        self.name, self.seats = name, seats
        self._guests: dict[str, _Guest] = {}
        self._lock = Lock()
        self._keys = 0
        self._version = 0  # counts changes of the list of people
        self._avatars: tuple[int, tuple[str, ...]] = (-1, ())  # distinct avatars at a version
        self._change = 0  # counts changes of poses and opacities
        self._changes: dict[int, tuple[int, Person]] = {}  # last change by key, newest last
        self._last_sweep = float("-inf")
        self._tick = 0
        self._seconds = 0.0  # mean drawing time of a picture
        self._viewers: set[int] = set()  # keys of people who asked for a picture in this tick
        self._posed = 0  # skinned poses, summed over viewers

    def join(
        self,
        name: str,  # "": a free "guest N", counted from ``guest``
        avatar: str,
        now: float,
        resume: str = "",  # token of a person who comes back; "": a newcomer
        place: NDArray[np.float64] | None = None,  # [4, 4] room from user; None: the previous place, or a free seat
        leave: Callable[[], None] = lambda: None,
        notice: str = "",  # shown over the head, beside the name
        guest: int = 1,
        skeleton: Skeleton | None = None,  # of the avatar
    ) -> Person:
        """Add a person, or bring one back. Raises RoomError if the name is taken or the room is full.

        A name belongs to its connection, however silent. Only the token brings the person back on another one, at once;
        ``leave`` of the previous connection is called. After a broken connection the name stays taken until the person
        has faded.
        """
        with self._lock:
            self._remove_gone(now)
            before = self._guest_by_token(resume, name)
            if before is None and name in self._guests:
                raise RoomError(f'there is already somebody named "{name}" in this room; choose another name', 409)
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
                self._changes.pop(before.person.key, None)
            self._keys += 1
            self._version += 1
            person = Person(self._keys, name, avatar, place, token, now, notice, skeleton)
            shown = VisiblePerson(person.key, name, avatar, None, place, notice=notice)
            self._guests[name] = _Guest(person, number, leave, shown)
        if before is not None and before.person.connected:
            before.leave()
        return person

    def avatar_for(self, resume: str, offered: Sequence[str]) -> str:
        """Return the avatar of the person with that token, else the first of those that fewest people wear."""
        with self._lock:
            if (guest := self._guest_by_token(resume, "")) is not None:
                return guest.person.avatar
            worn = [guest.person.avatar for guest in self._guests.values()]
        return min(offered, key=worn.count)

    def leave(self, person: Person) -> None:
        """Remove a person who closed the connection on purpose."""
        with self._lock:
            person.connected = False
            if self._is_present(person):
                del self._guests[person.name]
                self._changes.pop(person.key, None)
                self._version += 1

    def disconnect(self, person: Person) -> None:
        """Mark a person's connection as broken: the person fades, and may come back."""
        with self._lock:
            person.connected = False

    def touch(self, person: Person, now: float) -> None:
        """Record a sign of life of a person."""
        with self._lock:
            person.touch(now)

    def add_sample(self, person: Person, sample: PoseSample) -> None:
        """Add a pose sample of a person. Raises PoseError if it cannot be drawn."""
        with self._lock:
            last = person.newest
            person.add_sample(sample)
            # a person who only listens sends the same pose in every request
            if last is None or (last.pose, last.scale, last.floor) != (sample.pose, sample.scale, sample.floor):
                self._changed(person)

    def faces(self, person: Person, head: Sequence[float] | None) -> list[Position]:
        """Set the ``head`` of a person; return the points between the eyes of all others, in that person's space."""
        with self._lock:
            person.set_head(head)
            others = [one.person.face for one in self._guests.values() if one.person is not person]
        from_room = person.from_room
        places = [face for face in others if face is not None]
        return [] if not places else list(map(tuple, (places @ from_room[:3, :3].T + from_room[:3, 3]).tolist()))

    def look(
        self, person: Person, cameras: Sequence[Camera], own: PoseSample, now: float
    ) -> tuple[tuple[Camera, ...], RoomView]:
        """Return the ``cameras`` in the room's space and the view of everybody; ``own`` is the viewer's pose."""
        with self._lock:
            self._remove_gone(now)
            if person.key in self._viewers:
                self._next_tick(now)
            self._viewers.add(person.key)
            guest = self._guests.get(person.name)
            if guest is not None and guest.person is person:
                transform = person.place(own)[1]
                guest.shown = replace(
                    guest.shown,
                    pose=own.pose,
                    head=person.head(own.pose),
                    transform=transform,
                    frame_id=own.frame_id,
                    ahead=0.0,
                )
            people = tuple(
                replace(guest.shown, opacity=guest.person.opacity(now))
                for guest in self._guests.values()
                if guest.shown.pose is not None
            )
            view = RoomView(self.name, self._tick, person.key, people, person.from_room)
        from_room = person.from_room
        return tuple(_in_room(camera, from_room) for camera in cameras), view

    def poses(self, person: Person, history: PoseHistory, sha256: Callable[[str], bytes | None], now: float) -> Poses:
        """Return the poses changed since ``history``, and the list of people if it changed.

        ``sha256(avatar)`` is the hash of an avatar's file; people whose file is not handed out (None) have no pose.
        """
        with self._lock:
            self._sweep(now)
            if self._avatars[0] != self._version:
                names = dict.fromkeys(guest.person.avatar for guest in self._guests.values())
                self._avatars = self._version, tuple(names)
            hashes = {name: sha256(name) for name in self._avatars[1]}
            room = None
            if history.room != (self._version, *hashes.values()):
                history.room, history.change = (self._version, *hashes.values()), 0
                room = people_fields(self.name, person, [guest.person for guest in self._guests.values()], hashes)
            fresh = list(takewhile(lambda news: news[0] > history.change, reversed(self._changes.values())))
            bodies = []
            for change, one in fresh[: -MAX_BODIES - 1 : -1]:
                history.change = change
                digest = hashes.get(one.avatar)
                body = None if digest is None else one.packed(digest)
                if body is not None:
                    bodies.append(for_recipient(body, one is person, one.opacity(now)))
        return Poses(bodies, room)

    def posed(self, count: int) -> None:
        """Count the people skinned for a picture."""
        with self._lock:
            self._posed += count

    def fair_cost(self, seconds: float) -> float:
        """Return the seconds charged to a viewer for a picture: the mean of this room.

        So a viewer of many people does not get fewer pictures than the others.
        """
        with self._lock:
            self._seconds += (seconds - self._seconds) * (_COST_SMOOTHING if self._seconds else 1.0)
            return self._seconds

    def status(self, now: float) -> dict[str, Any]:
        """Return the room's object of /stats."""
        with self._lock:
            self._remove_gone(now)
            people = [
                {"name": g.person.name, "avatar": g.person.avatar, "connected": g.person.connected}
                | {"silent": round(g.person.silence(now), 2)}
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
        """Return the avatars of the people in the room."""
        with self._lock:
            return [guest.person.avatar for guest in self._guests.values()]

    def count(self, now: float) -> int:
        """Return the number of people in the room."""
        with self._lock:
            self._remove_gone(now)
            return len(self._guests)

    def _next_tick(self, now: float) -> None:
        """Begin a tick: extrapolate the people without a request in the last one."""
        self._tick += 1
        for guest in self._guests.values():
            person = guest.person
            if person.key in self._viewers:
                continue
            found, newest = person.extrapolated(now), person.newest
            if found is not None and newest is not None:
                pose, ahead = found
                guest.shown = replace(
                    guest.shown,
                    pose=pose,
                    head=person.head(pose),
                    transform=person.place(newest)[1],
                    frame_id=newest.frame_id,
                    ahead=round(ahead * 1e3, 1),
                )
        self._viewers.clear()

    def _remove_gone(self, now: float) -> None:
        for name in [name for name, guest in self._guests.items() if guest.person.gone(now)]:
            self._changes.pop(self._guests.pop(name).person.key, None)
            self._version += 1

    def _changed(self, person: Person) -> None:
        if self._is_present(person):
            self._change += 1
            self._changes.pop(person.key, None)
            self._changes[person.key] = self._change, person

    def _sweep(self, now: float) -> None:
        """Remove people who are gone and record changed opacities, at most once per interval."""
        if now - self._last_sweep < _SWEEP_INTERVAL_S:
            return
        self._last_sweep = now
        self._remove_gone(now)
        for guest in self._guests.values():
            byte = round(255 * guest.person.opacity(now))
            if byte != guest.sent_opacity:
                guest.sent_opacity = byte
                self._changed(guest.person)

    def _guest_by_token(self, resume: str, name: str) -> _Guest | None:
        """Return the guest with that token and name; "" matches any name."""
        for one in self._guests.values():
            if secrets.compare_digest(one.person.resume.encode(), resume.encode(errors="replace")):
                return one if name in ("", one.person.name) else None
        return None

    def _is_present(self, person: Person) -> bool:
        guest = self._guests.get(person.name)
        return guest is not None and guest.person is person


def _in_room(camera: Camera, from_room: NDArray[np.float64]) -> Camera:
    viewmat = np.eye(4)  # exact last row: rounding of a client's would be multiplied by a far place
    viewmat[:3] = camera.viewmat[:3] @ from_room
    return replace(camera, viewmat=viewmat)
