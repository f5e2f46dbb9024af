"""The options of ``glsplat preview --xr``, which are there without OpenXR's extra."""

from __future__ import annotations

import argparse

from glsplat.errors import GlsplatError
from glsplat.optional import has_extra, missing
from glsplat.tracking.solvers import SOLVERS

from ..args import add_solver
from ..usage import UsageError

VIEWS = ("mirror", "facing", "own")  # of glsplat.extras.openxr.placing
_XR_ONLY = ("url", "view", "passthrough", "no_floor", "window", "scale", "record", "height", "calibration")
_NOT_XR = ("motion", "pose", "paused", "eye", "target", "connect", "recording", "numbers", "vsync")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --xr and its options."""
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


def check(args: argparse.Namespace) -> None:
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
