"""Streams over a relay that thins and delays a real connection, before and after; the renderer is always as fast.

    python -m tools.net.real_link --seconds 15 --link 40,20 --link 40,5 --link 40,2 --link 150,5

Server, sockets, codec and client are those of ``glsplat serve`` and ``glsplat replay``. The pictures are drawn before
it begins and shown in turn, each after the 50 ms (at full size) that the simulation assumes, so that a machine with
other work is no worse a renderer.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from numpy.typing import NDArray

from apps.replay.command import load_drive
from apps.replay.link import Link, link, over
from apps.replay.streaming import Result, observer, stream
from glsplat.data import default_avatar
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.client import Client
from glsplat.net.codec.encode import covered_box
from glsplat.net.options import ServerConfig
from glsplat.net.pace.ladder import SCALES
from glsplat.net.pace.stages import median_p95
from glsplat.net.served_scene import server_of
from glsplat.net.session import SessionConfig
from glsplat.renderer import Renderer
from tools.net.simulated_link import draw_time

SIDE = 1024  # pixels
MOMENTS = 6

Pair = tuple[NDArray[np.uint8], tuple[int, int, int, int]]  # images [2, H, W, 4] and the box that is covered


@dataclass
class Drawn:
    """A backend of pictures that are there, in turn, in the size of the job."""

    pairs: dict[int, list[Pair]]  # by side
    numbers: Iterator[int] = field(default_factory=count)

    def open(self) -> str:
        return "drawn before"

    def render(self, job: RenderJob) -> Rendered:
        side = job.cameras[0].width
        pairs = self.pairs.get(side) or self.pairs[SIDE]
        time.sleep(draw_time(side / SIDE))
        images, box = pairs[next(self.numbers) % len(pairs)]
        return Rendered(images[: len(job.cameras)], covered=box)

    def close(self) -> None: ...


def drawn() -> Drawn:
    """Of the embedded avatar, some moments of a motion."""
    avatar = default_avatar()
    motion = load_embedded_motion("wave-and-turn", avatar.skeleton)
    pairs: dict[int, list[Pair]] = {}
    with Renderer(avatar) as renderer:
        for scale in SCALES:
            side = round(SIDE * scale)
            renderer.resize(side, side)
            for moment in range(MOMENTS):
                pose = motion.at(0.5 * moment)
                images = renderer.render(observer(0.5 * moment, pose.trans, (side, side)), pose).copy()
                x, y, w, h = (np.array([covered_box(image) for image in images]).T).tolist()
                left, top = min(x), min(y)
                right, low = max(map(sum, zip(x, w, strict=True))), max(map(sum, zip(y, h, strict=True)))
                pairs.setdefault(side, []).append((images, (left, top, right - left, low - top)))
    return Drawn(pairs)


async def run(backend: Drawn, simulated: Link | None, seconds: float, adapt: bool) -> Result:
    """One stream."""
    drive, _ = load_drive("wave-and-turn")
    server = server_of(backend, ServerConfig(port=0, session=SessionConfig(adapt=adapt)))
    await server.start()
    try:
        async with over(simulated, server.url) as url, Client(url, adapt=True) as client:
            return await stream(client, drive, frames=round(72 * seconds))
    finally:
        await server.stop()


def main(links: Sequence[Link], seconds: float) -> None:
    backend = drawn()
    print("| link | | shown a second | age, ms | 95 % | kB | Mbit/s |\n|---|---|--:|--:|--:|--:|--:|")
    for simulated in (None, *links):
        for adapt in (False, True):
            result = asyncio.run(run(backend, simulated, seconds, adapt))
            middle, late = median_p95(result.ages)
            size = float(np.mean(result.nbytes)) / 1e3
            used = sum(result.nbytes) * 8e-6 / result.seconds
            how = "after" if adapt else "before"
            print(
                f"| {simulated or 'loopback'} | {how} | {result.fps:.1f} | {middle:.0f} | {late:.0f} "
                f"| {size:.1f} | {used:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--link", type=link, action="append", default=[])
    parser.add_argument("--seconds", type=float, default=15.0)
    arguments = parser.parse_args()
    main(arguments.link, arguments.seconds)
