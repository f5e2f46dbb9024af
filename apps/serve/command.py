"""``glsplat serve``: the headless render server."""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import sys
from contextlib import nullcontext
from pathlib import Path

from glsplat.camera import PAPER_FOV, PAPER_IPD
from glsplat.config import RenderConfig
from glsplat.data import DEFAULT, PEOPLE, embedded_file
from glsplat.errors import GlsplatError
from glsplat.extras.speech.face.feed import FaceFeed
from glsplat.extras.speech.face.listener import FaceListener
from glsplat.extras.watermark.mark import WatermarkKey
from glsplat.net.backends.gl import MAX_TIME
from glsplat.net.gl_server import make_server
from glsplat.net.guard.access import Access
from glsplat.net.guard.forwarded import Network, proxy_network
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import WireOptions
from glsplat.net.options import ServerConfig
from glsplat.net.server import Server
from glsplat.net.session import SessionConfig
from glsplat.scene import Rigged
from glsplat.tracking.calibration import Calibration

from ..args import add_detail, add_light, add_scene, add_solver, detail_of, load_avatar, open_scene, size
from ..logs import add_log_format, start_logging
from ..usage import UsageError
from .agreed import add_consent, policy_of, signing
from .keys import Keys, add_keys, keys_of, watermark_of
from .photos import add_photos, upload_config
from .ready import Place, add_ready, announce, open_page
from .rooms import add_rooms, check_rooms, lit_rooms, open_rooms
from .settings import add_settings, parsed, written
from .study import add_study, study_of
from .workers import add_workers, workers_of

HELP = (
    "Serve pictures of an avatar: a page for the browsers of headsets, phones and desktops at /vr (docs/vr.md), and a "
    "WebSocket for them and other clients (docs/protocol.md). "
    "A client may send 240 messages, 1000 frames, 20 control frames and 2 MiB a second, an address make 10 connections "
    "and requests a second (bursts and the rest: docs/deploying.md, Limits)."
)
EXAMPLE = "glsplat serve me.glb --port 8000"
__all__ = ["EXAMPLE", "HELP", "add_arguments", "check", "other_avatars", "parsed", "run", "scene_name", "server_config"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    add_scene(parser)
    add_light(parser)
    parser.add_argument(
        "--avatar",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="another avatar that clients may choose, by the file's name without its suffix; may be repeated "
        "(the first and what they see unasked is SCENE, the embedded one is called default)",
    )
    add_rooms(parser)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1, this machine)")
    parser.add_argument("--port", type=int, default=8000, help="port (default 8000; 0: any free one)")
    parser.add_argument(
        "--size",
        type=size,
        help="pixels an eye where requests name none, and what the page begins with (default: the largest of 1024, 768 "
        "and 512 that is drawn 15 times a second here, found out at the start)",
    )
    parser.add_argument("--max-size", type=int, default=2048, help="largest side a request may ask for (default 2048)")
    parser.add_argument("--quality", type=int, default=80, help="JPEG quality where requests name none (default 80)")
    parser.add_argument("--max-clients", type=int, default=8, help="clients at once (default 8)")
    parser.add_argument(
        "--max-per-address",
        type=int,
        metavar="N",
        help="clients of one address (default: half of --max-clients, on loopback without --trusted-proxy all)",
    )
    parser.add_argument(
        "--max-waiting", type=int, default=64, metavar="N", help="connections that are not yet clients (default 64)"
    )
    parser.add_argument("--window", type=int, default=2, help="pictures under way a client (default 2)")
    parser.add_argument("--ipd", type=float, default=PAPER_IPD, help="metres between the eyes, for requests with heads")
    parser.add_argument("--fov", type=float, default=PAPER_FOV, help="vertical degrees, for requests with heads")
    parser.add_argument(
        "--mirror", action="store_true", help="show the mirror image (clients may choose by /ws?mirror=)"
    )
    parser.add_argument(
        "--max-cost",
        type=float,
        metavar="PIXELS",
        help="pixels a picture may cover, splat by splat and eye by eye (default 5e8, with --exact 1e9: a person who "
        "fills two eyes of 2048x2048 covers 0.5e8 to 2.3e8, with --exact 0.9e8 to 4.2e8); dearer ones are refused, "
        "and clients that keep asking are dropped",
    )
    parser.add_argument(
        "--max-time",
        type=float,
        default=MAX_TIME,
        metavar="SECONDS",
        help="a picture may take (default 5); one that takes longer is abandoned, a second one ends its client",
    )
    add_detail(parser, lean=True)
    parser.add_argument(
        "--fps",
        type=float,
        metavar="N",
        help="hold N pictures a second a client: coarser levels of detail first, then smaller pictures, as replies say",
    )
    parser.add_argument(
        "--bitrate",
        type=float,
        metavar="MBIT",
        help="at most so many Mbit/s for each client that says when pictures arrive (default: what its link takes)",
    )
    parser.add_argument(
        "--fixed",
        action="store_true",
        help="do not fit size and quality to the links of clients that say when pictures arrive, as the page does",
    )
    parser.add_argument(
        "--video",
        action="store_true",
        help="clients that can decode it, as the page can, get video instead of JPEGs: far fewer bytes, more of a "
        "core; needs `pip install 'glsplat[video]'`",
    )
    parser.add_argument(
        "--webtransport",
        action="store_true",
        help="send pictures over links of 8 ms and more by datagrams to clients that can have them so, as the page in "
        "Chromium can: a lost packet holds nothing back; listens to UDP at the number of --port, too; needs "
        "`pip install 'glsplat[webtransport]'`",
    )
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="of the users whose tracking is sent")
    add_solver(parser)
    parser.add_argument(
        "--no-idle", action="store_true", help="eyes of tracked users that no sensor sees neither look around nor blink"
    )
    parser.add_argument("--private", action="store_true", help="show nobody who the clients are and what they see")
    parser.add_argument(
        "--face-osc",
        type=int,
        metavar="PORT",
        help="take the face of who wears the headset from VRCFaceTracking on this machine, at this UDP port of "
        "127.0.0.1 (it sends to 9000 unless told otherwise)",
    )
    add_photos(parser)
    add_study(parser)
    add_consent(parser)
    add_keys(parser)
    parser.add_argument("--origin", action="append", default=[], help="web page that may connect; may be repeated")
    parser.add_argument(
        "--allow-host", action="append", default=[], metavar="NAME", help="name it goes by; may be repeated, *.NAME too"
    )
    parser.add_argument(
        "--trusted-proxy",
        type=_proxy,
        action="append",
        default=[],
        metavar="CIDR",
        help="address or network of a reverse proxy; limits then count for the clients that its X-Forwarded-For or "
        "Forwarded headers name; may be repeated",
    )
    parser.add_argument("--insecure", action="store_true", help="listen beyond this machine without TLS and token")
    parser.add_argument("--device", help="EGL device: index or part of its name (also GLSPLAT_DEVICE); --workers: a,b")
    add_workers(parser)
    add_ready(parser)
    add_log_format(parser)
    parser.add_argument("--verbose", action="store_true", help="log tracebacks of failed pictures")
    add_settings(parser)


