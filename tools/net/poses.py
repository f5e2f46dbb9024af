"""Measure poses over the wire: CPU, bytes and round trips of a room (docs/measured/poses.md).

    python -m tools.net.poses [--people 1 10] [--seconds 15] [--rate 72]

A separate server process (`glsplat serve`, the embedded avatar) has a room; this process sends the embedded recording
for every person, from different starts, and reads the replies. Its own work is not counted.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import struct
import subprocess
import sys
import tempfile
import time
from statistics import median
from typing import Any

import aiohttp
import numpy as np
import psutil
from numpy.typing import NDArray

from glsplat.tracking.recording import embedded_recording


async def person(url: str, name: str, first: int, samples: list[dict[str, Any]], rate: float, until: float) -> Any:
    """Send one person's samples; return their number and (bytes, bodies of others, round trip in ms) of replies."""
    got: list[tuple[int, int, float]] = []  # bytes, bodies of others, round trip
    sent: dict[int, float] = {}
    async with aiohttp.ClientSession() as http:
        ws = await http.ws_connect(f"{url}?room=lab&name={name}&window=3&height=1.75", max_msg_size=0)
        ack = 0

        async def read() -> None:
            nonlocal ack
            async for message in ws:
                if message.type != aiohttp.WSMsgType.BINARY:
                    print(name, message.data)
                    continue
                ack, others = glance(message.data)
                got.append((len(message.data), others, (time.perf_counter() - sent[ack]) * 1e3))

        reader = asyncio.create_task(read())
        start, number = time.perf_counter() + first * 0.0013, 0
        while (now := time.perf_counter()) < until:
            await asyncio.sleep(max(0.0, start + number / rate - now))
            number += 1
            sent[number] = time.perf_counter()
            sample = samples[(first * 97 + number) % len(samples)]
            request = {"v": 1, "frame_id": number, "ack": ack, "t": number * 1e3 / rate, "want": "pose"}
            await ws.send_str(json.dumps(request | {"tracking": sample}))
        await asyncio.sleep(0.3)
        reader.cancel()
        await ws.close()
    return number, got


def glance(data: bytes) -> tuple[int, int]:
    """Return frame_id and the number of others' bodies in a reply, without decoding poses, to save CPU."""
    ack, length = struct.unpack_from("<4xIxI", data)
    start, others = 14 + length, 0
    for _ in range(data[start - 1]):
        size, flags = struct.unpack_from("<HH", data, start)
        others += not flags & 1
        start += size
    return ack, others


async def room(url: str, people: int, rate: float, seconds: float, process: psutil.Process) -> None:
    """Print a row: CPU of the server and all its processes, bytes, round trips."""
    samples = [{k: v for k, v in sample.to_json().items() if k != "t"} for sample in embedded_recording()]
    until = time.perf_counter() + seconds + 2
    tasks = [asyncio.create_task(person(url, f"P{i}", i, samples, rate, until)) for i in range(people)]
    await asyncio.sleep(2)

    def spent() -> NDArray[np.float64]:
        every = [process, *process.children(recursive=True)]
        return np.array([one.cpu_times()[:2] for one in every]).sum(axis=0)  # user, system

    before, began = spent(), time.perf_counter()
    await asyncio.sleep(seconds - 0.5)
    cpu = (spent() - before) / (time.perf_counter() - began)
    results = await asyncio.gather(*tasks)
    asked = sum(number for number, _ in results)
    replies = sum(len(got) for _, got in results)
    down = [sum(size for size, _, _ in got) * 8 / (seconds + 2) / 1e6 / max(1, people - 1) for _, got in results]
    fresh = [sum(others for _, others, _ in got) / (seconds + 2) / max(1, people - 1) for _, got in results]
    trips = [trip for _, got in results for _, _, trip in got]
    each = 1e3 * cpu / people / rate
    print(
        f"| {people} | {rate:g} | {each[0]:.2f} + {each[1]:.2f} | {100 * cpu.sum() / people:.1f} % | "
        f"{replies / asked:.3f} | {median(fresh):.1f} | {median(down):.3f} | {np.percentile(trips, 50):.1f} | "
        f"{np.percentile(trips, 95):.1f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--people", type=int, nargs="+", default=[1, 10])
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--rate", type=float, nargs="+", default=[72.0], help="samples per second of each")
    args = parser.parse_args()
    command = [sys.executable, "-m", "apps.cli", "serve", "--port", "0", "--json", "--room", "lab:64"]
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        print('max-clients = 64\nwatermark = "off"', file=file, flush=True)
        server = subprocess.Popen([*command, "--config", file.name], stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            told = json.loads(server.stdout.readline())
            print(
                "| people | samples/s each | CPU a sample, ms, program + system | a person, of a core | answered "
                "| of each other seen, /s | down for each seen, Mbit/s | round trip, ms | 95 % |\n" + "|--:" * 9 + "|"
            )
            for people, rate in itertools.product(args.people, args.rate):
                asyncio.run(room(told["url"], people, rate, args.seconds, psutil.Process(server.pid)))
                time.sleep(3)  # until the room has forgotten them
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
