"""Attackers by name, and a process of its own that runs them."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.net.attacks.floods import FLOODS
from tests.net.attacks.handshakes import HANDSHAKES
from tests.net.attacks.pictures import PICTURES
from tests.net.attacks.requests import collapsed
from tests.net.attacks.sockets import Attack, Target
from tests.net.attacks.strangers import STRANGERS

__all__ = ["ATTACKS", "EVERYTHING", "Attackers", "attackers"]

ROOT = Path(__file__).resolve().parents[3]
ATTACKS = {**FLOODS, **PICTURES, **HANDSHAKES, **STRANGERS}
EVERYTHING = "all at once"


class Raid:
    """One attack under way: a thread for each connection."""

    def __init__(self, name: str, port: int, source: str, connections: int) -> None:
        names = [name] if name != EVERYTHING else list(ATTACKS)
        self.stop = threading.Event()
        self._threads = []
        for number in range(connections):
            # all at once: the connections share the attacks between them, two seconds of each, begun apart
            attacks = [ATTACKS[name] for name in names[number * 3 % len(names) :] + names[: number * 3 % len(names)]]
            arguments = (attacks, Target(port, source_of(source, number)), number, self.stop)
            self._threads.append(threading.Thread(target=in_turn, args=arguments, daemon=True))
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Tell all to stop; wait for them, but not for long."""
        self.stop.set()
        until = time.monotonic() + 3
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))


def main() -> None:
    """Raids on the port, one for each line (name, source, connections) of standard input."""
    port = int(sys.argv[1])
    collapsed()  # reads an avatar: not while somebody measures
    print("ready", flush=True)
    raid = None
    for line in sys.stdin:
        if raid is not None:
            raid.end()
            raid = None
        if line.strip():
            name, source, connections = line.strip().split("\t")
            raid = Raid(name, port, source, int(connections))
        print("done", flush=True)


def source_of(source: str, number: int) -> str:
    """The address of a connection: the same for all, or, with a +, one for each."""
    if not source.endswith("+"):
        return source
    base, _, last = source[:-1].rpartition(".")
    return f"{base}.{int(last) + number}"


def in_turn(attacks: Sequence[Attack], target: Target, number: int, stop: threading.Event) -> None:
    """One attack, or each of several for two seconds."""
    if len(attacks) == 1:
        attacks[0](target, number, stop)
        return
    turn = 0
    while not stop.is_set():
        over = threading.Event()
        worker = threading.Thread(target=attacks[turn % len(attacks)], args=(target, number, over), daemon=True)
        worker.start()
        stop.wait(2.0)
        over.set()
        worker.join(3.0)
        turn += 1


class Attackers:
    """The process; ``begin`` and ``end`` as often as wanted."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._answer("ready")

    def begin(self, name: str, source: str = "127.0.0.1", connections: int = 4) -> None:
        """Begin an attack."""
        self._tell(f"{name}\t{source}\t{connections}")

    def end(self) -> None:
        """End it."""
        self._tell("")

    def _tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        self._answer("done")

    def _answer(self, expected: str) -> None:
        assert self._process.stdout is not None
        found = self._process.stdout.readline().strip()
        if found != expected:
            raise RuntimeError(f"the attackers ended: expected {expected!r}, not {found!r}")


@contextlib.contextmanager
def attackers(port: int) -> Iterator[Attackers]:
    """A process of attackers on the server at that port."""
    command = [sys.executable, "-m", "tests.net.attacks.attack", str(port)]
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield Attackers(process)
    finally:
        process.kill()
        process.communicate()


if __name__ == "__main__":
    main()
