"""The campaign, by hand: ``python -m tests.net.attacks.campaign`` prints a table of what a good client sees.

For each attack a real ``glsplat serve`` of its own, with default options: the good client alone, then under attack,
then alone again. Attackers and client run on the server's machine, so the attackers keep their own work small and
figures are ratios within one run.
"""

from __future__ import annotations

import argparse
import asyncio
import dataclasses
import json
import sys
import time
from dataclasses import dataclass

from tests.net.attacks.attack import ATTACKS, EVERYTHING, attacking
from tests.net.attacks.good import GoodClient, Service
from tests.net.attacks.victim import Victim, victim

__all__ = ["Outcome", "measure"]

WARM = 1.5  # seconds before anything counts


@dataclass(frozen=True, slots=True)
class Outcome:
    """One row of the table."""

    attack: str
    before: Service
    during: Service
    after: Service
    rss: tuple[float, float]  # MB of server and renderer, before and after
    alive: bool
    log_lines: int
    rebuilds: int
    refused: int

    @property
    def held(self) -> bool:
        """The promise: 70 % of the pictures at no more than twice their age, and a server that lives."""
        rate, age = self.during.against(self.before)
        return self.alive and rate >= 0.7 and age <= 2.0

    def __str__(self) -> str:
        rate, age = self.during.against(self.before)
        back = self.after.rate / self.before.rate
        return (
            f"| {self.attack} | {self.before.rate:.1f}, {self.before.age:.0f} ms | {rate:.0%} | {age:.1f} | {back:.0%} "
            f"| {self.rss[0]:.0f} → {self.rss[1]:.0f} | {'yes' if self.alive else 'NO'} | {self.log_lines} "
            f"| {self.during.losses} | {self.rebuilds} | {self.refused} | {'' if self.held else 'missed'} |"
        )


HEAD = (
    "| attack | undisturbed | rate | age | after | RSS MB | lives | log lines | losses | rebuilds | refused | |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|"
)


async def measure(
    server: Victim,
    name: str,
    *,
    source: str = "127.0.0.1",
    connections: int = 4,
    seconds: float = 8.0,
    quiet: float = 4.0,
    hertz: float | None = 5.0,
    size: int = 128,
) -> Outcome:
    """One attack on a running server: alone for ``quiet`` seconds, attacked for ``seconds``, alone once more."""
    client = GoodClient(server.target.to("127.0.0.2"), size, hertz)
    running = asyncio.create_task(client.run())
    try:
        await asyncio.sleep(WARM)
        before = await client.over(quiet)
        rss = server.rss()["all"]
        lines = server.log_lines
        block = attacking(name, server.port, source=source, connections=connections)
        await asyncio.to_thread(block.__enter__)
        try:
            await asyncio.sleep(0.5)
            during = await client.over(seconds)
        finally:
            await asyncio.to_thread(block.__exit__, None, None, None)
        await asyncio.sleep(1.0)
        after = await client.over(quiet)
    finally:
        running.cancel()
    for error in client.errors[:3]:
        print(f"    the good client: {error}", file=sys.stderr)
    alive = await asyncio.to_thread(server.alive)
    stats = await asyncio.to_thread(server.stats)
    left = server.rss()["all"] if server.process.poll() is None else float("nan")
    counts = server.log_lines - lines, stats.get("rebuilds", -1), stats.get("refused", -1)
    return Outcome(name, before, during, after, (rss, left), alive, *counts)


async def hour(server: Victim, seconds: float, source: str, connections: int) -> None:
    """Time-lapsed: every attack in turn, ``seconds`` in all; memory and service while it goes on."""
    client = GoodClient(server.target.to("127.0.0.2"), 128, 5.0)
    running = asyncio.create_task(client.run())
    await asyncio.sleep(WARM)
    before = await client.over(5.0)
    print(f"{0:6.0f} s: {server.rss()['server']:.1f} MB serving, {server.rss()['all']:.1f} MB in all", flush=True)
    start = time.monotonic()
    block = attacking(EVERYTHING, server.port, source=source, connections=connections)
    await asyncio.to_thread(block.__enter__)
    try:
        while (gone := time.monotonic() - start) < seconds:
            service = await client.over(min(20.0, max(1.0, seconds - gone)))
            rate, age = service.against(before)
            rss = server.rss()
            print(
                f"{time.monotonic() - start:6.0f} s: {rss['server']:.1f} MB serving, {rss['all']:.1f} MB in all, "
                f"rate {rate:.0%}, age x {age:.1f}, {server.log_lines} log lines",
                flush=True,
            )
    finally:
        await asyncio.to_thread(block.__exit__, None, None, None)
        running.cancel()
    await asyncio.sleep(3)
    rss = server.rss()
    totals = server.stats().get("totals", {})
    print(f"after: {rss['server']:.1f} MB serving, {rss['all']:.1f} MB, alive: {server.alive()}, {json.dumps(totals)}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="attacks; default: each alone, then all at once")
    parser.add_argument("--source", default="127.0.0.3", help="the attackers' address; 127.0.0.10+ gives each its own")
    parser.add_argument("--connections", type=int, default=4, help="hostile ones for each attack (16 for all at once)")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--quiet", type=float, default=4.0, help="seconds undisturbed, before and after")
    parser.add_argument("--hertz", type=float, default=5.0, help="the good client's pace; 0: as fast as pictures come")
    parser.add_argument("--size", type=int, default=128, help="pixels an eye of the good client")
    parser.add_argument("--files", type=int, help="descriptors the server may have")
    parser.add_argument("--hour", type=float, metavar="SECONDS", help="all attacks for so long, memory as it goes")
    parser.add_argument("--options", default="", help="further ones of glsplat serve")
    parser.add_argument("--json", help="write the rows to this file")
    args = parser.parse_args()
    names = args.names or [*ATTACKS, EVERYTHING]
    unknown = [name for name in names if name not in (*ATTACKS, EVERYTHING)]
    if unknown:
        parser.error(f"{unknown[0]!r} is none of {', '.join([*ATTACKS, EVERYTHING])}")
    if args.hour:
        with victim(*args.options.split(), files=args.files) as server:
            asyncio.run(hour(server, args.hour, args.source, 16))
        return
    rows = []
    for name in names:
        with victim(*args.options.split(), files=args.files) as server:
            if not rows:
                print(f"{server.driver}; attackers from {args.source}\n\n{HEAD}", flush=True)
            outcome = asyncio.run(
                measure(
                    server,
                    name,
                    source=args.source,
                    connections=16 if name == EVERYTHING else args.connections,
                    seconds=args.seconds * (4 if name == EVERYTHING else 1),
                    quiet=args.quiet,
                    hertz=args.hertz or None,
                    size=args.size,
                )
            )
            rows.append(outcome)
            print(outcome, flush=True)
    if args.json:
        with open(args.json, "w") as file:
            json.dump([dataclasses.asdict(row) for row in rows], file, indent=1)


if __name__ == "__main__":
    main()