def check(args: argparse.Namespace) -> None:
    """Raises UsageError naming the option that does not fit."""
    limits = {
        "--port": (args.port, 0, 65535),
        "--max-size": (args.max_size, 1, 8192),
        "--quality": (args.quality, 1, 100),
    }
    limits |= {"--max-clients": (args.max_clients, 1, 256), "--window": (args.window, 1, 8)}
    limits |= {"--max-waiting": (args.max_waiting, 2, 4096)}
    if args.face_osc is not None:
        limits["--face-osc"] = (args.face_osc, 0, 65535)
    if args.max_per_address is not None:
        limits["--max-per-address"] = (args.max_per_address, 1, 256)
    for name, (value, low, high) in limits.items():
        if not low <= value <= high:
            raise UsageError(f"{name} needs {low} to {high}, not {value}")
    if (args.max_cost is not None and not args.max_cost > 0) or not 0.1 <= args.max_time <= 600:
        raise UsageError("--max-cost needs a number of pixels above 0 and --max-time 0.1 to 600 s")
    check_rooms(args)
    if args.fps is not None and not 1 <= args.fps <= 240:
        raise UsageError(f"--fps needs 1 to 240 pictures a second, not {args.fps:g}")
    if args.bitrate is not None and not 0.1 <= args.bitrate <= 1e5:
        raise UsageError(f"--bitrate needs 0.1 to 100000 Mbit/s, not {args.bitrate:g}")
    if args.video and args.study is not None:
        raise UsageError("--video is not for studies: leave it or --study out")
    for given, fits in ((args.webtransport, "--webtransport"), (args.bitrate is not None, "--bitrate")):
        if given and (args.fixed or args.study is not None):
            other = "--fixed" if args.fixed else "--study"
            raise UsageError(f"{fits} sends what fits the link, and {other} the same to all: leave one out")
    if not 0 <= args.ipd <= 0.2 or not 1 <= args.fov <= 170:
        raise UsageError("--ipd needs 0 to 0.2 m and --fov 1 to 170 degrees")
    if max(_pixels(args)) > args.max_size:
        raise UsageError(f"--size needs at most {args.max_size} a side; raise --max-size to allow more")


