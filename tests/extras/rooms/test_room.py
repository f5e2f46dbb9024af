"""Rooms without sockets and clocks: who comes in, where they stand, what each is shown, who fades."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import PoseError, ProtocolError
from glsplat.extras.accounts.users import User
from glsplat.extras.rooms.feature import Rooms
from glsplat.extras.rooms.person import FADE_S, MAX_AHEAD_S, SILENT_S, Person, PoseSample
from glsplat.extras.rooms.room import RADIUS, Room, RoomError, free_seat, place_at, seat
from glsplat.net.backend import AvatarInfo
from glsplat.net.catalogue import Catalogue
from glsplat.net.codec.body import PoseHistory, unpack_bodies
from glsplat.net.messages import Decoder, Request, WireOptions
from glsplat.net.options import NOT_ALLOWED, RequestedOptions, client_options
from glsplat.net.rights import Rights
from glsplat.net.session import SessionConfig
from glsplat.rotations import rotation_matrices
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from tests.net.wire import HANG

EYE = Camera(look_at((0, 1.6, 0), (0, 1.5, 1)), pinhole(64, 64), 64, 64)


def pose(turn: float = 0.0, x: float = 0.0, joint: int = 16) -> Pose:
    rotations = np.zeros((55, 3))
    rotations[joint, 2] = turn
    return Pose(rotations, (x, 0, 0))


def moved(at: float, turn: float = 0.0, frame_id: int | None = None, t: float | None = None) -> PoseSample:
    return PoseSample(pose(turn), at, t, frame_id)


def test_a_face_is_held_and_not_extrapolated() -> None:
    person = Person(1, "Ann", "a", seat(0, 2), "", 0.0)
    for at, open_ in ((0.0, 0.1), (0.05, 0.6)):
        person.add_sample(PoseSample(Pose(np.zeros((55, 3)), expression={"jawOpen": open_}), at))
    found = person.extrapolated(0.1)
    assert found is not None and found[0].expression == {"jawOpen": 0.6} and found[1] > 0


def test_people_stand_around_the_centre_and_face_it() -> None:
    for seats in (2, 5, 8, 16):
        taken: set[int] = set()
        places = []
        for _ in range(seats):
            number = free_seat(taken, seats)
            assert number not in taken
            taken.add(number)
            places.append(seat(number, seats))
        for place in places:
            centre = np.linalg.inv(place) @ (0, 0, 0, 1)
            assert np.allclose(centre[[0, 1]], 0, atol=1e-12) and centre[2] >= RADIUS - 1e-12
        feet = np.array([place[:3, 3] for place in places])
        apart = np.linalg.norm(feet[:, None] - feet, axis=-1) + 9 * np.eye(seats)
        assert apart.min() > 0.85
        assert np.allclose(feet[0], -feet[1], atol=1e-9) or seats % 2  # the first two opposite each other


def test_everybody_is_shown_where_they_are() -> None:
    room = Room("lab", 4)
    ann = room.join("Ann", "a", 0.0)
    bob = room.join("Bob", "b", 0.0, place=place_at(1.0, 2.0, np.pi / 2))
    for person, turn in ((ann, 0.1), (bob, 0.2)):
        own = replace(moved(0.0, turn), scale=1.1, floor=0.2)
        room.add_sample(person, own)
        room.look(person, (EYE,), own, 0.0)
    cameras, view = room.look(ann, (EYE,), replace(moved(0.1, 0.3, 7), scale=1.1, floor=0.2), 0.1)
    shown = {one.name: one for one in view.people}
    assert view.viewer == shown["Ann"].key and shown["Ann"].frame_id == 7
    assert shown["Ann"].pose is not None and shown["Ann"].pose.rotations[16, 2] == 0.3
    # x = 1 of Bob's own, on his floor, of an avatar that is 1.1 times larger in the room
    there = shown["Bob"].transform @ (1, 0, 0, 1)
    assert np.allclose(there[:3], (1.0, 0.2, 2.0 - 1.1))
    (camera,) = cameras
    point = ann.seat @ (0.3, 1.5, 1.0, 1.0)  # what Ann has before her, in the room
    assert np.allclose(camera.viewmat @ point, EYE.viewmat @ (0.3, 1.5, 1.0, 1.0))


def test_in_a_tick_everybody_changes_once() -> None:
    """Each one's pose changes with their own picture and with no other."""
    room = Room("lab", 4)
    people = [room.join(name, "a", 0.0) for name in "ABCD"]
    seen: dict[str, list[Pose | None]] = {person.name: [] for person in people}
    for round_ in range(6):
        for number, person in enumerate(people):
            now = round_ + 0.1 * number
            own = moved(now, 0.01 * round_ + 0.001 * number)
            room.add_sample(person, own)
            _, view = room.look(person, (EYE,), own, now)
            assert view is not None and view.tick == round_
            for one in view.people:
                poses = seen[one.name]
                if not poses or poses[-1] is not one.pose:
                    poses.append(one.pose)
                if one.name == person.name:
                    assert one.pose is own.pose
    assert all(len(poses) == 6 for poses in seen.values())


