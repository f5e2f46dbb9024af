"""``glsplat preview``: show a scene or a moving avatar in a window."""

from __future__ import annotations

import argparse
import json
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from glsplat.camera import PAPER_FOV, PAPER_IPD, pinhole
from glsplat.config import RenderConfig
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats.motion_files import KINDS
from glsplat.formats.scene_file import SceneFile
from glsplat.motion.motion import Motion
from glsplat.optional import has_extra, missing
from glsplat.scene import skeleton_of
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose, load_pose
from glsplat.tracking.solvers import SOLVERS

from ..args import (
    add_detail,
    add_light,
    add_scene,
    add_solver,
    colour,
    detail_of,
    driven,
    open_scene,
    point,
    size,
    tracked,
    whole,
)
from ..output import save_png
from ..usage import UsageError
from .cameras import Options
from .connect import StreamedPictures, read_tracked
from .feed import feed_of
from .files import motion_names, read_motion
from .viewer import Viewer
from .window import Window

HELP = "Show a scene or a moving avatar in a window: orbit, fly, pose it by hand, in mono or stereo. H shows the keys."
EXAMPLE = "glsplat preview --motion walk --layout anaglyph"

_CLOCK_FPS = 30.0  # of the motion under --frames

VIEWS = ("mirror", "facing", "own")  # of glsplat.extras.openxr.placing, which may not be installed
_XR_ONLY = ("url", "view", "passthrough", "no_floor", "window", "scale", "record", "height", "calibration")
_NOT_XR = ("motion", "pose", "paused", "eye", "target", "connect", "recording", "numbers", "vsync")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_scene(parser)
    add_light(parser)
    parser.add_argument(
        "--motion", metavar="FILE", help=f"a motion: {KINDS}, or a name (default: an embedded one, if it fits)"
    )
    parser.add_argument("--pose", metavar="FILE", help="pose file (JSON) instead of a motion")
    parser.add_argument("--paused", action="store_true", help="start paused at the motion's first frame")
    parser.add_argument("--layout", choices=("mono", "side-by-side", "anaglyph"), default="mono", help="keys 1, 2, 3")
    parser.add_argument("--size", type=size, default=(1280, 720), help="WxH of the window (default 1280x720)")
    parser.add_argument("--fov", type=float, default=PAPER_FOV, help="vertical field of view in degrees (default 65)")
    parser.add_argument("--eye", type=point, metavar="X,Y,Z", help="position of the camera (default: all in view)")
    parser.add_argument("--target", type=point, metavar="X,Y,Z", help="point it looks at (default: the scene's centre)")
    parser.add_argument("--ipd", type=float, default=PAPER_IPD, help="metres between the eyes (default 0.055)")
    parser.add_argument("--background", type=colour, metavar="R,G,B", help="0 to 1 each (default 0,0,0)")
    add_detail(parser, lean=True)
    parser.add_argument("--numbers", action="store_true", help="start with the overlay of times and counts (key O)")
    parser.add_argument(
        "--vsync", action="store_true", help="draw at the refresh rate of the screen instead of as fast as possible"
    )
    parser.add_argument(
        "--frames", type=whole(1), metavar="N", help="show N pictures, 1/30 s apart in the motion, then exit"
    )
    parser.add_argument(
        "--screenshot", metavar="FILE", help="save the last picture (.png) and exit; implies --frames 1"
    )
    parser.add_argument("--json", action="store_true", help="on exit print driver, counts and stage times")
    server = parser.add_argument_group(
        "watch a running server", "SCENE is the scene of the server, for skeleton and view"
    )
    server.add_argument("--connect", metavar="URL", help="show the pictures of `glsplat serve` at ws://HOST:PORT/ws")
    server.add_argument(
        "--recording",
        nargs="?",
        const="",
        metavar="FILE",
        help="send head and hands (.jsonl; default: the embedded recording) instead of poses: the server solves",
    )
    server.add_argument("--quality", type=whole(1, 100), help="JPEG quality, 1 to 100 (default: the server's)")
    server.add_argument("--token-file", type=Path, metavar="FILE", help="token of the server")
    server.add_argument("--tls-ca", type=Path, metavar="PEM", help="certificate to trust on wss://")
    group = parser.add_argument_group("on a headset", "by OpenXR: SteamVR, Link, WiVRn, Monado; docs/openxr.md")
    group.add_argument("--xr", action="store_true", help="show on this computer's headset; the wearer moves the avatar")
    group.add_argument("--url", metavar="URL", help="show the pictures of `glsplat serve` at ws://HOST:PORT/ws")
    group.add_argument("--view", choices=VIEWS, help="view at the start (default mirror); button A or X switches")
    group.add_argument(
        "--passthrough", action="store_true", help="show the real room around the wearer, if the headset can"
    )
    group.add_argument("--no-floor", action="store_true", help="draw no floor")
    group.add_argument("--window", action="store_true", help="mirror the wearer's view in a window (--size)")
    group.add_argument("--scale", type=float, metavar="F", help="factor of the headset's picture size (default 1)")
    group.add_argument("--record", metavar="FILE", help="record head, hands and other tracked data (.jsonl)")
    group.add_argument("--height", type=float, help="height of the wearer in metres (default: estimated from motion)")
    group.add_argument(
        "--calibration", metavar="JSON", help="calibration of `glsplat tracking calibrate`, instead of --height"
    )
    add_solver(group)  # type: ignore[arg-type]


