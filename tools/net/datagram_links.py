"""Compare pictures by datagrams with pictures over the WebSocket: real sockets over a relay with delay, rate and loss.

    python -m tools.net.datagram_links --link 60,20,1 --link 150,5,3 --seconds 15

Server, relay and client are processes of their own. The pictures are drawn beforehand; each is shown after the time
that the simulation assumes (50 ms at full size), so other work on the machine does not slow the renderer.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import aiohttp
import numpy as np
from numpy.typing import NDArray

from apps.replay.link import Link, link
from apps.replay.streaming import observer
from glsplat.data import default_avatar
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.codec.encode import covered_box
from glsplat.net.codec.encoded import Box
from glsplat.net.options import ServerConfig
from glsplat.net.pace.ladder import SCALES
from glsplat.net.reply import parse_reply
from glsplat.net.served_scene import server_of
from glsplat.net.session import SessionConfig
from glsplat.renderer import Renderer
from tests.extras.far_links.datagrams.client import open_path
from tools.net.lossy_relay import enlarge_buffer, relay
from tools.net.simulated_link import draw_time

SIDE = 1024  # pixels
MOMENTS = 6
EYES = [
    {"viewmat": [1, 0, 0, x, 0, -1, 0, 1.2, 0, 0, -1, 2, 0, 0, 0, 1], "K": [803.6, 803.6, 512, 512]}
    for x in (0.03, -0.03)
]
WARM_UP_S = 5.0

Pair = tuple[NDArray[np.uint8], Box]  # images [2, H, W, 4] and their covered box


@dataclass
class StoredPictures:
    """A backend that returns stored pairs in turn, in the size of the job."""

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


def drawn() -> dict[int, list[Pair]]:
    """Return pairs of the embedded avatar by side, at some moments of a motion."""
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
                pairs.setdefault(side, []).append((images, covered_box(np.maximum(*images))))
    return pairs


class Shown:
    """Ages at each refresh, after the warm-up."""

    def __init__(self) -> None:
        self.ages: list[float] = []  # seconds
        self.pictures = 0
        self.by_datagrams = 0
        self.nbytes = 0
        self.qualities: list[float] = []


def serving(pairs: Any, port: Any, stop: Any, webtransport: bool) -> None:
    """Run the server in this process; send its port, and once stopped (CPU seconds, 99 % of loop lag, links)."""

    async def run() -> None:
        config = ServerConfig(port=0, session=SessionConfig(adapt=True), webtransport=webtransport)
        server = server_of(StoredPictures(pairs), config)
        await server.start()
        port.send(server.port)
        loop, cpu = asyncio.get_running_loop(), time.process_time()
        lags: list[float] = []
        ways: list[Any] = []
        while not stop.poll():
            before = loop.time()
            ways = [one["datagrams"] or one["link"] for one in server.stats()["clients"]] or ways
            await asyncio.sleep(0.01)
            lags.append(loop.time() - before - 0.01)
        port.send((time.process_time() - cpu, float(np.quantile(lags, 0.99)), ways))
        await server.stop()

    asyncio.run(run())


def relaying(simulated: Link, there: int, port: Any, stop: Any) -> None:
    """Run the relay in this process; send its port."""

    async def run() -> None:
        port.send(await relay(simulated, there))
        while not stop.poll():
            await asyncio.sleep(0.05)

    asyncio.run(run())


async def _opened(url: str, offer: dict[str, str], take: Any) -> Any:
    path = await open_path(url, offer, take)
    enlarge_buffer(path._transport)
    return path


async def watch(url: str, seconds: float, datagrams: bool) -> Shown:
    """Run a client that asks at 72 Hz and shows the newest picture at each refresh."""
    out, refresh = Shown(), 1 / 72
    sent: dict[int, float] = {}
    newest = shown = 0
    arrival: tuple[float, float] | None = None
    begin = time.perf_counter()
    second: Any = None
    async with aiohttp.ClientSession() as http, http.ws_connect(url, max_msg_size=0) as ws:

        def message(data: bytes, by: bool) -> None:
            nonlocal newest, arrival, second
            reply, now = parse_reply(data), time.perf_counter()
            if (offer := reply.info.get("datagrams")) is not None and second is None:
                second = asyncio.ensure_future(_opened(url, offer, lambda data: message(data, True)))
            if reply.frame_id <= newest or reply.frame_id not in sent:
                return
            newest = reply.frame_id
            arrival = now - sent[newest], now
            if now - begin > WARM_UP_S:
                out.by_datagrams += by
                out.nbytes += len(data)
                out.qualities.append(reply.info.get("detail", {}).get("quality", 80) * reply.info["size"][0] / SIDE)
            say({"v": 1, **ack()})

        def say(fields: dict[str, Any]) -> None:
            text = json.dumps(fields)
            if second is not None and second.done():
                second.result().ask(text)
                return
            tasks.add(task := asyncio.ensure_future(ws.send_str(text)))
            task.add_done_callback(tasks.discard)

        def ack() -> dict[str, Any]:
            nonlocal arrival
            fields: dict[str, Any] = {"ack": newest}
            if arrival is not None:
                age, at = arrival
                fields["arrival"] = {"age": age * 1e3, "held": (time.perf_counter() - at) * 1e3}
                arrival = None
            return fields

        async def read() -> None:
            async for one in ws:
                if one.type == aiohttp.WSMsgType.BINARY:
                    message(one.data, False)
                elif one.type == aiohttp.WSMsgType.TEXT:
                    print(one.data, file=sys.stderr)

        tasks: set[Any] = {asyncio.ensure_future(read())}
        number, due = 0, begin
        while (now := time.perf_counter()) - begin < WARM_UP_S + seconds:
            number += 1
            sent[number] = now
            sent.pop(number - 500, None)
            more = {"datagrams": True} if datagrams else {}
            say({"v": 1, "frame_id": number, **ack(), "eyes": EYES, "size": [SIDE, SIDE], **more})
            if now - begin > WARM_UP_S and newest:
                out.pictures += newest != shown
                out.ages.append(now - sent.get(newest, 0.0))
            shown = newest
            due += refresh
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
        for task in tasks:
            task.cancel()
        if second is not None and second.done():
            second.result().close()
    return out


def row(simulated: Link | None, pairs: Any, seconds: float, datagrams: bool) -> tuple[Shown, Any]:
    """Return the pictures shown in one stream, and the server's figures."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    server = spawn.Process(target=serving, args=(pairs, theirs, theirs, datagrams), daemon=True)
    server.start()
    port = ours.recv()
    between = None
    if simulated is not None:
        here, there = spawn.Pipe()
        between = spawn.Process(target=relaying, args=(simulated, port, there, there), daemon=True)
        between.start()
        url = f"ws://127.0.0.1:{here.recv()}/ws"
    else:
        url = f"ws://127.0.0.1:{port}/ws"
    try:
        shown = asyncio.run(watch(url, seconds, datagrams))
    finally:
        ours.send(1)
    said = ours.recv()
    server.join(10)
    if between is not None:
        here.send(1)
        between.join(10)
    return shown, said


