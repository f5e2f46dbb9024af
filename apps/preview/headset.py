"""``glsplat preview --xr``: show a scene, or a server's pictures, on this computer's headset (docs/openxr.md)."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError
from glsplat.extras.openxr.local import LocalShow
from glsplat.extras.openxr.openxr.graphics import EGL_ENABLE
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime, offered
from glsplat.extras.openxr.session import Session
from glsplat.extras.openxr.wearer import Wearer
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context, create_context
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.recording import record
from glsplat.tracking.sample import Sample

from ..args import detail_of, driven
from ..output import Image, save_png
from ..usage import UsageError
from .feed import Feed, feed_of
from .headset_feed import FeedShow
from .player import Others
from .window import Window

_MAX_SAMPLES = 72 * 60 * 30  # of a recording: half an hour


def run(
    args: argparse.Namespace,
    scene: SceneFile,
    frames: int | None,
    connect: Callable[[Context, bool], OpenXrRuntime] | None = None,  # default: this computer's OpenXR runtime
) -> int:
    """Show the scene until the runtime, the window or Ctrl-C ends the session."""
    samples: list[Sample] = []
    room = args.url is not None and bool(parse_qs(urlsplit(args.url).query).get("room"))  # the address has one
    wearer = Wearer(args.view or "mirror", room=room, heard=_recorder(args.record, samples))
    known = offered() if connect is None else frozenset({EGL_ENABLE})  # raises if there is no runtime
    make = connect or OpenXrRuntime
    with ExitStack() as stack:

        def save_samples() -> None:
            if samples:
                print(f"{args.record}: {record(args.record, samples)} samples", file=sys.stderr)

        stack.callback(save_samples)  # last, however the session ends; without --record there are none
        feed = feed_of(args, args.url)
        if feed is not None:
            feed.start()
            stack.callback(feed.close)
        window = None
        if args.window or EGL_ENABLE not in known:
            window = stack.enter_context(Window(args.size, "glsplat: what the wearer sees", visible=args.window))
            context = window.context
        else:
            context = create_context()
            stack.callback(context.release)
        stack.enter_context(context)
        show = _show(args, scene, feed, context, wearer)
        stack.callback(show.release)
        session = Session(lambda: make(context, args.passthrough), show, say=_say)
        stack.callback(session.close)
        _choose_blend(args, session)
        loop(session, show, window if args.window else None, frames)
        report = _report(session, show)
        if args.screenshot:
            save_png(args.screenshot, _picture(context, show))
        if args.json:
            print(json.dumps(report))
    return 0


def loop(
    session: Session,
    show: LocalShow | FeedShow,
    window: Window | None,
    frames: int | None,
) -> None:
    """Step until the session ends; the window shows the left eye of each new picture."""
    shown = -1
    try:
        while session.step():
            if frames is not None and session.rendered >= frames:
                session.quit()
            if window is None:
                continue
            window.wait(0)
            if window.closing:
                session.quit()
            if session.rendered != shown and min(window.size) > 0:
                shown = session.rendered
                if show.look(window.framebuffer, window.size):
                    window.swap()
    except KeyboardInterrupt:
        session.quit()
        while session.step():
            pass


def _show(
    args: argparse.Namespace, scene: SceneFile, feed: Feed | None, context: Context, wearer: Wearer
) -> LocalShow | FeedShow:
    how = {"scale": args.scale or 1.0, "floor": not args.no_floor, "transparent": args.passthrough}
    if feed is not None:
        return FeedShow(feed, context, wearer, say=_say, **how)
    calibration = None if args.calibration is None else Calibration.load(args.calibration)
    if args.height is not None:
        calibration = Calibration.of_height(driven(scene, "--height").skeleton, args.height)
    show = LocalShow(
        scene,
        context,
        wearer,
        config=RenderConfig(**detail_of(args)),
        background=args.background or scene.background,
        calibration=calibration,
        solver=args.solver,
        advance=Others(scene, scene.avatar).advance,
        timed=args.json,
        **how,
    )
    if not show.solved:
        _say(f"{args.scene}: nothing in it that its wearer could move; it is looked at")
    return show


def _choose_blend(args: argparse.Namespace, session: Session) -> None:
    """Set the blend mode of --passthrough. Raises ContextError if the runtime has none."""
    runtime = session.runtime
    if runtime is None or not args.passthrough:
        return
    found = next((blend for blend in ("alpha", "additive") if blend in runtime.blends), None)
    if found is None:
        raise ContextError(f"{runtime.name} shows no room around the wearer; leave --passthrough out")
    session.blend = "alpha" if found == "alpha" else "additive"


def _recorder(name: str | None, samples: list[Sample]) -> Callable[[Sample], None]:
    """Return a function that appends up to _MAX_SAMPLES samples for --record."""
    if name is None:
        return lambda _: None
    if not Path(name).absolute().parent.is_dir():
        raise UsageError(f"--record {name}: there is no such folder; create it first")

    def keep(sample: Sample) -> None:
        if len(samples) < _MAX_SAMPLES:
            samples.append(sample)
            if len(samples) == _MAX_SAMPLES:
                _say(f"{name} is full; the session goes on")

    return keep


def _report(session: Session, show: LocalShow | FeedShow) -> dict[str, Any]:
    runtime = session.runtime
    out: dict[str, Any] = {
        "runtime": "" if runtime is None else runtime.name,
        "extensions": [] if runtime is None else sorted(runtime.extensions),
        "frames": session.frames,
        "rendered": session.rendered,
        "losses": session.losses,
        "overhead_ms": round(session.overhead_ms, 3),
        "view": show.wearer.view,
    }
    if isinstance(show, FeedShow):
        return out | {"pictures": show.pictures, "age_ms": round(show.age_ms, 3)}
    renderer = show.renderer
    times = {stage: round(ms, 3) for stage, ms in renderer.timings.items()} | {"copy": round(show.copy_ms, 3)}
    return out | {"driver": renderer.driver, "size": renderer.size, "timings_ms": times}


def _picture(context: Context, show: LocalShow | FeedShow) -> Image:
    """Return both eyes of the last picture, side by side. Raises GlsplatError if there was none."""
    if show.eyes is None or not show.eyes.filled:
        raise GlsplatError("--screenshot: the wearer saw no picture")
    pictures, size = [], show.eyes.size
    with ExitStack() as stack:
        texture = context.ctx.texture(size, 4)
        stack.callback(texture.release)
        framebuffer = context.ctx.framebuffer([texture])
        stack.callback(framebuffer.release)
        for eye in (0, 1):
            show.look(framebuffer, size, eye)
            pictures.append(np.frombuffer(texture.read(), np.uint8).reshape(size[1], size[0], 4)[::-1, :, :3])
        context.scratch.use()
    return np.concatenate(pictures, axis=1)


def _say(text: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr)