def test_who_asks_for_no_pictures_moves_on_with_the_ticks() -> None:
    room = Room("lab", 4)
    ann, bob = room.join("Ann", "a", 0.0), room.join("Bob", "a", 0.0)
    for tick in range(4):
        now = 0.02 * tick
        room.add_sample(bob, moved(now, 0.1 * tick, tick, 20.0 * tick))
        _, view = room.look(ann, (EYE,), moved(now), now)
        assert view is not None
        bobs = [one for one in view.people if one.name == "Bob"]
        assert [one.frame_id for one in bobs] == ([] if tick == 0 else [tick])


@pytest.mark.parametrize(("late", "ahead"), [(0.0, 0.0), (0.03, 0.03), (0.1, MAX_AHEAD_S), (5.0, MAX_AHEAD_S)])
def test_late_tracking_goes_on_for_a_tenth_of_a_second_and_is_held_then(late: float, ahead: float) -> None:
    person = Person(1, "Ann", "a", seat(0, 2), "", 0.0)
    assert person.extrapolated(0.5) is None
    for k in range(10):
        person.add_sample(PoseSample(pose(0.02 * k, 0.01 * k), k / 72, 1000 * k / 72, k))
    there, extrapolated = person.extrapolated(9 / 72 + late) or (pose(), 0.0)
    assert extrapolated == pytest.approx(ahead)
    assert there.rotations[16, 2] == pytest.approx(0.18 + 0.02 * 72 * ahead)
    assert there.trans[0] == pytest.approx(0.09 + 0.01 * 72 * ahead)


def test_tracking_without_a_clock_of_its_own_goes_by_its_arrival() -> None:
    person = Person(1, "Ann", "a", seat(0, 2), "", 0.0)
    for k in range(10):
        person.add_sample(moved(500 + k / 72, 0.02 * k))
    there, ahead = person.extrapolated(500 + 9 / 72 + 0.03) or (pose(), 0.0)
    assert ahead == pytest.approx(0.03) and there.rotations[16, 2] == pytest.approx(0.18 + 0.02 * 72 * 0.03)


def test_nobody_is_torn_apart_by_extrapolation() -> None:
    person = Person(1, "Ann", "a", seat(0, 2), "", 0.0)
    person.add_sample(PoseSample(pose(0.0), 0.0, 0.0))
    person.add_sample(PoseSample(pose(3.0, 5.0), 0.01, 10.0))
    found = person.extrapolated(1.0)
    assert found is not None
    assert np.linalg.norm(found[0].rotations[16]) < 3.0 + 0.51 and found[0].trans[0] <= 5.31
    # a gap, a clock that stands still or runs back, another rig: nothing to go by
    for first, second in (((0.0, 0.0), (0.5, 500.0)), ((0.0, 7.0), (0.02, 7.0)), ((0.0, 9.0), (0.02, 3.0))):
        other = Person(1, "Ann", "a", seat(0, 2), "", 0.0)
        other.add_sample(PoseSample(pose(0.1), *first))
        other.add_sample(PoseSample(pose(0.2), *second))
        newest = other.newest
        assert newest is not None and other.extrapolated(2.0) == (newest.pose, 0.0)


