"""``glsplat serve``: the headless render server."""

from __future__ import annotations

import asyncio
import json
import logging
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from glsplat.config import RenderConfig
from glsplat.data import DEFAULT, PEOPLE, embedded_file
from glsplat.errors import ContextError
from glsplat.formats.scene_file import SceneFile, load_scene
from glsplat.net.guard.access import Access, read_token
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import WireOptions
from glsplat.net.options import DEFAULT_SEATS, ServerConfig
from glsplat.net.served_scene import ServedScene, TrackingOptions
from glsplat.net.server import Server
from glsplat.net.session import SessionConfig
from glsplat.optional import has_extra
from glsplat.scene import Rigged, Scene

from ..args import detail_of, load_avatar, open_scene
from ..logs import start_logging
from ..usage import UsageError
from .keys import Keys, keys_of, watermark_of
from .options import ServeOptions, add_options, check_given, naming_option
from .options import parsed as parsed  # apps/cli.py parses with it
from .ready import Endpoint, announce, open_page

if TYPE_CHECKING:
    from glsplat.extras.speech.face import FaceListener
    from glsplat.extras.voice import Voice
    from glsplat.extras.workers.pool import Workers
    from glsplat.net.session import WatermarkKey

    from .study import ServedStudy

HELP = (
    "Serve pictures of an avatar: a page for the browsers of headsets, phones and desktops at /vr (docs/vr.md), and a "
    "WebSocket for them and other clients (docs/protocol.md). "
    "A client may send 240 messages, 1000 frames, 20 control frames and 2 MiB a second, an address make 10 connections "
    "and requests a second (bursts and the rest: docs/security.md)."
)
EXAMPLE = "glsplat serve me.glb --port 8000"
SEE = "--write-config"

_MAX_WORKERS = 64

add_arguments = add_options


def check(args: ServeOptions) -> None:
    """Raise UsageError for options that contradict each other."""
    check_given(args)
    check_rooms(args)
    if args.video and args.study is not None:
        raise UsageError("video is not for studies: leave it or the study out")
    for given, fits in ((args.webtransport, "webtransport"), (args.bitrate is not None, "bitrate")):
        if given and (args.fixed or args.study is not None):
            other = "fixed sends" if args.fixed else "a study sends"
            raise UsageError(f"{fits} sends what fits the link, {other} the same to all: leave one out")
    if max(_pixels(args)) > args.max_size:
        raise UsageError(f"{args.label('size')}: needs at most {args.max_size} a side; raise max-size to allow more")


def server_config(args: ServeOptions, keys: Keys | None = None, watermark: WatermarkKey | None = None) -> ServerConfig:
    """Return the configuration of checked options, with TLS and token of ``keys``, or of the options without it.

    Raises GlsplatError naming the option or the file that does not fit.
    """
    keys = keys_of(args) if keys is None else keys
    access = Access(
        host=args.host,
        token=keys.token,
        accounts=keys.accounts,
        tls=keys.tls is not None,
        insecure=args.insecure,
        origins=tuple(args.origin),
        hosts=tuple(args.allow_host),
        proxies=tuple(args.trusted_proxy),
    )
    wire = WireOptions(
        size=_pixels(args), max_side=args.max_size, quality=args.quality, ipd=args.ipd, fov=args.fov, mirror=args.mirror
    )
    return ServerConfig(
        access=access,
        port=args.port,
        tls=keys.tls,
        wire=wire,
        session=SessionConfig(
            window=args.window,
            adapt=not args.fixed and args.study is None,  # all participants see the same
            bitrate=None if args.bitrate is None else args.bitrate * 1e6,
            watermark=watermark,
        ),
        limits=Limits(per_address=args.max_per_address, waiting=args.max_waiting),
        max_clients=args.max_clients,
        scene=_shown_name(args),
        fps=args.fps,
        private=args.private,
        video=args.video,
        webtransport=args.webtransport,
        fit=args.size is None and args.workers is None,
        rooms={room.name: room.seats for room in args.room},
    )


def _pixels(args: ServeOptions) -> tuple[int, int]:
    """Return width and height of an eye where requests name none."""
    return args.size or (min(1024, args.max_size),) * 2


def _shown_name(args: ServeOptions) -> str:
    """Return what the terminal and the status page call the scene."""
    return Path(args.scene).name if args.scene else "default avatar"


def scene_name(args: ServeOptions) -> str:
    """Return the scene's name among the avatars."""
    return Path(args.scene).stem if args.scene else "default"


def other_avatars(args: ServeOptions) -> dict[str, Rigged]:
    """Return the avatars of --avatar by file name. Raises UsageError for a taken name, or no avatar."""
    found: dict[str, Rigged] = {}
    label = args.label("avatar")
    for path in args.avatar:
        if path.stem in (scene_name(args), *found):
            raise UsageError(f'{label} {path}: there is a "{path.stem}" already, and clients choose by name; rename it')
        found[path.stem] = load_avatar(path, label, strict=args.strict)
    return found


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