def server_config(
    args: argparse.Namespace, keys: Keys | None = None, watermark: WatermarkKey | None = None
) -> ServerConfig:
    """The checked configuration, with TLS and token of ``keys``, else those that the arguments name.

    Raises GlsplatError naming the option or the file that does not fit.
    """
    check(args)
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
        scene=Path(args.scene).name if args.scene else "default avatar",
        fps=args.fps,
        private=args.private,
        video=args.video,
        webtransport=args.webtransport,
        fit=args.size is None and args.workers is None,
        rooms={room.name: room.seats for room in args.room},
    )


def _proxy(text: str) -> Network:
    """argparse type: the network of a trusted proxy."""
    try:
        return proxy_network(text)
    except GlsplatError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _pixels(args: argparse.Namespace) -> tuple[int, int]:
    """Width and height of an eye where requests name none."""
    return args.size or (min(1024, args.max_size),) * 2


def scene_name(args: argparse.Namespace) -> str:
    """What clients call the scene among the avatars."""
    return Path(args.scene).stem if args.scene else "default"


def other_avatars(args: argparse.Namespace) -> dict[str, Rigged]:
    """The avatars of --avatar by the names of their files. Raises UsageError for two of one name and for none."""
    found: dict[str, Rigged] = {}
    for path in args.avatar:
        if path.stem in (scene_name(args), *found):
            raise UsageError(
                f'--avatar {path}: there is a "{path.stem}" already, and clients choose by name; rename it'
            )
        found[path.stem] = load_avatar(path, "--avatar", strict=args.strict)
    return found


def run(args: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; 0 after an orderly stop."""
    if args.write_config:
        parser = argparse.ArgumentParser()
        add_arguments(parser)
        print(written(parser), end="")
        return 0
    start_logging(args.log_format, logging.INFO if args.verbose else logging.WARNING)
    check(args)
    study = study_of(args)
    workers = workers_of(args)
    keys = keys_of(args)
    config = server_config(args, keys, watermark_of(args))
    logging.getLogger("glsplat.net.session").setLevel(logging.INFO)  # a clip is traced by these lines
    scene = open_scene(args)
    args.avatar = [embedded_file(path) for path in args.avatar]
    avatars = other_avatars(args)
    policy = policy_of(args, scene, scene_name(args))
    calibration = Calibration.load(args.calibration) if args.calibration else None
    face = None if args.face_osc is None else FaceListener(FaceFeed(), args.face_osc)
    server = make_server(
        scene,
        config,
        args.device,
        calibration,
        rendering=RenderConfig(**detail_of(args)),
        budget=(args.max_cost, args.max_time),
        name=scene_name(args),
        title=DEFAULT if args.scene is None and study is None else "",
        avatars=avatars,
        uploads=signing(upload_config(args), policy),
        consent=policy,
        solver=args.solver,
        rooms=lit_rooms(open_rooms(args), scene),
        workers=workers,
        idle=not args.no_idle,
        face=None if face is None else face.feed,
        features=() if study is None else (study.lead,),
        people=PEOPLE if args.scene is None and not args.avatar and study is None else (),
    )

    tasks: list[asyncio.Future[None]] = []  # kept, or they would be dropped while they wait

    def started() -> None:
        place = Place(args.host, server.port, keys)
        if args.insecure and not place.local:
            logging.getLogger("glsplat.serve").warning("anybody who reaches this port can use it (--insecure)")
        if args.json:
            fields = {"url": server.url, "port": server.port, "driver": server.drawer.driver}
            more = {} if study is None else {"study": study.fields(place)}
            print(json.dumps(fields | {"page": place.page(place.names[0])} | more), flush=True)
        else:
            print(f"{config.scene}, drawn by {server.drawer.driver}")
            announce(place, sys.stdout, args.qr, status=study is None)
            if study is not None:
                study.announce(place, sys.stdout)
            if config.fit:
                tasks.append(asyncio.ensure_future(_announce_size(server)))
        if args.open:
            open_page(place)

    with face or nullcontext():
        asyncio.run(server.run(started))
    return 0


async def _announce_size(server: Server) -> None:
    if server.fitting is not None:
        await asyncio.wait([server.fitting])
    if (found := server.fitted) is not None:
        slow = "" if found.enough else ": less than moves smoothly; a GPU, or --size 256, helps"
        print(f"  {'pictures':<12}{found.side}x{found.side} an eye, about {found.rate:.0f} a second{slow}", flush=True)
