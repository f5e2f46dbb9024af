"""Run the fuzzers of tests/net/attacks for longer.

python -m tools.attacks.fuzz messages 1000000
python -m tools.attacks.fuzz bytes 100000
"""

from __future__ import annotations

import argparse

from tests.net.attacks.fuzz_bytes import send
from tests.net.attacks.fuzz_messages import fuzz
from tests.net.attacks.victim import victim


def messages(number: int, seed: int) -> None:
    """Send fuzzed messages through decoder and session; print outcomes and each fault with its message."""
    findings = fuzz(number, seed)
    print(*findings.faults, findings, sep="\n")


def streams(number: int, seed: int) -> None:
    """Send fuzzed bytes to a server; print its answers, its memory and the first traceback of its log."""
    with victim("--size", "64x64") as server:
        send(server, number // 20, seed + 1)  # warm up before measuring memory
        early = server.rss()
        sent = send(server, number, seed)
        late, alive, log = server.rss(), server.alive(), server.log
    print(
        f"{sent.streams} streams in {sent.seconds:.0f} s; alive: {alive and not sent.dead}; "
        f"{log.count('Traceback')} tracebacks and {log.count(chr(10))} lines in the log ({len(log)} bytes); "
        f"/healthz meanwhile: median {sorted(sent.probes)[len(sent.probes) // 2] * 1e3:.0f} ms, "
        f"slowest {max(sent.probes) * 1e3:.0f} ms; memory {early['server']:.1f} → {late['server']:.1f} MB serving, "
        f"{early['all']:.1f} → {late['all']:.1f} MB in all"
    )
    print(", ".join(f"{name!r} {count}" for name, count in sent.answers.most_common(20)))
    if sent.faults:
        print(f"the server's own faults: streams {sent.faults[:50]} of seed {seed}")
    if "Traceback" in log:
        print(log[log.index("Traceback") - 200 :][:4000])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=["messages", "bytes"])
    parser.add_argument("number", type=int, nargs="?", default=5000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    (messages if given.what == "messages" else streams)(given.number, given.seed)