def test_who_is_silent_fades_and_who_is_lost_goes() -> None:
    room = Room("lab", 4)
    ann, bob = room.join("Ann", "a", 0.0), room.join("Bob", "a", 0.0)

    def bobs(now: float) -> list[float]:
        _, view = room.look(ann, (EYE,), moved(now), now)
        assert view is not None
        return [round(one.opacity, 6) for one in view.people if one.name == "Bob"]

    room.add_sample(bob, moved(1.0))
    room.look(bob, (EYE,), moved(1.0), 1.0)
    room.disconnect(bob)
    assert bobs(1.0 + SILENT_S - 0.01) == [1.0]
    assert bobs(1.0 + SILENT_S + FADE_S / 2) == [0.5]
    assert bobs(1.0 + SILENT_S + FADE_S) == [] and room.count(4.0) == 1
    # a connection that only sends nothing: gone from sight, not from the room
    carl = room.join("Carl", "a", 5.0)
    room.add_sample(carl, moved(5.0))
    room.look(carl, (EYE,), moved(5.0), 5.0)
    _, view = room.look(ann, (EYE,), moved(9.0), 9.0)
    assert view is not None and {one.name: one.opacity for one in view.people}["Carl"] == 0.0
    room.add_sample(carl, moved(9.5))
    _, view = room.look(ann, (EYE,), moved(9.6), 9.6)
    assert view is not None and {one.name: one.opacity for one in view.people}["Carl"] == 1.0
    room.leave(carl)
    assert room.count(9.7) == 1


def test_names_and_seats() -> None:
    room = Room("lab", 2)
    ended: list[str] = []
    ann = room.join("Ann", "a", 0.0, leave=lambda: ended.append("Ann"))
    room.add_sample(ann, moved(0.0))
    with pytest.raises(RoomError, match='already somebody named "Ann"') as refused:
        room.join("Ann", "a", 0.1)
    assert refused.value.status == 409
    bob = room.join("Bob", "a", 0.1)
    with pytest.raises(RoomError, match=r"full \(2 people\)") as refused:
        room.join("Carl", "a", 0.2)
    assert refused.value.status == 503
    # however silent a connection is, its name is taken: only its own token brings the person back, to the same seat
    for token in ("", bob.resume, ann.resume[:-1], "é"):
        with pytest.raises(RoomError, match="somebody named"):
            room.join("Ann", "a", 50.0, token)
    again = room.join("Ann", "b", 50.0, ann.resume, leave=lambda: ended.append("again"))
    assert ended == ["Ann"] and again.key != ann.key and again.seat is ann.seat and again.resume == ann.resume
    room.leave(ann)  # the old connection's end is not the new one's
    assert room.count(50.1) == 2
    moves = room.join("", "b", 50.2, ann.resume, place=place_at(1, 2, 3))  # nameless, elsewhere
    assert moves.name == "Ann" and np.array_equal(moves.seat, place_at(1, 2, 3)) and ended == ["Ann", "again"]
    assert len({ann.resume, bob.resume, Room("hall").join("Ann", "a", 0.0).resume}) == 3


def test_the_name_of_a_connection_that_broke_is_kept_until_its_person_has_faded() -> None:
    room = Room("lab", 2)
    ann = room.join("Ann", "a", 0.0)
    room.add_sample(ann, moved(1.0))
    room.disconnect(ann)
    with pytest.raises(RoomError, match="somebody named"):
        room.join("Ann", "a", 1.0 + SILENT_S + FADE_S - 0.01)
    again = room.join("Ann", "a", 1.0 + SILENT_S + FADE_S - 0.01, ann.resume)
    room.disconnect(again)
    newcomer = room.join("Ann", "a", 20.0)
    assert newcomer.resume != ann.resume
    with pytest.raises(RoomError, match="somebody named"):  # an old token is none
        room.join("Ann", "a", 20.1, ann.resume)
    assert room.join("Ann 2", "a", 20.2, newcomer.resume).resume != newcomer.resume  # another name, another person


