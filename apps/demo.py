"""``glsplat demo``: run server and client on this machine; print rates and save pictures."""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

from glsplat.config import LEAN, RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.io.files import replace_file
from glsplat.net.client import Client

from .args import add_detail, detail_of, size
from .output import Image, save_png
from .progress import Progress
from .replay.command import load_drive, save_clip
from .replay.portrait import portrait_sheet
from .replay.stage_table import frame_text, summary_text, table_text
from .replay.streaming import Drive, Result, observer, stream
from .usage import UsageError, make_folder

HELP = (
    "Start a server, stream recorded head and hands through it at two sizes (tracking to pose to both eyes to JPEG), "
    "and show rates, a contact sheet, a clip (MP4 with VP9, which browsers play) and a table of stage times."
)
EXAMPLE = "glsplat demo -o out/demo"

_START_TIMEOUT_S = 60.0  # for slow machines
_STOP_TIMEOUT_S = 10.0
_WARM_UP = 3  # pictures before those that count: targets of the size, caches
_CLIP_WIDTH_PX = 1024  # encoding twice that as VP9 would take longer than streaming


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("-o", "--output", type=Path, default=Path("out/demo"), help="folder (default out/demo)")
    parser.add_argument("--avatar", metavar="FILE", help="avatar to show (default: the embedded one)")
    parser.add_argument(
        "--motion", metavar="FILE", help="motion to send as poses, or .jsonl (default: embedded recording)"
    )
    parser.add_argument("--tracking", action="store_true", help="send only head and hands of the motion")
    parser.add_argument("--seconds", type=float, default=8.0, help="seconds of streaming at each size (default 8)")
    parser.add_argument("--fps", type=float, default=72.0, help="requests per second (default 72)")
    parser.add_argument("--sizes", type=size, nargs="+", default=[(512, 512), (1024, 1024)], help="pixels per eye")
    add_detail(parser, lean=True)
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(args: argparse.Namespace) -> int:
    """Start a server, stream, print the report and save the pictures."""
    if not 0.1 <= args.seconds <= 600 or not 1 <= args.fps <= 240:
        raise UsageError("--seconds needs 0.1 to 600 and --fps 1 to 240")
    drive, _ = load_drive(args.motion, args.avatar, args.tracking)
    make_folder(args.output)
    with running_server(args.avatar, RenderConfig(**detail_of(args))) as url:
        frames, quiet = max(1, round(args.seconds * args.fps)), args.json or not sys.stderr.isatty()
        runs = asyncio.run(streamed(url, drive, args.sizes, frames, args.fps, quiet=quiet))
        results = [(f"{width}x{height}", run) for (width, height), run in zip(args.sizes, runs, strict=True)]
        sheet = asyncio.run(_portraits(url, drive))
    kept = results[-1][1].kept
    if not kept:
        raise GlsplatError("no picture came; run `glsplat serve --verbose` and `glsplat replay` to see why")
    pictures, clip, stages = (args.output / name for name in ("contact_sheet.png", "clip.mp4", "stages.txt"))
    save_png(pictures, sheet)
    shown = save_clip(clip, kept, across=_CLIP_WIDTH_PX)
    tables = [f"2 x {name}, drawn by {r.driver}\n{table_text(r)}\n{frame_text(r)}\n" for name, r in results]
    replace_file(stages, ["\n".join(tables).encode()])
    if args.json:
        files = [str(pictures), str(clip), str(stages)]
        print(json.dumps({"runs": {name: result.summary() for name, result in results}, "files": files}))
        return 0
    print("Tracked head and hands went to a server on this machine; both eyes came back as JPEG:", end="\n\n")
    for name, result in results:
        print(f"  2 x {name:10}{summary_text(result)}")
    print(f"\nDrawn by {results[-1][1].driver}.")
    print(f"{pictures}: the person in both eyes", f"{shown}: what was streamed", sep="\n")
    print(f"{stages}: the time of each stage")
    print("Next: `glsplat serve`, then http://localhost:8000/vr in a browser.")
    return 0


async def _portraits(url: str, drive: Drive) -> Image:
    async with Client(url, timeout=30.0, adapt=False) as client:
        return await portrait_sheet(client, drive)


async def streamed(
    url: str, drive: Drive, sizes: Sequence[tuple[int, int]], frames: int, fps: float, *, quiet: bool = True
) -> list[Result]:
    """Return a run at each of the sizes; the last keeps its pictures."""
    start, results = drive.at(0.0), []
    for pixels in sizes:
        async with Client(url, timeout=30.0) as client:
            for _ in range(_WARM_UP):
                await client.render(observer(0.0, start.root, pixels), pose=start.pose, tracking=start.tracking)
            with Progress(frames, f"{pixels[0]}x{pixels[1]}", quiet=quiet) as bar:
                last = pixels == sizes[-1]
                run = stream(client, drive, frames=frames, fps=fps, size=pixels, keep=last, progress=bar.update)
                results.append(await run)
    return results


@contextmanager
def running_server(avatar: str | None, rendering: RenderConfig = LEAN) -> Iterator[str]:
    """Run a server in its own process on a free loopback port; yields its URL, then stops it cleanly."""
    processes = multiprocessing.get_context("spawn")
    ours, theirs = processes.Pipe()
    # no daemon, which could not start the server's drawing process
    process = processes.Process(target=_serve, args=(theirs, avatar, rendering), name="glsplat serve")
    process.start()
    theirs.close()
    try:
        if not ours.poll(_START_TIMEOUT_S):
            raise GlsplatError(f"the server was not ready within {_START_TIMEOUT_S:g} s")
        try:
            ready, text = ours.recv()
        except EOFError:
            raise GlsplatError("the server ended before it was ready") from None
        if not ready:
            raise GlsplatError(text)
        yield text
    finally:
        process.terminate()  # SIGTERM: the server sends pending pictures and exits with 0
        process.join(_STOP_TIMEOUT_S)
        if process.is_alive():
            process.kill()
            process.join()


def _serve(connection: Connection, avatar: str | None, rendering: RenderConfig) -> None:
    """Run the server in the child process; send (True, URL) or (False, error) to the parent."""
    from glsplat.net.options import ServerConfig
    from glsplat.net.served_scene import gl_server

    from .args import load_avatar

    try:
        scene = load_avatar(avatar, "--avatar") if avatar else default_avatar()
        config = ServerConfig(port=0, scene=avatar or "default avatar")
        server = gl_server(scene, config, rendering=rendering)
        asyncio.run(server.run(lambda: connection.send((True, server.url))))
    except GlsplatError as error:
        connection.send((False, str(error)))
