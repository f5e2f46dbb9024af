"""What poses over the wire cost: the tables of docs/streaming.md, "Poses instead of pictures".

    python -m tools.net.poses [--people 10] [--seconds 15] [--rate 72] [--listeners 1000]

A server of its own process (`glsplat serve`, the embedded avatar) with a room; this process sends the embedded
recording for every person, each beginning elsewhere in it, and reads what comes. Its own work is not counted. Then
listeners are simulated in this process: rooms, sessions and packing without sockets.
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
from collections.abc import Callable
from concurrent.futures import Executor, Future
from statistics import median
from typing import Any

import aiohttp
import numpy as np
import psutil
from numpy.typing import NDArray

import glsplat
from glsplat.extras.browser.poses.responder import PoseResponder
from glsplat.extras.rooms.member import Member
from glsplat.extras.rooms.person import PoseSample
from glsplat.extras.rooms.room import Room
from glsplat.net.backend import AvatarInfo, PoseSolver, Solved
from glsplat.net.client_stream import ClientStream
from glsplat.net.codec import body
from glsplat.net.messages import Decoder, Request
from glsplat.net.pose_queue import PoseQueue
from glsplat.net.served_scene import TrackingOptions
from glsplat.net.session import Session, SessionConfig
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.recording import embedded_recording
from glsplat.tracking.tracker import Tracker


async def person(url: str, name: str, first: int, samples: list[dict[str, Any]], rate: float, until: float) -> Any:
    """One of the people; replies (ages of the others in ms, bytes, round trips in ms) from a second on."""
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
    """frame_id and the bodies of others in a reply, without reading their poses: ten people are read here, too."""
    ack, length = struct.unpack_from("<4xIxI", data)
    start, others = 14 + length, 0
    for _ in range(data[start - 1]):
        size, flags = struct.unpack_from("<HH", data, start)
        others += not flags & 1
        start += size
    return ack, others


async def room(url: str, people: int, rate: float, seconds: float, process: psutil.Process) -> None:
    """The table's row: CPU of the server and all its processes, bytes, round trips."""
    samples = [{k: v for k, v in sample.to_json().items() if k != "t"} for sample in embedded_recording()]
    until = time.perf_counter() + seconds + 2
    tasks = [asyncio.create_task(person(url, f"P{i}", i, samples, rate, until)) for i in range(people)]
    await asyncio.sleep(2)

    def spent() -> NDArray[np.float64]:
        every = [process, *process.children(recursive=True)]
        return np.array([one.cpu_times()[:2] for one in every]).sum(axis=0)  # of programs, of the system

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


def solving() -> None:
    """What one sample takes to solve, and to read."""
    avatar, samples = glsplat.default_avatar(), embedded_recording()
    tracker = Tracker(avatar.skeleton, Calibration.of_height(avatar.skeleton, 1.75, 0.0))
    times = []
    for sample in samples[:1000]:
        start = time.thread_time()
        tracker.update(sample)
        times.append(time.thread_time() - start)
    text = json.dumps({"v": 1, "frame_id": 1, "t": 1.0, "want": "pose", "tracking": samples[5].to_json()})
    decoder = Decoder(skeleton=avatar.skeleton)
    start = time.thread_time()
    for _ in range(1000):
        decoder.decode(text)
    reading = time.thread_time() - start
    pose = glsplat.Pose(np.random.default_rng(1).normal(0, 0.5, (55, 3)), expression={"jawOpen": 0.5})
    start = time.thread_time()
    for i in range(1000):
        body.pack_body(pose, bytes(32), body.AT_ORIGIN, at=i, t=i)
    packing = time.thread_time() - start
    print(
        f"a sample: solved in {np.median(times) * 1e3:.2f} ms (95 %: {np.percentile(times, 95) * 1e3:.2f}), "
        f"read in {reading:.3f} ms, a body packed in {packing:.3f} ms (CPU of one core)"
    )


class Inline(Executor):
    """Does at once what it is given."""

    def submit(self, call: Callable[..., Any], /, *args: Any, **more: Any) -> Future[Any]:
        call(*args, **more)
        return Future()


def without_sockets(count: int, seconds: float, rate: float) -> None:
    """The same people in one thread, without sockets and threads: what each sample costs, and how much is solving."""
    one = TrackingOptions(idle=True).describe("ann", glsplat.default_avatar())
    assert one.solver is not None
    hall, now, spent, solved = Room("lab", count), 1000.0, 0.0, 0.0
    answers = PoseResponder(lambda name: bytes(32), lambda name: "", lambda: now)
    samples = [{k: v for k, v in sample.to_json().items() if k != "t"} for sample in embedded_recording()]
    clients = []

    class Timed:
        def __init__(self, solver: PoseSolver) -> None:
            self.solver = solver

        def solve(self, request: Request, at: float) -> Solved:
            nonlocal solved
            start = time.thread_time()
            found = self.solver.solve(request, at)
            solved += time.thread_time() - start
            return found

    for i in range(count):
        member = Member(hall, hall.join(f"P{i}", "ann", now), glsplat.Pose.zero(55))
        session = Session(Decoder(skeleton=one.skeleton), SessionConfig(window=8, rate=1e9, burst=10**9), now)
        solver = PoseQueue(Timed(one.solver(1.75, None)), Inline(), lambda: now)
        solver.on_solved = member.solved
        clients.append(ClientStream(i, session, solver, shown=one, member=member))
    turns, size = round(seconds * rate), 0

    async def talk() -> None:
        nonlocal now, spent, size
        for n in range(1, turns + 1):
            for i, client in enumerate(clients):
                now += 1 / rate / count
                sample = samples[(97 * i + n) % len(samples)]
                text = json.dumps({"v": 1, "frame_id": n, "t": n * 1e3 / rate, "want": "pose", "tracking": sample})
                start = time.thread_time()
                request = client.session.receive(text, now)
                assert isinstance(request, Request) and client.member is not None and client.solving is not None
                client.solving.add(request)
                client.member.received(request, now)
                answers.due(client)
                answer = client.answers.get_nowait()
                (data,) = answers.pack(answer).messages
                client.session.sent(answer.request, len(data))
                spent += time.thread_time() - start
                size += len(data)

    asyncio.run(talk())
    each = 1e3 / turns / count
    print(
        f"{count} people in a room, {turns} samples each, without sockets: {spent * each:.2f} ms of a core a sample, "
        f"{solved * each:.2f} of it solving; {size / turns / count:.0f} bytes a reply, "
        f"{size * 8 * rate / turns / count / (count - 1) / 1e6:.3f} Mbit/s for each other at {rate:g} samples/s"
    )