def test_nobody_keeps_the_nameless_out_by_taking_their_names() -> None:
    room = Room("lab", 4)
    taken = [room.join(f"guest {number}", "a", 0.0).name for number in (7, 8)]
    assert taken == ["guest 7", "guest 8"]
    guest = room.join("", "a", 0.0, guest=7)
    assert guest.name == "guest 9" and guest.notice == ""


@pytest.mark.parametrize(("scale", "floor"), [(np.nan, 0.0), (1.0, np.inf), (0.0, 0.0), (-1.0, 0.0), (1.0, 1e9)])
def test_who_can_stand_nowhere_is_shown_where_they_stood(scale: float, floor: float) -> None:
    room = Room("lab", 4)
    ann, bob = room.join("Ann", "a", 0.0), room.join("Bob", "a", 0.0)
    room.add_sample(bob, replace(moved(1.0), scale=1.5))
    with pytest.raises(PoseError, match="cannot be placed"):
        room.add_sample(bob, replace(moved(1.1), scale=scale, floor=floor))
    room.look(ann, (EYE,), moved(1.1), 1.1)
    _, view = room.look(ann, (EYE,), moved(1.2), 1.2)
    (shown,) = (one for one in view.people if one.name == "Bob")
    assert np.allclose(np.linalg.det(shown.transform[:3, :3]), 1.5**3)
    bodies = room.poses(ann, PoseHistory(), lambda name: bytes(32), 1.2).bodies
    assert len(unpack_bodies(bytes((len(bodies),)) + b"".join(bodies))) == 1


def test_a_movement_that_leads_beyond_all_limits_is_not_continued() -> None:
    person = Person(1, "Ann", "a", seat(0, 2), "", 0.0)
    for at, x in ((0.0, 999999.7), (0.05, 999999.95)):
        person.add_sample(PoseSample(pose(x=x), at))
    newest = person.newest
    assert newest is not None and person.extrapolated(0.1) == (newest.pose, 0.0)


def test_a_camera_is_placed_whatever_rounding_it_came_with() -> None:
    room, row = Room("lab"), [9e-7, 0, -9e-7, 1 + 9e-7]
    person = room.join("Ann", "a", 0.0, place=place_at(100, -100, 1))
    chance = np.random.default_rng(1)
    for off in 2e-5 - 10.0 ** np.arange(-16, -4):
        viewmat = np.eye(4)
        viewmat[:3, :3] = rotation_matrices(chance.normal(size=3)) * np.sqrt(1 + max(off, 0.0))
        viewmat[3] = row if off < 1e-5 else viewmat[3]
        eye = {"viewmat": viewmat.ravel().tolist(), "K": [40, 40, 32, 32]}
        request = Decoder().decode(json.dumps({"v": 1, "frame_id": 1, "size": [64, 64], "eyes": [eye]}))
        assert isinstance(request, Request)
        ((camera,), _) = room.look(person, request.cameras, moved(0.0), 0.0)
        assert np.allclose(camera.viewmat, viewmat @ person.from_room, atol=3e-3)


@pytest.mark.parametrize(
    "call",
    [
        lambda room, ann: room.status(1.0),
        lambda room, ann: room.count(1.0),
        lambda room, ann: room.fair_cost(1.0),
        lambda room, ann: room.join("Bob", "a", 1.0),
        lambda room, ann: room.look(ann, (EYE,), moved(1.0), 1.0),
    ],
    ids=["status", "count", "fair_cost", "join", "look"],
)
def test_each_call_waits_until_another_thread_is_done(call: Callable[[Room, Person], object]) -> None:
    room = Room("lab")
    thread = Thread(target=call, args=(room, room.join("Ann", "a", 0.0)), daemon=True)
    with room._lock:
        thread.start()
        thread.join(0.1)
        waits = thread.is_alive()
    thread.join(HANG)
    assert waits and not thread.is_alive()


def asked(user: User | None = None, **query: str) -> RequestedOptions:
    return client_options(query, WireOptions(), SessionConfig(), ["default"], user=user)


@pytest.mark.parametrize("name", ["", " ", "a" * 33, "../x", "a/b", "a\\b", "\x00", "a\nb", "<b>", "-a", "a ", "_"])
def test_names_that_nobody_can_have(name: str) -> None:
    with pytest.raises(ProtocolError, match="name needs"):
        asked(name=name)


