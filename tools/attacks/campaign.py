"""Attack a server, by hand: ``python -m tools.attacks.campaign`` prints a table of what a good client gets.

Each attack has its own ``glsplat serve`` with default options. Phases of the good client alone and under attack
alternate; the table has the median of the ratios of consecutive phases. Attackers and client run on the server's
machine, so the attackers do little work.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from dataclasses import dataclass
from statistics import median

from tests.net.attacks.attack import ATTACKS, EVERYTHING, Attackers, attackers
from tests.net.attacks.good import GoodClient, Service
from tests.net.attacks.victim import Victim, victim

HEAD = (
    "| attack | undisturbed | rate | age | afterwards | RSS MB | lives | log lines | losses | rebuilds | refused | |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|"
)

SIZE, HERTZ = 128, 3.0  # of the good client: pixels per eye and requests per second
WARM_UP_S, QUIET_S = 1.5, 2.0  # before the first phase; of a phase without attack


@dataclass(frozen=True, slots=True)
class Outcome:
    """One row of the table."""

    attack: str
    quiet: list[Service]  # without attack, before each attack and after the last
    attacked: list[Service]
    rss: tuple[float, float]  # MB of server and renderer, before and after
    alive: bool
    log_lines: int
    rebuilds: int
    refused: int

    @property
    def ratios(self) -> tuple[float, float]:
        """Rate and age under attack to those of the quiet phase before; medians over the rounds."""
        first = self.quiet[0]  # replaces phases in which the server had not recovered yet
        calm = [phase if phase.rate >= 0.7 * first.rate else first for phase in self.quiet]
        pairs = [hit.against(base) for base, hit in zip(calm, self.attacked, strict=False)]
        return median(rate for rate, _ in pairs), median(age for _, age in pairs)

    @property
    def held(self) -> bool:
        """Whether the server lives and sends at least 70 % of the pictures at no more than twice their age."""
        rate, age = self.ratios
        return self.alive and rate >= 0.7 and age <= 2.0

    def __str__(self) -> str:
        rate, age = self.ratios
        first, last = self.quiet[0], self.quiet[-1]
        losses = sum(phase.losses for phase in self.attacked)
        return (
            f"| {self.attack} | {first.rate:.1f}/s, {first.age:.0f} ms | {rate:.0%} | {age:.1f} "
            f"| {last.against(first)[0]:.0%} | {self.rss[0]:.0f} → {self.rss[1]:.0f} | {'yes' if self.alive else 'NO'} "
            f"| {self.log_lines} | {losses} | {self.rebuilds} | {self.refused} | {'' if self.held else 'missed'} |"
        )


async def measure(
    server: Victim,
    raiders: Attackers,
    name: str,
    *,
    sources: list[str],
    connections: int,
    seconds: float,
    good: str,
    datagrams: bool,  # send the good client's pictures by datagrams
) -> Outcome:
    """Run one attack from each of ``sources`` in turn, with quiet phases before, between and after."""
    client = GoodClient(server.target.to(good), SIZE, HERTZ, datagrams=datagrams)
    running = asyncio.create_task(client.run())
    try:
        await asyncio.sleep(WARM_UP_S)
        while datagrams and not client.by_datagrams:
            await asyncio.sleep(0.1)
        calm: list[Service] = []
        for _ in range(5):  # other load may spoil the first quiet phase
            calm = [await client.over(QUIET_S)]
            if calm[0].rate >= 0.8 * HERTZ:
                break
        rss, lines, hits = server.rss()["all"], server.log_lines, []
        for source in sources:
            await asyncio.to_thread(raiders.begin, name, source, connections)
            await asyncio.sleep(0.3)
            hits.append(await client.over(seconds))
            await asyncio.to_thread(raiders.end)
            await asyncio.sleep(0.5)
            calm.append(await client.over(QUIET_S))
    finally:
        running.cancel()
    if datagrams:
        print(f"    {len(client.by_datagrams)} of {len(client.arrivals)} pictures by datagrams", file=sys.stderr)
    if server.log_lines > lines + 60:
        print("    its log ends: " + server.log[-300:].replace("\n", "\n    "), file=sys.stderr)
    for error in client.errors[:3]:
        print(f"    the good client: {error}", file=sys.stderr)
    alive = await asyncio.to_thread(server.alive)
    stats = await asyncio.to_thread(server.stats)
    left = server.rss()["all"] if server.process.poll() is None else float("nan")
    counts = server.log_lines - lines, stats.get("rebuilds", -1), stats.get("refused", -1)
    return Outcome(name, calm, hits, (rss, left), alive, *counts)


def addresses(source: str, rounds: int) -> list[str]:
    """Return a different source address for each round, as the server may have blocked the last one."""
    base, _, last = source.rstrip("+").rpartition(".")
    step = 16 if source.endswith("+") else 1
    return [f"{base}.{int(last) + step * i}{'+' if step > 1 else ''}" for i in range(rounds)]


def main() -> None:
    """Run the attacks named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="attacks; default: each alone, then all at once")
    parser.add_argument("--source", default="127.0.0.3", help="the attackers' address; 127.0.0.10+ gives each its own")
    parser.add_argument("--connections", type=int, default=4, help="connections of each attack (16 for all at once)")
    parser.add_argument("--good", default="127.0.0.2", help="the good client's address")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0, help="of an attack in a round; doubled for all at once")
    parser.add_argument("--datagrams", action="store_true", help="use datagrams for the good client (127.0.0.1)")
    parser.add_argument("--files", type=int, help="limit of the server's file descriptors")
    parser.add_argument("--options", default="", help="options of glsplat serve, name=value for those of its file")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # which ends the server, too
    names = args.names or [*ATTACKS, EVERYTHING]
    if unknown := [name for name in names if name not in (*ATTACKS, EVERYTHING)]:
        parser.error(f"{unknown[0]!r} is none of {', '.join([*ATTACKS, EVERYTHING])}")
    options = args.options.split()
    if args.datagrams:
        args.good = "127.0.0.1"  # source address of its QUIC
        options.append("webtransport=true")
    same = args.source == args.good
    for name in names:
        whole = name == EVERYTHING
        with victim(*options, files=args.files) as server, attackers(server.port) as raiders:
            if name == names[0]:
                print(f"{server.driver}; attackers from {args.source}, the good client {args.good}\n\n{HEAD}")
            run = measure(
                server,
                raiders,
                name,
                sources=[args.good] * args.rounds if same else addresses(args.source, args.rounds),
                connections=16 if whole else args.connections,
                seconds=args.seconds * (2 if whole else 1),
                good=args.good,
                datagrams=args.datagrams,
            )
            print(asyncio.run(run), flush=True)


if __name__ == "__main__":
    main()
