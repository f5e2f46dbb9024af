"""How long an avatar of a photograph takes on the page, against the command, in turns.

    python -m tools.net.page_making me.jpg                     # two turns, all steps
    python -m tools.net.page_making me.jpg you.jpg --turns 3

On the page: a server of its own on localhost with `--allow-upload`, Chromium with the page open and its pictures
streaming, from the press on *Make* until the page says that the avatar is ready. The command is `glsplat avatar photo`
with its defaults, from its start to its end. Told are both times and the CPU time of either: of the command, and of the
server with the process that makes and of the browser.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.browser.vr import settings
from tools.docs.chromium import chromium, page_of

_TICK = os.sysconf("SC_CLK_TCK")
_CLI = [sys.executable, "-m", "apps.cli"]
_LONGEST = 1800.0  # seconds that one avatar may take


def cpu_seconds(root: int) -> float:
    """Of a process, of its children that ended, and of those that live."""
    rows: dict[int, tuple[int, int]] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                words = (folder / "stat").read_text().rpartition(")")[2].split()
                rows[int(folder.name)] = int(words[1]), sum(map(int, words[11:15]))
    tree, ticks = [root], 0
    for one in tree:
        ticks += rows.get(one, (0, 0))[1]
        tree += [pid for pid, (parent, _) in rows.items() if parent == one]
    return ticks / _TICK


def by_command(photo: Path, folder: Path) -> tuple[float, float]:
    """Seconds, and seconds of CPU time."""
    words = [*_CLI, "avatar", "photo", str(photo), "-o", str(folder / "command.glb"), "--anyway", "--json"]
    began = time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0, f"{' '.join(words)} failed"
    return time.perf_counter() - began, usage.ru_utime + usage.ru_stime


def on_the_page(page: Any, photo: Path, server: int) -> tuple[float, float, float]:
    """Seconds, seconds of CPU time of the server and its maker, and of the browser."""
    page.page.set_input_files("#photo-front", str(photo))
    page.page.check("#photo-consent")
    # playwright's driver is this process's child, the browser the driver's
    before, ours = cpu_seconds(server), cpu_seconds(os.getpid())
    began = time.perf_counter()
    page.page.click("#photo-make")
    said = "document.querySelector('#photo-said').textContent"
    while (words := page.js(said)) == "" or not words.startswith(("Your avatar is ready", "It did not")):
        if page.js("!document.querySelector('#photo-anyway').hidden"):
            page.page.click("#photo-anyway")
        assert time.perf_counter() - began < _LONGEST, words
        page.wait(0.25)
    took = time.perf_counter() - began
    assert words.startswith("Your avatar is ready"), words
    made = cpu_seconds(server) - before
    browser = cpu_seconds(os.getpid()) - ours - made  # the server is this process's child, too
    page.js("document.querySelector('#photo-wear').click()")
    page.until("document.querySelector('#photo-work').hidden")
    return took, made, browser


@contextmanager
def serving(folder: Path) -> Iterator[tuple[int, str]]:
    """A server's process and the address of its page."""
    words = [*_CLI, "serve", "--port", "0", "--json", "--allow-upload", str(folder)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            assert server.stdout is not None
            yield server.pid, json.loads(server.stdout.readline())["page"]
        finally:
            server.terminate()


def main() -> None:
    """A line for each turn, then the ratio of the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path, nargs="+")
    parser.add_argument("--turns", type=int, default=2)
    args = parser.parse_args()
    walls: list[tuple[float, float]] = []
    for photo in args.photos:
        for turn in range(args.turns):
            with tempfile.TemporaryDirectory() as made, serving(Path(made)) as (server, address), chromium() as browser:
                with page_of(browser, address, settings(drawer=True), xr=False) as page:
                    page.until("window.glsplat?.stats().shown > 0")
                    page.page.click("#photo summary")
                    took, making, showing = on_the_page(page, photo, server)
                    shown = page.js("window.glsplat.stats().shown")
            with tempfile.TemporaryDirectory() as made:
                alone, cpu = by_command(photo, Path(made))
            walls.append((took, alone))
            parts = f"CPU: server and maker {making:.1f} s, browser {showing:.1f} s; {shown} pictures shown"
            told = f"page {took:.1f} s ({parts}), command {alone:.1f} s (CPU {cpu:.1f} s)"
            print(f"{photo.name} {turn + 1}: {told}: {took / alone:.2f}", flush=True)
    page_time, command_time = (statistics.median(column) for column in zip(*walls, strict=True))
    print(f"medians: page {page_time:.1f} s, command {command_time:.1f} s: {page_time / command_time:.2f} times")


if __name__ == "__main__":
    main()
