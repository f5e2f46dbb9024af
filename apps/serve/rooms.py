"""The rooms of a server on its command line."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass

from glsplat.net.gl_server import SEATS
from glsplat.net.options import NAME
from glsplat.scene import Scene
from glsplat.scenes.scene_file import SceneFile, load_scene

from ..usage import UsageError

__all__ = ["RoomChoice", "add_rooms", "check_rooms", "lit_rooms", "open_rooms", "room_choice"]

_MOST = 64  # people


@dataclass(frozen=True)
class RoomChoice:
    """A room as it is asked for: NAME[:SEATS][=SCENE]."""

    name: str
    seats: int = SEATS
    scene: str | None = None


def room_choice(text: str) -> RoomChoice:
    """The type of --room. Raises ArgumentTypeError."""
    head, _, scene = text.partition("=")
    found = re.fullmatch(r"(.*?)(?::([0-9]{1,4}))?", head)
    assert found is not None
    name, seats = found[1], int(found[2] or SEATS)
    if not NAME.fullmatch(name):
        raise argparse.ArgumentTypeError(f"a room's name needs 1 to 32 letters, digits, blanks or _.'-, not {name!r}")
    if not 1 <= seats <= _MOST:
        raise argparse.ArgumentTypeError(f"a room holds 1 to {_MOST} people, not {seats}")
    return RoomChoice(name, seats, scene or None)


def add_rooms(parser: argparse.ArgumentParser) -> None:
    """--room."""
    parser.add_argument(
        "--room",
        type=room_choice,
        action="append",
        default=[],
        metavar="NAME[:SEATS][=SCENE]",
        help="a room in which clients meet, each as one of the avatars, seen by all others (/ws?room=NAME&name=ANN); "
        f"for SEATS people (default {SEATS}), in front of SCENE, a file like the first argument (default nothing); "
        "may be repeated",
    )


def check_rooms(args: argparse.Namespace) -> None:
    """Raises UsageError for two rooms of one name, and for more seats than clients may connect."""
    names = [room.name for room in args.room]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f'--room {name}: there are two rooms called "{name}"; people choose by name')
    for room in args.room:
        if room.seats > args.max_clients and room.seats != SEATS:
            raise UsageError(f"--room {room.name}: {room.seats} people need --max-clients {room.seats} or more")


def lit_rooms(rooms: dict[str, SceneFile], scene: SceneFile) -> dict[str, SceneFile]:
    """The rooms, those whose file has no light under that of the server's ``scene``."""
    for room in rooms.values():
        room.scene.light = room.scene.light or scene.scene.light
    return rooms


def open_rooms(args: argparse.Namespace) -> dict[str, SceneFile]:
    """What stands in each room. Raises GlsplatError naming the file that cannot be read."""
    return {
        room.name: SceneFile.of(Scene()) if room.scene is None else load_scene(room.scene, strict=args.strict)
        for room in args.room
    }
