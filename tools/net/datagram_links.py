"""Pictures by datagrams against those over the WebSocket, over a relay with delay, rate and loss; real sockets.

    python -m tools.net.datagram_links --link 60,20,1 --link 150,5,3 --seconds 15

Server, relay and client are processes of their own. The pictures are those of tools/net/real_link.py: drawn
before, each shown after the 50 ms (at full size) of the simulation.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np

from apps.replay.link import Link, link
from glsplat.net.options import ServerConfig
from glsplat.net.reply import parse_reply
from glsplat.net.served_scene import server_of
from glsplat.net.session import SessionConfig
from tests.extras.far_links.datagrams.client import open_path
from tools.net.lossy_relay import relay, roomy

__all__ = ["Shown", "main"]

SIDE = 1024
EYES = [
    {"viewmat": [1, 0, 0, x, 0, -1, 0, 1.2, 0, 0, -1, 2, 0, 0, 0, 1], "K": [803.6, 803.6, 512, 512]}
    for x in (0.03, -0.03)
]
WARM_UP = 5.0


class Shown:
    """Ages at each refresh, behind the warm-up."""

    def __init__(self) -> None:
        self.ages: list[float] = []  # seconds
        self.pictures = 0
        self.by_datagrams = 0
        self.nbytes = 0
        self.qualities: list[float] = []


def serving(pairs: Any, port: Any, stop: Any, webtransport: bool) -> None:
    """A process: the server. Tells its port; once stopped its CPU seconds, the 99 % of its loop's lag, and its ways."""
    from tools.net.real_link import Drawn

    async def run() -> None:
        config = ServerConfig(port=0, session=SessionConfig(adapt=True), webtransport=webtransport)
        server = server_of(Drawn(pairs), config)
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
    """A process: the relay."""

    async def run() -> None:
        port.send(await relay(simulated, there))
        while not stop.poll():
            await asyncio.sleep(0.05)

    asyncio.run(run())


async def _opened(url: str, offer: dict[str, str], take: Any) -> Any:
    path = await open_path(url, offer, take)
    roomy(path._transport)
    return path


async def watch(url: str, seconds: float, datagrams: bool) -> Shown:
    """A client: asks at 72 Hz, shows the newest picture at its refresh."""
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
            if now - begin > WARM_UP:
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
        while (now := time.perf_counter()) - begin < WARM_UP + seconds:
            number += 1
            sent[number] = now
            sent.pop(number - 500, None)
            more = {"datagrams": True} if datagrams else {}
            say({"v": 1, "frame_id": number, **ack(), "eyes": EYES, "size": [SIDE, SIDE], **more})
            if now - begin > WARM_UP and newest:
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
    """One stream: what was shown, and what the server says."""
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


def stored(path: Path) -> Any:
    """The pictures, drawn once."""
    from tools.net.real_link import drawn

    if path.exists():
        return np.load(path, allow_pickle=True)["pairs"][()]
    pairs = drawn().pairs
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, pairs=np.array(pairs, dtype=object))
    return pairs


def main(links: Sequence[Link | None], seconds: float, pairs: Any) -> None:
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
                f"| {shown.by_datagrams / count:.2f} | {cpu / (seconds + WARM_UP):.2f} | {late * 1e3:.1f} | {ways}",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--link", type=link, action="append", default=[])
    parser.add_argument("--loopback", action="store_true")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--pairs", type=Path, default=Path("out") / "measured" / "pairs.npz")
    arguments = parser.parse_args()
    main([*([None] if arguments.loopback else []), *arguments.link], arguments.seconds, stored(arguments.pairs))
