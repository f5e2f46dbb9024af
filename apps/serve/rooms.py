"""The rooms that --room names, and voice in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat.formats.scene_file import SceneFile, load_scene
from glsplat.net.guard.access import read_token
from glsplat.net.options import DEFAULT_SEATS
from glsplat.scene import Scene

from ..usage import UsageError
from .options import ServeOptions, naming_option

if TYPE_CHECKING:
    from glsplat.extras.voice import Voice


def check_rooms(args: ServeOptions) -> None:
    """Raise UsageError for two rooms of one name, and for more seats than clients may connect."""
    names = [room.name for room in args.room]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f'{args.label("room")} {name}: there are two rooms called "{name}"; people choose by name')
    for room in args.room:
        if room.seats > args.max_clients and room.seats != DEFAULT_SEATS:
            raise UsageError(
                f"{args.label('room')} {room.name}: {room.seats} people need max-clients = {room.seats} or more"
            )


def lit_rooms(rooms: dict[str, SceneFile], scene: SceneFile) -> dict[str, SceneFile]:
    """Return the rooms; those whose file has no light get that of the server's ``scene``."""
    for room in rooms.values():
        room.scene.light = room.scene.light or scene.scene.light
    return rooms


def open_rooms(args: ServeOptions) -> dict[str, SceneFile]:
    """Return the scene of each room, by name. Raises GlsplatError naming the file that cannot be read."""
    with naming_option(args, "room"):
        return {
            room.name: SceneFile.of(Scene()) if room.scene is None else load_scene(room.scene, strict=args.strict)
            for room in args.room
        }


def voice_of(args: ServeOptions) -> Voice:
    """Return the feature of --voice. Raises GlsplatError naming the option or the file that does not fit."""
    from glsplat.extras.voice import IceServers, Voice  # here: few servers have voice

    with naming_option(args, "turn-secret-file"):
        secret = "" if args.turn_secret_file is None else read_token(args.turn_secret_file)
    with naming_option(args, "ice"):
        return Voice(IceServers(args.ice, secret, args.relay_only))