def run(args: argparse.Namespace) -> int:
    """Show the window until it is closed."""
    frames = _frames(args)
    scene = open_scene(args)
    if args.xr:
        from . import headset  # here: it needs extras/openxr

        return headset.run(args, scene, frames)
    drive = _drive(args, scene)
    rendering = RenderConfig(**detail_of(args))
    label = args.connect or ("default avatar" if args.scene is None else Path(args.scene).name)
    with ExitStack() as stack:
        feed = feed_of(args, args.connect)
        if feed is not None:
            feed.start()
            stack.callback(feed.close)
        window = stack.enter_context(Window(args.size, f"glsplat: {label}", args.vsync))
        options = Options(
            layout=args.layout,
            fov=args.fov,
            ipd=args.ipd,
            background=args.background or scene.background,
            eye=args.eye,
            target=args.target,
            numbers=args.numbers,
            text_scale=window.text_scale,
            rendering=rendering,
        )
        pictures = None
        if feed is not None:
            feed.wake = window.wake
            stack.callback(feed.close)  # before the window is destroyed, which it wakes
            pictures = StreamedPictures(feed, window.context.ctx)
        viewer = Viewer(scene, window.context, window.size, options, label, pictures)
        stack.callback(viewer.release)
        _start(args, drive, viewer)
        window.attach(viewer)
        loop(window, viewer, frames)
        report = viewer.report()  # before the screenshot draws another frame
        if args.screenshot:
            save_png(args.screenshot, viewer.capture())
        if args.json:
            print(json.dumps(report))
    return 0


def loop(window: Window, viewer: Viewer, frames: int | None = None) -> None:
    """Draw whenever the picture changes, else sleep. ``frames``: draw that many at a fixed rate, then return."""
    drawn, last = 0, time.perf_counter()
    while frames is None or drawn < frames:
        visible = min(window.size) > 0
        busy = visible and (viewer.animating or viewer.dirty)
        period = viewer.pictures.period_s if frames is None else 0.0
        window.wait(period if busy or frames is not None else viewer.timeout)
        if window.closing or viewer.closing:
            return
        now = time.perf_counter()
        if frames is None:
            # the time asleep does not count for a motion that starts now
            viewer.advance(now - last if busy or not viewer.animating else 0.0)
        else:
            viewer.advance(1 / _CLOCK_FPS if drawn else 0.0)
            viewer.wait_ready()
            viewer.expose()
        last = now
        if viewer.dirty and viewer.refresh(window.framebuffer):
            window.swap()
            drawn += 1


def _frames(args: argparse.Namespace) -> int | None:
    """Return the number of pictures (None: no limit). Raises for invalid options before a window opens."""
    pinhole(1, 1, args.fov)
    check_headset(args)
    _check_connect(args)
    if args.screenshot is None:
        return args.frames
    path = Path(args.screenshot)
    if path.suffix.lower() != ".png":
        raise UsageError(f"--screenshot {path}: the name needs to end in .png")
    if not path.parent.is_dir():
        raise FormatError(f"{path}: there is no folder {path.parent}; create it first")
    return args.frames or 1


