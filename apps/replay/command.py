"""``glsplat replay``: stream a motion through a server and report latency by stage."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import sys
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.data import default_avatar
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats.motion_files import KINDS
from glsplat.motion.motion import Motion
from glsplat.net.client import Client
from glsplat.net.flow import POLICIES
from glsplat.net.guard.access import read_token
from glsplat.net.reply import Reply
from glsplat.skinning.pose import EXPRESSION
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.tracking.recording import embedded_recording
from glsplat.tracking.recording import replay as read_samples
from glsplat.tracking.sample import Sample

from ..args import Number, load_avatar, motion_of, size, tracked, whole
from ..clip import CLIPS, Clip
from ..output import label, save_png, side_by_side, stack
from ..progress import Progress
from ..usage import UsageError, output_kind
from .crowd import add_crowd, check_crowd, connection, crowd_text, names_of, requested, stream_crowd
from .link import Link, link, over
from .stage_table import comparison_markdown, frame_text, table_text
from .streaming import Drive, Driven, Result, stream

HELP = "Stream recorded head and hands, or a motion, through a server; report latency by stage and save pictures."
EXAMPLE = "glsplat replay --url ws://127.0.0.1:8000/ws --save sheet.png"

_MOTION = "wave-and-turn"  # of an avatar without a given one
_TRACKING_RATE_HZ = 72.0  # of a headset's samples
_ROOT_WINDOW_S = 2.0  # over which head positions are averaged to estimate where the user stands
_MOMENTS = 6  # pairs on a contact sheet
_TILE_WIDTH_PX = 1024  # of a pair on a contact sheet
_MAX_SECONDS = 86_400


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "motion",
        nargs="?",
        metavar="RECORDING|MOTION",
        help=f"tracking samples (.jsonl), or a motion sent as poses ({KINDS}, or a name); "
        "default: the embedded recording",
    )
    parser.add_argument("--url", default="ws://127.0.0.1:8000/ws", help="server (default ws://127.0.0.1:8000/ws)")
    parser.add_argument("--avatar", metavar="FILE", help="avatar of the server, for the motion's skeleton")
    parser.add_argument(
        "--tracking", action="store_true", help="send only head and hands of a motion; the server solves the pose"
    )
    parser.add_argument(
        "--fps", type=Number(1, 240), default=72.0, help="requests and display refreshes per second (default 72)"
    )
    parser.add_argument("--frames", type=whole(1), help="number of requests (default: one play, at most 20 s)")
    parser.add_argument("--seconds", type=float, metavar="S", help="play for S seconds, repeating if it is shorter")
    parser.add_argument("--loop", action="store_true", help="repeat, for --seconds or until Ctrl-C")
    parser.add_argument(
        "--window", type=whole(1, 8), help="unanswered requests (default: set by the server; 2 for fifo)"
    )
    parser.add_argument(
        "--fixed", action="store_true", help="do not report arrivals, so that the server adapts nothing"
    )
    parser.add_argument(
        "--policy", choices=POLICIES, default=POLICIES[0], help="when to send requests (default mailbox)"
    )
    parser.add_argument("--compare", action="store_true", help="compare the policies in a table, one run each")
    parser.add_argument(
        "--link",
        type=link,
        action="append",
        metavar="RTT,MBIT[,LOSS]",
        help="simulate a link: ms, Mbit/s, %% of lost packets",
    )
    parser.add_argument("--size", type=size, default=(1024, 1024), help="pixels per eye (default 1024x1024)")
    parser.add_argument("--quality", type=whole(1, 100), help="JPEG quality (default: the server's)")
    parser.add_argument("--crop", action="store_true", help="request only the covered part of each picture")
    parser.add_argument("--mirror", action="store_true", help="request the mirror image")
    add_crowd(parser)
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="token of the server")
    parser.add_argument("--tls-ca", type=Path, metavar="PEM", help="certificate to trust on wss://")
    parser.add_argument("--save", metavar="OUT", help="a folder/ of PNG, a clip .mp4 or .webm (VP9), a sheet .png")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(args: argparse.Namespace) -> int:
    """Stream, report, save. Raises GlsplatError if no picture arrives."""
    if args.seconds is not None and not 0 < args.seconds <= _MAX_SECONDS:
        raise UsageError(f"--seconds needs more than 0 and at most {_MAX_SECONDS}, not {args.seconds:g}")
    if args.frames is not None and (args.seconds is not None or args.loop):
        raise UsageError("--frames says how long it plays: leave out --seconds and --loop, or --frames")
    if args.loop and args.seconds is None and (args.save or args.compare or args.link):
        raise UsageError("--loop until Ctrl-C leaves no report: with --save, --compare or --link give --seconds, too")
    check_crowd(args)
    several = args.compare or len(args.link or ()) > 1
    if args.save and several:
        raise UsageError("--save goes with a single run, not with --compare or several --link")
    if args.save:
        check_target(args.save)
    token = read_token(args.token_file) if args.token_file else None
    drive, seconds = load_drive(args.motion, args.avatar, args.tracking or args.room is not None, "MOTION")
    if args.loop and args.seconds is None:
        with contextlib.suppress(KeyboardInterrupt):
            while True:  # separate runs, so that results do not accumulate
                frames = max(1, round(seconds * args.fps))
                if args.room is not None:
                    check_shown(asyncio.run(stream_crowd(args, token, drive, frames)))
                else:
                    check_shown([asyncio.run(_stream(args, token, None, args.policy, drive, frames))])
        return 0
    frames = args.frames or max(1, round((min(seconds, 20.0) if args.seconds is None else args.seconds) * args.fps))
    if args.room is not None:
        results = asyncio.run(stream_crowd(args, token, drive, frames))
        _report_crowd(args, results)
        check_shown(results)
        return 0
    policies = POLICIES if args.compare else (args.policy,)
    runs = []
    for simulated in args.link or (None,):
        for policy in policies:
            result = asyncio.run(_stream(args, token, simulated, policy, drive, frames))
            runs.append((str(simulated or "as it is"), policy, result))
    if several:
        _report_several(args, runs)
    else:
        _report(args, runs[0][2])
    check_shown([result for _, _, result in runs])
    return 0


def check_shown(results: Sequence[Result]) -> None:
    """Raise GlsplatError if a run showed no picture."""
    failed = next((result for result in results if not result.shown), None)
    if failed is not None:
        raise GlsplatError(f"no picture came{f': {failed.last_error}' if failed.last_error else ''}")


def _report_crowd(args: argparse.Namespace, results: Sequence[Result]) -> None:
    saved = save_pictures(args.save, results[0]) if args.save and results[0].kept else ""
    names = names_of(args)
    if args.json:
        print(json.dumps([{"name": name, **result.summary()} for name, result in zip(names, results, strict=True)]))
        return
    print(f'{args.url}, room "{args.room}", {args.size[0]}x{args.size[1]} an eye, drawn by {results[0].driver}')
    print(crowd_text(names, results))
    if saved:
        print(saved)


def _report(args: argparse.Namespace, result: Result) -> None:
    if args.save and result.kept:
        saved = save_pictures(args.save, result)
    if args.json:
        print(json.dumps(result.summary()))
        return
    print(f"{args.url}, {args.size[0]}x{args.size[1]} an eye, drawn by {result.driver or 'nobody'}")
    print(table_text(result))
    print(frame_text(result))
    if args.save and result.kept:
        print(saved)


def _report_several(args: argparse.Namespace, runs: list[tuple[str, str, Result]]) -> None:
    if args.json:
        print(json.dumps([{"link": place, "policy": policy, **result.summary()} for place, policy, result in runs]))
        return
    window = args.window or "as the server says"
    print(f"{args.url}, {args.size[0]}x{args.size[1]} an eye, {args.fps:g} Hz, window {window}\n")
    print(comparison_markdown(runs))


async def _stream(
    args: argparse.Namespace, token: str | None, simulated: Link | None, policy: str, drive: Drive, frames: int
) -> Result:
    bars = not args.json and sys.stderr.isatty()
    async with over(simulated, args.url) as url:
        async with Client(url, token, **connection(args)) as client:
            with Progress(frames, policy, quiet=not bars) as bar:
                asked = requested(args) | {"frames": frames, "policy": policy, "keep": bool(args.save)}
                return await stream(client, drive, progress=bar.update, **asked)


@dataclass(frozen=True)
class Recording:
    """Tracking samples in order of time; at any time the newest earlier sample is current."""

    times: list[float]  # seconds from the first sample
    samples: list[dict[str, Any]]
    roots: NDArray[np.float64]  # [N, 3] where the user stands: smoothed head positions on the floor

    @property
    def seconds(self) -> float:
        """Seconds from the first sample to the last; 1 for a single one."""
        return self.times[-1] or 1.0

    def at(self, seconds: float) -> Driven:
        """Return the tracking object at ``seconds``; the recording repeats."""
        index = max(0, bisect_right(self.times, seconds % self.seconds) - 1)
        return Driven(tracking=self.samples[index], root=self.roots[index])


@dataclass(frozen=True)
class Played:
    """A repeating motion. Poses of rigs other than SMPL-X are sent by joint name."""

    motion: Motion

    def at(self, seconds: float) -> Driven:
        """Return the pose at ``seconds``."""
        pose = self.motion.at(seconds)
        if self.motion.names == JOINT_NAMES:
            return Driven(pose, root=pose.trans)
        joints = dict(zip(self.motion.names, pose.rotations.tolist(), strict=True))
        sent: dict[str, Any] = {"joints": joints, "trans": pose.trans.tolist()}
        return Driven(sent | ({EXPRESSION: dict(pose.expression)} if pose.expression else {}), root=pose.trans)


def load_drive(
    name: str | None, avatar: str | None = None, tracking: bool = False, option: str = "--motion"
) -> tuple[Drive, float]:
    """Return the drive of the avatar and its duration in seconds. Raises GlsplatError, which names the file.

    ``tracking`` sends head and hands of a motion instead of poses. Without ``name`` the drive is the embedded
    recording, or with ``avatar`` the embedded motion.
    """
    skeleton = load_avatar(avatar, "--avatar").skeleton if avatar else None
    if avatar and skeleton is not None and (tracking or name is None or name.endswith(".jsonl")):
        tracked(skeleton, avatar)
    if name is None and avatar is None:
        recording = _recording(embedded_recording(), "the embedded recording")
        return recording, recording.seconds
    if name is not None and name.endswith(".jsonl"):
        recording = _recording(read_samples(name), name)
        return recording, recording.seconds

    skeleton = default_avatar().skeleton if skeleton is None else skeleton
    motion = motion_of(name or _MOTION, skeleton, option)
    if tracking or name is None:
        from glsplat.extras.motions.derive import (  # here: recordings need none
            derive,
            truth_from_motion,
            with_expressions,
        )

        truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, _TRACKING_RATE_HZ)
        samples = with_expressions(derive(skeleton, truth), motion)
        return _recording(samples, motion.label), motion.duration
    return Played(motion), motion.duration


def _recording(samples: Iterable[Sample], name: str) -> Recording:
    times, tracked = [], []
    for sample in samples:
        fields = {key: value for key, value in sample.to_json().items() if _finite(value)}  # NaN: not tracked
        times.append(float(fields.pop("t")))
        tracked.append(fields)
    if not tracked:
        raise FormatError(f"{name}: expected tracking samples, a JSON object a line, found none")
    heads = np.array([(fields.get("head") or (0.0, 0.0, 0.0))[:3] for fields in tracked]) * (1, 0, 1)
    width = round(_ROOT_WINDOW_S * _TRACKING_RATE_HZ)
    padded = np.pad(heads, ((width // 2, width - 1 - width // 2), (0, 0)), mode="edge")
    roots = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0).mean(axis=-1)
    return Recording([max(0.0, t - times[0]) for t in times], tracked, roots)


def _finite(value: Any) -> bool:
    if isinstance(value, list):
        return all(map(_finite, value))
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    return value is None or bool(np.isfinite(value))


def check_target(target: str) -> None:
    """Raise UsageError or FormatError, before the work starts, for an output that cannot be saved."""
    output_kind("--save", target, (*CLIPS, ".png"), "a clip .mp4 or .webm, a contact sheet .png", folder="PNG files")


def save_pictures(target: str, result: Result) -> str:
    """Save the kept pairs as a folder of PNG, a clip in real time, or a contact sheet; return what was written."""
    path = Path(target)
    if path.suffix.lower() in CLIPS:
        return save_clip(path, result.kept)
    if path.suffix.lower() == ".png":
        save_sheet(path, result.kept)
    else:
        path.mkdir(exist_ok=True)
        for _, reply in result.kept:
            save_png(path / f"{reply.frame_id:06d}.png", _pair(reply))
    return target


def save_clip(path: Path, kept: list[tuple[float, Reply]], across: int | None = None) -> str:
    """Save a clip, eyes side by side, at the mean rate and at most ``across`` pixels wide; return a line about it."""
    seconds = kept[-1][0] - kept[0][0]
    fps = (len(kept) - 1) / seconds if seconds > 0 else 10.0
    full = _full(kept)
    with Clip(path, max(1.0, round(fps, 2))) as clip:
        for _, reply in kept:
            clip.add(_fitted(_pair(reply, full), across))
    return clip.summary


def save_sheet(path: Path, kept: list[tuple[float, Reply]]) -> None:
    """Save a contact sheet of several moments, each left and right side by side with frame number and time."""
    step = max(1, len(kept) / _MOMENTS)
    chosen = [kept[int(i * step)] for i in range(min(_MOMENTS, len(kept)))]
    tiles, full = [], _full(chosen)
    for seconds, reply in chosen:
        pair = _fitted(_pair(reply, full), _TILE_WIDTH_PX)
        tiles.append(label(pair, f"frame {reply.frame_id}, {seconds:.2f} s: left | right"))
    save_png(path, stack([tiles[i : i + 2] for i in range(0, len(tiles), 2)]))


def _full(kept: list[tuple[float, Reply]]) -> tuple[int, int]:
    """Return the largest picture size: a server that holds a rate also sends smaller ones."""
    width, height = np.max([reply.info.get("size", (1, 1)) for _, reply in kept], axis=0)
    return int(width), int(height)


def _pair(reply: Reply, full: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    images = reply.images()
    if full is not None and images[0].shape[1] < full[0]:
        images = [cv2.resize(image, full, interpolation=cv2.INTER_LINEAR).astype(np.uint8) for image in images]
    return side_by_side(np.stack(images))


def _fitted(pair: NDArray[np.uint8], across: int | None) -> NDArray[np.uint8]:
    if across is None or pair.shape[1] <= across:
        return pair
    scale = across / pair.shape[1]
    return cv2.resize(pair, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.uint8)
