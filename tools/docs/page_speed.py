"""How fast the page is: the table of docs/vr.md, with stored pictures and with the real renderer.

    python -m tools.docs.page_speed [--seconds 8]

Browser (software OpenGL), server and renderer share this machine: compare rows. "replay" is `glsplat replay` against
the same server without a browser.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import Any

import glsplat
from glsplat.net.served_scene import gl_server
from tests.browser.markers import offered
from tests.browser.served import Served
from tests.browser.stored import StoredPairs
from tests.browser.vr import enter, hands, pose, settings, steer
from tools.docs.chromium import chromium, page_of

MOVING = """() => { fakeXR.motion = (time, device) => {
  const turn = 0.1 * Math.sin(time / 400);
  device.head = [0.05 * Math.sin(time / 700), 1.65, 0, 0, Math.sin(turn), 0, Math.cos(turn)];
}; }"""
HEAD = (
    "| pictures | 2 x | decoding | display frames/s | shown/s | age, median | 95 % | round trip | decode, ms | upload |"
)


def page_row(browser: Any, served: Served, size: int, where: str, seconds: float) -> dict[str, Any]:
    """window.glsplat.stats() after some seconds in the mirror."""
    init = settings(view="mirror", size=size, quality=80, driver="rest")
    with page_of(browser, f"{served.page}/?decode={where}", init) as page:
        steer(page, input="hands", hands=hands(pose([-0.3, 1, -0.3]), pose([0.3, 1.3, -0.3])), side=size)
        page.js(MOVING)
        enter(page)
        page.wait(2.0 + seconds)
        return page.stats()


def replay_fps(served: Served, size: int, seconds: float) -> float:
    """Pictures a second that `glsplat replay` shows."""
    address = f"{served.origin.replace('http', 'ws', 1)}/ws"
    command = [sys.executable, "-m", "apps.cli", "replay", "--url", address, "--size", str(size)]
    command += ["--frames", str(round(72 * seconds)), "--crop", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)["fps"]


def main(seconds: float) -> None:
    print(HEAD, "|--|--:|---|--:|--:|--:|--:|--:|--:|--:|", sep="\n")
    kinds = {
        "stored": lambda: Served(StoredPairs(), offered=offered),
        "drawn": lambda: Served(make=lambda config: gl_server(glsplat.default_avatar(), config)),
    }
    for kind, start in kinds.items():
        for size in (512, 1024):
            with start() as served:
                with chromium() as browser:
                    for where in ("worker", "main"):
                        s = page_row(browser, served, size, where, seconds)
                        row = [kind, f"{size}²", where, s["frameRate"], s["fps"], s["ageMs"], s["ageP95Ms"], s["rttMs"]]
                        print("|", " | ".join(map(str, [*row, s["decodeMs"], s["uploadMs"]])), "|", flush=True)
                print(f"{kind} {size}: replay without a browser shows {replay_fps(served, size, seconds):.1f} a second")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=8.0)
    main(parser.parse_args().seconds)
