"""People of a room, driven by one recording: each is a separate client at another time of the recording."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Sequence
from typing import Any

from glsplat.camera import Camera, head_matrix, stereo_cameras
from glsplat.errors import ProtocolError
from glsplat.net.client import Client
from glsplat.net.pace.stages import median_p95

from ..args import whole
from ..progress import Progress
from ..usage import UsageError
from .streaming import Drive, Driven, Later, Result, stream

MOST_PEOPLE = 64
_OFFSET_S = 1.7  # of the recording between two people


def add_crowd(parser: argparse.ArgumentParser) -> None:
    """Add --room, --name and --people."""
    parser.add_argument(
        "--room", metavar="NAME", help="join this room of the server as a person, and see through its eyes"
    )
    parser.add_argument("--name", help="name of the person (default: that of the account, or of a guest)")
    parser.add_argument(
        "--people", type=whole(1, MOST_PEOPLE), default=1, metavar="N", help="number of people (default 1)"
    )


def check_crowd(args: argparse.Namespace) -> None:
    """Raise UsageError for options that do not fit."""
    if args.room is None:
        if args.name is not None or args.people != 1:
            raise UsageError("--name and --people go with --room")
        return
    if args.compare or args.link:
        raise UsageError("--room goes with a single run, not with --compare or --link")


def names_of(args: argparse.Namespace) -> list[str]:
    """Return the requested names of the people; "" for none."""
    if args.people == 1:
        return [args.name or ""]
    return [f"{args.name or 'replay'} {number}" for number in range(1, args.people + 1)]


def connection(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of ``Client`` that all kinds of run share."""
    return {"window": args.window, "mirror": args.mirror, "cafile": args.tls_ca, "adapt": not args.fixed}


def requested(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of ``stream`` that all kinds of run share."""
    return {"window": args.window or 2} | {name: getattr(args, name) for name in ("fps", "size", "quality", "crop")}


def own_eyes(seconds: float, driven: Driven, size: tuple[int, int]) -> tuple[Camera, Camera]:
    """Return the eyes of the tracked head."""
    head = None if driven.tracking is None else driven.tracking.get("head")
    if head is None:
        raise ProtocolError("people of a room are seen by their own eyes: this recording has moments without a head")
    return stereo_cameras(head_matrix(head[:3], head[3:]), size=size)


async def stream_crowd(args: argparse.Namespace, token: str | None, drive: Drive, frames: int) -> list[Result]:
    """Return one result per person. A person who is refused or removed ends the run for all."""
    bars = not args.json and sys.stderr.isatty()
    names = names_of(args)
    clients = [Client(args.url, token, room=args.room, name=name or None, **connection(args)) for name in names]
    with Progress(frames * len(clients), args.room, quiet=not bars) as bar:
        try:
            for client in clients:
                await client.connect()
            runs = [
                stream(
                    client,
                    Later(drive, _OFFSET_S * number),
                    frames=frames,
                    policy=args.policy,
                    keep=bool(args.save) and number == 0,
                    progress=bar.update,
                    see=own_eyes,
                    **requested(args),
                    hide=() if args.mirror else ("head",),
                )
                for number, client in enumerate(clients)
            ]
            async with asyncio.TaskGroup() as group:
                tasks = [group.create_task(run) for run in runs]
        except* ProtocolError as errors:
            raise errors.exceptions[0] from None
        finally:
            for client in clients:
                await client.close()
    return [task.result() for task in tasks]


def crowd_text(names: Sequence[str], results: Sequence[Result]) -> str:
    """Return a line per person: pictures per second and their age when shown."""
    lines = [f"{'person':20}{'shown/s':>9}{'age, ms':>9}{'p95':>7}{'asked':>8}{'failed':>8}"]
    for name, result in zip(names, results, strict=True):
        age, age95 = median_p95(result.ages)
        lines.append(f"{name or 'you':20.20}{result.fps:9.1f}{age:9.0f}{age95:7.0f}{result.sent:8}{result.errors:8}")
    return "\n".join(lines)
