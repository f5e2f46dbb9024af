"""Attackers by name, and a process that runs them: ``python -m tests.net.attacks.attack NAME --port 8000``.

A process of its own, so that neither the server nor the good client waits for their locks.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from tests.net.attacks.floods import FLOODS
from tests.net.attacks.handshakes import HANDSHAKES
from tests.net.attacks.pictures import PICTURES
from tests.net.attacks.sockets import Target

__all__ = ["ATTACKS", "EVERYTHING", "attacking"]

ROOT = Path(__file__).resolve().parents[3]
ATTACKS = {**FLOODS, **PICTURES, **HANDSHAKES}
EVERYTHING = "all at once"


def main(argv: list[str] | None = None) -> None:
    """One thread a connection, until the time is over or standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], epilog="; ".join(ATTACKS))
    parser.add_argument("name", choices=[*ATTACKS, EVERYTHING])
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--source", default="127.0.0.1", help="loopback address to come from; A+ spreads them: A, A+1")
    parser.add_argument("--connections", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=10.0)
    args = parser.parse_args(argv)
    names = [args.name] if args.name != EVERYTHING else list(ATTACKS)
    stop = threading.Event()
    threads = []
    for number in range(args.connections):
        # all at once: the connections share all attacks between them, each a few seconds of every one
        attacks = [ATTACKS[name] for name in names[number % len(names) :] + names[: number % len(names)]]
        target = Target(args.port, source_of(args.source, number))
        threads.append(threading.Thread(target=in_turn, args=(attacks, target, number, stop), daemon=True))
    for thread in threads:
        thread.start()
    print("begun", flush=True)
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    stop.wait(args.seconds)
    stop.set()
    end = time.monotonic() + 3
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))


def source_of(source: str, number: int) -> str:
    """The address of a connection: the same for all, or, with a +, one for each."""
    if not source.endswith("+"):
        return source
    base, _, last = source[:-1].rpartition(".")
    return f"{base}.{int(last) + number}"


def in_turn(attacks, target: Target, number: int, stop: threading.Event) -> None:
    """One attack, or each of several for two seconds."""
    if len(attacks) == 1:
        attacks[0](target, number, stop)
        return
    start = number * 3
    while not stop.is_set():
        attack = attacks[start % len(attacks)]
        start += 1
        over = threading.Event()
        worker = threading.Thread(target=attack, args=(target, number, over), daemon=True)
        worker.start()
        stop.wait(2.0)
        over.set()
        worker.join(3.0)


@contextlib.contextmanager
def attacking(name: str, port: int, *, source: str, connections: int, seconds: float = 600.0) -> Iterator[None]:
    """The attack ``name`` goes on inside the block."""
    command = [sys.executable, "-m", "tests.net.attacks.attack", name, "--port", str(port), "--source", source]
    command += ["--connections", str(connections), "--seconds", str(seconds)]
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None and process.stdout.readline().strip() == "begun"
        yield
    finally:
        process.terminate()
        process.communicate()


if __name__ == "__main__":
    main()
