"""Measure frames of glsplat and of other splat viewers, interleaved in one run: docs/measured/peers.md. By hand.

    python -m tools.peers FOLDER [SIDE ...]        # minutes of a quiet machine

FOLDER is where npm installs the others, and where a picture of each is written. All draw the 40,000 splats of the
embedded avatar standing; the page and glsplat's own renderer also draw it walking. That renderer draws, reads back and
encodes as a server does.
"""

from __future__ import annotations

import argparse
import base64
import functools
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from playwright.sync_api import sync_playwright

import glsplat
from apps.webpage import baked
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.browser.web_format.write import encode_avatar
from glsplat.formats.motion_files import load_motion
from glsplat.io.files import replace_file
from glsplat.io.provenance import machine
from glsplat.motion.motion import Motion
from glsplat.net.codec.encode import encode_picture
from glsplat.net.pages import page_files
from glsplat.views import view_of
from tests import needs
from tools.docs.measured import FOLDER, Table, page_of

PACKAGES = (
    "three@0.180.0",
    "older@npm:three@0.160.0",
    "@mkkellogg/gaussian-splats-3d@0.4.7",
    "@sparkjsdev/spark@2.2.0",
    "gsplat@1.2.9",
)
MODULES = {
    "older": "/npm/older/build/three.module.js",
    "three": "/npm/three/build/three.module.js",
    "three/addons/": "/npm/three/examples/jsm/",
    "gs3d": "/npm/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js",
    "spark": "/npm/@sparkjsdev/spark/dist/spark.module.js",
    "gsplat": "/npm/gsplat/dist/index.es.js",
    "fflate": "/npm/fflate/esm/browser.js",
}
OWN = "`Renderer` and JPEG, walking"
ROUNDS, FRAMES = 4, 8
STANDING = 7  # frame of the walk for the still pose
SCOPES = {"/npm/@mkkellogg/": {"three": MODULES["older"]}}
VIEWS = {"whole": (2.7, 1.05), "near": (1.2, 1.45)}  # metres away, metres up