def main(links: Sequence[Link | None], seconds: float) -> None:
    pairs = drawn()
    names = "link | pictures by | shown a second | age, ms | 95 % | goal | kB | quality x scale | so | cores | lag, ms"
    print(f"| {names} |\n|---|---|" + "--:|" * 9)
    for simulated in links:
        for datagrams in (False, True):
            shown, (cpu, late, ways) = row(simulated, pairs, seconds, datagrams)
            ages = np.array(shown.ages or [float("nan")]) * 1e3
            goal = 1.3 * ((simulated.round_trip if simulated else 0) + 120)
            count = max(1, len(shown.qualities))
            print(
                f"| {simulated or 'loopback'} | {'datagrams' if datagrams else 'WebSocket'} "
                f"| {shown.pictures / seconds:.1f} | {np.median(ages):.0f} | {np.quantile(ages, 0.95):.0f} "
                f"| {goal:.0f} {'met' if np.quantile(ages, 0.95) <= goal else 'missed'} "
                f"| {shown.nbytes / count / 1e3:.1f} | {np.mean(shown.qualities or [0]):.0f} "
                f"| {shown.by_datagrams / count:.2f} | {cpu / (seconds + WARM_UP_S):.2f} | {late * 1e3:.1f} | {ways}",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--link", type=link, action="append", default=[])
    parser.add_argument("--loopback", action="store_true")
    parser.add_argument("--seconds", type=float, default=15.0)
    arguments = parser.parse_args()
    main([*([None] if arguments.loopback else []), *arguments.link], arguments.seconds)