def workers_of(args: ServeOptions) -> Workers | None:
    """Return the workers of --workers; None where the server itself draws.

    Raises UsageError, and GlsplatError where Ray is not installed.
    """
    if args.workers is None:
        return None
    from glsplat.extras.workers.cluster import require_ray  # here: few servers have workers
    from glsplat.extras.workers.pool import Workers

    kind, _, number = args.workers.partition(":")
    ray = kind == "ray"
    if args.ray_address is not None and not ray:
        raise UsageError("ray-address is for --workers ray")
    text = number if ray else args.workers
    if (
        (text or not ray) and not (text.isascii() and text.isdigit() and 1 <= int(text) <= _MAX_WORKERS)
    ) or args.workers == "ray:":
        raise UsageError(f"{args.label('workers')} needs 1 to {_MAX_WORKERS}, ray, or ray:N, not {args.workers!r:.40}")
    if ray:
        require_ray()
    return Workers(
        count=int(text) if text else None,
        ray=ray,
        cpus=args.worker_cpus,
        gpus=args.worker_gpus,
        address=args.ray_address,
    )


def run(args: ServeOptions) -> int:
    """Serve until SIGINT or SIGTERM; 0 after an orderly stop."""
    start_logging(args.log_format, logging.INFO if args.verbose else logging.WARNING)
    check(args)
    study = None
    if args.study is not None:
        from .study import study_of  # here: few servers lead studies

        study = study_of(args)
        args = study.options
    logging.getLogger("glsplat.net.session").setLevel(logging.INFO)  # a clip is traced by these lines
    keys, face = keys_of(args), _face_listener(args)
    server = _server(args, keys, face, study)
    tasks: list[asyncio.Future[None]] = []  # kept, or they would be dropped while they wait

    def started() -> None:
        endpoint = Endpoint(args.host, server.port, keys)
        if args.insecure and not endpoint.local:
            logging.getLogger("glsplat.serve").warning("anybody who reaches this port can use it (--insecure)")
        if args.json:
            fields = {"url": server.url, "port": server.port, "driver": server.drawer.driver}
            more = {} if study is None else {"study": study.fields(endpoint)}
            print(json.dumps(fields | {"page": endpoint.page(endpoint.names[0])} | more), flush=True)
        else:
            print(f"{_shown_name(args)}, drawn by {server.drawer.driver}")
            announce(endpoint, sys.stdout, args.qr, status=study is None)
            if study is not None:
                study.announce(endpoint, sys.stdout)
            if server.config.fit:
                tasks.append(asyncio.ensure_future(_announce_size(server)))
        if args.open:
            open_page(endpoint)

    with face or nullcontext(), naming_option(args, "device", ContextError):
        asyncio.run(server.run(started))
    return 0


def _face_listener(args: ServeOptions) -> FaceListener | None:
    """Return what listens at the port of face-osc. Raises GlsplatError where it is in use."""
    if args.face_osc is None:
        return None
    from glsplat.extras.speech.face import FaceFeed, FaceListener

    return FaceListener(FaceFeed(), args.face_osc)


def _server(args: ServeOptions, keys: Keys, face: FaceListener | None, study: ServedStudy | None) -> Server:
    """Read all files that the options name, and return the server. Raises GlsplatError naming the one that fails."""
    from .agreed import policy_of, signing  # here: it needs extras/consent
    from .wiring import assemble

    workers, uploads = workers_of(args), None
    if args.allow_upload is not None:
        from .photos import upload_config

        uploads = upload_config(args)
    config = server_config(args, keys, watermark_of(args))
    with naming_option(args, "scene"):
        scene = open_scene(args)
    args = replace(args, avatar=tuple(embedded_file(path) for path in args.avatar))
    avatars = other_avatars(args)
    policy = policy_of(args, scene, scene_name(args))
    calibration = None
    if args.calibration is not None:
        from glsplat.tracking.calibration import Calibration

        with naming_option(args, "calibration"):
            calibration = Calibration.load(args.calibration)
    served = ServedScene(
        file=scene,
        name=scene_name(args),
        title=DEFAULT if args.scene is None and study is None else "",
        avatars=avatars,
        rooms=lit_rooms(open_rooms(args), scene),
        rendering=RenderConfig(**detail_of(args)),
        tracking=TrackingOptions(
            calibration=calibration,
            solver=args.solver,
            idle=not args.no_idle and has_extra("speech"),
            face=None if face is None else face.feed,
        ),
    )
    return assemble(
        served,
        config,
        device=args.device,
        max_cost=args.max_cost,
        max_time=args.max_time,
        workers=workers,
        uploads=signing(uploads, policy),
        consent=policy,
        people=PEOPLE if args.scene is None and not args.avatar and study is None else (),
        features=[*([] if study is None else [study.lead]), *([voice_of(args)] if args.voice else [])],
    )


async def _announce_size(server: Server) -> None:
    if server.fitting is not None:
        await asyncio.wait([server.fitting])
    if (found := server.fitted) is not None:
        slow = "" if found.enough else ": less than moves smoothly; a GPU, or --size 256, helps"
        print(f"  {'pictures':<12}{found.side}x{found.side} an eye, about {found.rate:.0f} a second{slow}", flush=True)