def test_an_account_goes_by_its_own_name_into_its_own_rooms() -> None:
    ann = User(name="ann", avatars=("*",), rooms=("lab",))
    assert asked(ann, room="lab").name == "ann" == asked(ann, room="lab", name="ann").name
    for query in ({"room": "lab", "name": "bob"}, {"room": "secret"}, {"room": "../lab"}, {"name": "Ann"}):
        with pytest.raises(ProtocolError) as refused:
            asked(ann, **query)
        assert refused.value.code == NOT_ALLOWED


def test_what_an_address_asks_for() -> None:
    place = asked(room="lab", at="1.5,-2,90").place
    assert asked().name == "" and not asked().label and asked(label="1").label
    assert asked(room="lab").label and not asked(room="lab", label="0").label  # clients that show no names themselves
    with pytest.raises(ProtocolError, match="label needs 0 or 1"):
        asked(label="yes")
    assert place is not None and np.allclose(place_at(*place) @ (0, 0, 1, 1), (2.5, 0, -2, 1))
    for wrong in ("", "1,2", "1,2,3,4", "a,b,c", "nan,0,0", "0,nan,0", "0,0,nan", "0,inf,0", "1e9,0,0", "0,0,361"):
        with pytest.raises(ProtocolError, match="at needs x,z,degrees"):
            asked(room="lab", at=wrong)


def test_who_names_no_avatar_gets_one_that_nobody_wears() -> None:
    """Of the default's joints; whoever comes back by a token keeps theirs."""
    rig = Skeleton.from_joints(["root"], [-1], [[0.0, 0.0, 0.0]])
    other = Skeleton.from_joints(["root", "arm"], [-1, 0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    offered = [AvatarInfo(name=name, skeleton=joints) for name, joints in (("a", rig), ("b", other), ("c", rig))]
    rooms = Rooms({"lab": 8})
    gate = SimpleNamespace(rights=Rights())
    rooms._server = SimpleNamespace(catalogue=Catalogue(offered), gate=gate)  # type: ignore[assignment]
    room, worn, tokens = rooms._rooms["lab"], [], []
    for _ in range(3):
        worn.append(rooms.query({"room": "lab"}, None)["avatar"])
        tokens.append(room.join("", worn[-1], 0.0).resume)
    assert worn == ["a", "c", "a"]
    assert rooms.query({"room": "lab", "resume": tokens[1]}, None)["avatar"] == "c"
    assert rooms.query({"room": "lab", "avatar": "b"}, None)["avatar"] == "b"
    assert "avatar" not in rooms.query({}, None)


QUERY = st.dictionaries(
    st.sampled_from(["avatar", "room", "name", "at", "label", "mirror", "window", "height", "span", "resume", "x"]),
    st.text(max_size=40) | st.sampled_from(["lab", "../lab", "default", "1", "0", "1.7", "0,0,0", "0,nan,0", "%00"]),
    max_size=6,
)


@given(QUERY, st.sampled_from([None, User(name="ann", rooms=("lab",), avatars=("default",))]))
def test_whatever_is_asked_for_is_understood_or_refused(query: dict[str, str], user: User | None) -> None:
    rooms, entered = Rooms({"lab": 2}), []
    rooms._server = SimpleNamespace(clock=lambda: 0.0, close_client=lambda *_: None)  # type: ignore[assignment]
    shown = AvatarInfo(name="default", skeleton=Skeleton.from_joints(["root"], [-1], [[0.0, 0.0, 0.0]]))
    try:
        wish = asked(user, **query)
        client: Any = SimpleNamespace(shown=shown, number=1, notice=lambda: "")
        client.enter = lambda room, member, name: entered.append(member)
        rooms.client_opened(client, wish)
    except ProtocolError as refused:
        assert str(refused).isprintable()
        return
    assert len(entered) == ("room" in query)
    for member in entered:
        assert member.room.name == query["room"] == "lab"
        assert member.person.name.isprintable() and len(member.person.name) <= 32
        assert member.person.name == ("ann" if user else query.get("name") or "guest 1")
        assert np.isfinite(member.person.seat).all()