def listeners(count: int, seconds: float, rate: float) -> None:
    """One speaker at ``rate``, listeners that ask at 10 to 72 Hz: the work of the server without sockets."""
    hall, now = Room("stage", count + 1), 1000.0
    speaker = hall.join("speaker", "ann", now)
    packed = 0
    original = body.pack_body

    def counted(*args: Any, **more: Any) -> bytes:
        nonlocal packed
        packed += 1
        return original(*args, **more)

    import glsplat.extras.rooms.person as rooms_person

    rooms_person.pack_body = counted  # type: ignore[attr-defined]
    answers = PoseResponder(lambda name: bytes(32) if name == "ann" else None, lambda name: "", lambda: now)
    rng = np.random.default_rng(2)
    clients = []
    for i in range(count):
        who = hall.join(f"L{i}", "nobody", now, place=np.eye(4))  # nothing is handed out of them: they only listen
        session = Session(Decoder(), SessionConfig(window=8, rate=1e9, burst=10**9), now)
        member = Member(hall, who, glsplat.Pose.zero(55))
        clients.append(ClientStream(i, session, shown=AvatarInfo(name="nobody"), member=member))
    periods = 1 / rng.choice([10, 20, 36, 72], count)
    due = now + rng.uniform(0, periods)
    texts = [json.dumps({"v": 1, "frame_id": n, "want": "pose"}) for n in range(1, int(seconds * 80) + 2)]
    asked = np.zeros(count, np.int64)
    poses = [glsplat.Pose(rng.normal(0, 0.3, (55, 3))) for _ in range(72)]
    replies, size, spent, end, tick = 0, 0, 0.0, now + seconds, 0

    async def turn() -> None:
        nonlocal now, replies, size, spent, tick
        while now < end:
            now = 1000.0 + tick / rate
            start = time.thread_time()
            hall.add_sample(speaker, PoseSample(poses[tick % 72], now, tick * 1e3 / rate, tick))
            tick += 1
            for i in np.flatnonzero(due <= now):
                client = clients[i]
                client.session.receive(texts[asked[i]], now)
                asked[i] += 1
                answers.due(client)
                answer = client.answers.get_nowait()
                (data,) = answers.pack(answer).messages
                client.session.sent(answer.request, len(data))
                replies += 1
                size += len(data)
                due[i] += periods[i]
            spent += time.thread_time() - start

    asyncio.run(turn())
    rooms_person.pack_body = original  # type: ignore[attr-defined]
    print(
        f"{count} listeners, one speaker, {seconds:g} s: {tick} samples, {packed} bodies packed, {replies} replies of "
        f"{size / replies:.0f} bytes, {spent / replies * 1e6:.0f} us of a core each without the socket "
        f"({spent / seconds * 100:.0f} % of a core for all)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--people", type=int, nargs="+", default=[1, 10])
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--rate", type=float, nargs="+", default=[72.0], help="samples a second of each")
    parser.add_argument("--listeners", type=int, default=1000)
    parser.add_argument("--no-server", action="store_true", help="only what needs no sockets")
    args = parser.parse_args()
    solving()
    without_sockets(10, 5.0, 72.0)
    listeners(args.listeners, 3.0, 72.0)
    if args.no_server:
        return
    command = [sys.executable, "-m", "apps.cli", "serve", "--port", "0", "--json", "--room", "lab:64"]
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        print('max-clients = 64\nwatermark = "off"', file=file, flush=True)
        measured([*command, "--config", file.name], args)


def measured(command: list[str], args: argparse.Namespace) -> None:
    """Print a row for each number of people and rate in the room of a server."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            told = json.loads(server.stdout.readline())
            print(
                "| people | samples/s each | CPU a sample, ms, program + system | a person, of a core | answered "
                "| of each other seen, /s | down for each seen, Mbit/s | round trip, ms | 95 % |\n" + "|--:" * 9 + "|"
            )
            for people, rate in itertools.product(args.people, args.rate):
                asyncio.run(room(told["url"], people, rate, args.seconds, psutil.Process(server.pid)))
                time.sleep(3)  # who left is forgotten
        finally:
            server.terminate()


if __name__ == "__main__":
    main()