class _Handler(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


def write_site(folder: Path) -> None:
    """Write the page and its data as /data, glsplat's page as /vr, and the others' packages as /npm."""
    avatar = glsplat.default_avatar()
    walk = load_motion("walk", avatar.skeleton)
    html = f'<!doctype html><script type="importmap">{json.dumps({"imports": MODULES, "scopes": SCOPES})}</script>'
    html += '<script type="module" src="/data/page.js"></script>'
    files = {f"vr/{path}": body for path, body in page_files().items()} | {
        "data/index.html": html.encode(),
        "data/page.js": Path(__file__).with_name("viewers.js").read_bytes(),
        "data/avatar.splats": encode_avatar(avatar),
        "data/walk.json": json.dumps(baked(walk)).encode(),
        "data/pose.json": json.dumps(baked(walk)["frames"][STANDING]).encode(),
    }
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    glsplat.save(posed_splats(avatar, walk.pose(STANDING)), folder / "data" / "avatar.ply")
    if not (folder / "npm").exists():
        (folder / "npm").symlink_to("node_modules")


def own_ms(renderer: glsplat.Renderer, walk: Motion, view: tuple[float, float], frames: Iterable[int]) -> list[float]:
    """Return the ms in which glsplat's own renderer draws, reads back and encodes each frame, as ``serve --exact``."""
    found = []
    distance, height = view
    for frame in frames:
        angle = 2 * np.pi * frame / (ROUNDS * FRAMES)
        eye = np.array([distance * np.sin(angle), height, distance * np.cos(angle)])
        pair = list(view_of(eye, np.array([0, height - 0.1, 0]), renderer.size, 50.0, ipd=0.063))
        begun = time.perf_counter()
        for image in renderer.render(pair, walk.pose(frame % len(walk))):
            encode_picture(image)
        found.append(1e3 * (time.perf_counter() - begun))
    return found


def cpu_seconds() -> float:
    """Return the CPU seconds of this process and its children, which exclude other load on the machine."""
    me = psutil.Process()
    return sum(sum(one.cpu_times()[:2]) for one in (me, *me.children(recursive=True)))


def measured(page: Any, side: int, view: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Return median and CPU ms per frame by name; viewers take turns in ROUNDS rounds."""
    distance, height = view
    where = {"distance": distance, "height": height}
    names = page.evaluate("(question) => prepare(question)", {"side": side, **where})
    avatar = glsplat.default_avatar()
    walk, own = load_motion("walk", avatar.skeleton), glsplat.Renderer(avatar, size=(side, side), views=2)
    own_ms(own, walk, view, range(2))
    walls: dict[str, list[float]] = {name: [] for name in (*names, OWN)}
    used = dict.fromkeys(walls, 0.0)
    for turn in range(ROUNDS):
        for name in walls:
            question = {"name": name, "frames": FRAMES, "first": turn * FRAMES, "of": ROUNDS * FRAMES, **where}
            before = cpu_seconds()
            if name == OWN:
                walls[name] += own_ms(own, walk, view, range(turn * FRAMES, (turn + 1) * FRAMES))
            else:
                walls[name] += page.evaluate("(question) => run(question)", question)[1:]
            used[name] += cpu_seconds() - before
    own.release()
    return {name: (float(np.median(walls[name])), 1e3 * used[name] / (ROUNDS * FRAMES)) for name in walls}


def compared(folder: Path, sides: list[int]) -> Iterator[Table]:
    """Yield a table per size, and write a picture of each viewer into the folder."""
    if not (folder / "node_modules").is_dir():
        subprocess.run(["npm", "install", "--silent", "--prefix", str(folder), *PACKAGES], check=True)
    write_site(folder)
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with sync_playwright() as play:
        flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist"]
        browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=flags)
        for side in sides:
            found = {}
            for name, view in VIEWS.items():
                page = browser.new_page()
                page.on("pageerror", lambda error: print("page:", error, file=sys.stderr))
                page.goto(f"http://localhost:{server.server_port}/data/index.html")
                page.wait_for_function("window.ready", timeout=60_000)
                found[name] = measured(page, side, view)
                where = dict(zip(("distance", "height"), view, strict=True))
                for kind, content in page.evaluate("(where) => pictures(where)", where).items():
                    picture = base64.b64decode(content.partition(",")[2])
                    replace_file(folder / f"{kind}, {side}, {name}.png", [picture])
                page.close()
            rows = [f"| | {' | '.join(f'{name}: ms, CPU ms' for name in VIEWS)} |", "|---|" + "--:|" * len(VIEWS)]
            for kind in found["whole"]:
                cells = [f"{found[name][kind][0]:.0f}, {found[name][kind][1]:.0f}" for name in VIEWS]
                rows.append(f"| {kind} | {' | '.join(cells)} |")
            yield f"{side}", f"2 x {side}^2, Chromium {browser.version} and glsplat in turns.", "\n".join(rows)
        browser.close()
    server.shutdown()


def main(folder: Path, sides: list[int]) -> None:
    """Write the page."""
    facts = machine()
    said = (
        f"Commit {facts['commit']}, {facts['date']}; {facts['machine']}, {facts['cores']} cores, load "
        f"{os.getloadavg()[0]:.1f} before. A frame of both eyes of all 40,000 splats of the embedded avatar with a "
        "circling camera, drawn by ANGLE on Mesa's software driver; the median, and CPU time of all processes. "
        f"{', '.join(PACKAGES)}. Peers show a still pose: none has skinned splats. Rasterizers on PyPI are "
        "missing: splax 0.2.3 refuses JAX on a CPU, and gsplat needs CUDA for its tiles."
    )
    text = page_of("Other viewers", "python -m tools.peers FOLDER", said, compared(folder, sides))
    replace_file(FOLDER / "peers.md", [text])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Measure other viewers beside glsplat; minutes of a quiet machine.")
    parser.add_argument("folder", type=Path, help="for npm packages and a picture of each viewer")
    parser.add_argument("sides", type=int, nargs="*", default=[512, 1024], help="side in pixels")
    args = parser.parse_args()
    main(args.folder, args.sides)