def check_headset(args: argparse.Namespace) -> None:
    """Raise UsageError for options that contradict each other, GlsplatError without OpenXR's extra."""
    if not args.xr:
        for name in _XR_ONLY:
            if getattr(args, name) not in (None, False):
                raise UsageError(f"--{name.replace('_', '-')} goes with --xr")
        return
    if not has_extra("openxr"):
        raise GlsplatError(missing("openxr", "--xr"))
    for name in _NOT_XR:
        if getattr(args, name) not in (None, False):
            hint = "; a server's pictures there: --url" if name == "connect" else ": its wearer moves the avatar"
            raise UsageError(f"--{name} does not go with --xr{hint}")
    if args.height is not None and (args.calibration is not None or args.url is not None):
        raise UsageError("--height goes neither with --calibration nor with --url, where the address has height=METRES")
    if args.scale is not None and not 0.05 <= args.scale <= 4:
        raise UsageError(f"--scale needs 0.05 to 4, not {args.scale:g}")
    if args.record is not None and not args.record.lower().endswith(".jsonl"):
        raise UsageError(f"--record {args.record}: the name needs to end in .jsonl")
    if args.url is None and (args.token_file is not None or args.tls_ca is not None or args.quality is not None):
        raise UsageError("--token-file, --tls-ca and --quality go with --url")
    if args.url is not None:
        given = any(getattr(args, name) is not None for name in ("light", "level", "lod_bias", "calibration"))
        if given or args.cull_hidden or args.exact or args.solver != SOLVERS[0]:
            raise UsageError(
                "--light, --level, --lod-bias, --cull-hidden, --exact, --calibration and --solver do not go with --url:"
                " a server decides"
            )
    if args.background is not None and (args.url is not None or args.passthrough):
        raise UsageError("--background does not go with --url and --passthrough: there it is black, or the room")


def _check_connect(args: argparse.Namespace) -> None:
    """Raise UsageError for options that do not go with or without --connect."""
    if args.xr:
        return
    if args.connect is None:
        for name in ("recording", "quality", "token_file", "tls_ca"):
            if getattr(args, name) is not None:
                raise UsageError(f"--{name.replace('_', '-')} goes with --connect; without a server, see --motion")
    elif args.background is not None:
        raise UsageError("--background does not go with --connect: a server's pictures are on black")
    elif args.light is not None:
        raise UsageError("--light does not go with --connect: the server lights its pictures (serve --light)")
    elif detail_of(args) != detail_of(argparse.Namespace(level=None, lod_bias=None, cull_hidden=False, exact=False)):
        raise UsageError("--level, --lod-bias, --cull-hidden and --exact do not go with --connect: a server decides")


def _drive(args: argparse.Namespace, scene: SceneFile) -> Pose | Motion | None:
    """Return the pose or motion of the options; None without them. Raises before a window opens.

    Prints a notice if no option is given and no embedded motion fits the avatar.
    """
    given = {name: getattr(args, name) for name in ("pose", "motion", "recording")}
    asked = [name for name, value in given.items() if value is not None]
    if len(asked) > 1:
        raise UsageError("give one of --pose, --motion and --recording")
    name = args.scene or "the default avatar"
    if not asked:
        if scene.avatar is not None and (why := why_not_driven(skeleton_of(scene.avatar.content))):
            print(f"glsplat preview: {name}: no motion can drive this avatar: {why}; it stands still", file=sys.stderr)
        return None
    skeleton = driven(scene, f"--{asked[0]}").skeleton
    if asked[0] == "pose":
        return load_pose(args.pose, skeleton)
    if asked[0] == "recording" or args.motion.lower().endswith(".jsonl"):
        tracked(skeleton, name)
    return read_tracked(args.recording or None) if asked[0] == "recording" else read_motion(args.motion, skeleton)


def _start(args: argparse.Namespace, drive: Pose | Motion | None, viewer: Viewer) -> None:
    """Start the pose or motion of the options, of the scene file, or the first embedded motion that fits."""
    if args.paused:
        viewer.others.moving = False
    if viewer.player is None:
        return
    if isinstance(drive, Pose):
        viewer.player.hold(drive)
    elif drive is not None:
        viewer.player.play(drive)
    elif viewer.player.idle and motion_names(viewer.player.skeleton):
        viewer.next_motion()
    viewer.player.playing &= not args.paused
