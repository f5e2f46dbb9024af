"""Frames of the page against those of other viewers of splats in a browser: the table of docs/webgl.md. By hand.

    python -m tools.peers.web_viewers FOLDER [SIDE ...]

FOLDER is where npm installs the others (three, GaussianSplats3D, Spark). The embedded avatar, all 40,000 splats:
standing for all, and walking for the page and for glsplat's own renderer, which draws, reads back and encodes as a
server does.
"""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import tempfile
import threading
import time
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

import glsplat
from apps.webpage.command import baked
from glsplat.formats.web.write import encode_avatar
from glsplat.making.posed import posed_splats
from glsplat.motion.motion import load_motion
from glsplat.net.codec.encode import encode_picture
from glsplat.shaders.web import programs_json
from glsplat.views import view_of

PACKAGES = (
    "three@0.180.0",
    "older@npm:three@0.160.0",
    "@mkkellogg/gaussian-splats-3d@0.4.7",
    "@sparkjsdev/spark@2.2.0",
)
MODULES = {
    "older": "/npm/older/build/three.module.js",
    "three": "/npm/three/build/three.module.js",
    "three/addons/": "/npm/three/examples/jsm/",
    "gs3d": "/npm/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js",
    "spark": "/npm/@sparkjsdev/spark/dist/spark.module.js",
    "fflate": "/npm/fflate/esm/browser.js",
}
STANDING = 7  # frame of the walk in which it stands for all
SCOPES = {"/npm/@mkkellogg/": {"three": MODULES["older"]}}
VIEWS = {"whole": (2.7, 1.05), "near": (1.2, 1.45)}  # metres away, and up


class _Handler(SimpleHTTPRequestHandler):
    roots: dict[str, Path]
    data: dict[str, bytes]

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        """Made things first, then files of one of the folders."""
        path = self.path.partition("?")[0]
        if path in self.data:
            kind = {"html": "text/html", "json": "application/json", "js": "text/javascript"}
            self.send_response(200)
            self.send_header("Content-Type", kind.get(path.rpartition(".")[2], "application/octet-stream"))
            self.send_header("Content-Length", str(len(self.data[path])))
            self.end_headers()
            self.wfile.write(self.data[path])
            return
        super().do_GET()

    def translate_path(self, path: str) -> str:
        """Of /vr/ and /npm/."""
        root, _, rest = path.partition("?")[0].strip("/").partition("/")
        return str(self.roots.get(root, Path("/nowhere")) / rest)


def files() -> dict[str, bytes]:
    """The page and what it shows."""
    avatar = glsplat.default_avatar()
    walk = load_motion("walk", avatar.skeleton)
    with tempfile.TemporaryDirectory() as folder:
        glsplat.save(posed_splats(avatar, walk.pose(STANDING)), Path(folder) / "avatar.ply")
        ply = (Path(folder) / "avatar.ply").read_bytes()
    html = f'<!doctype html><script type="importmap">{json.dumps({"imports": MODULES, "scopes": SCOPES})}</script>'
    html += '<script type="module" src="/data/page.js"></script>'
    page = Path(__file__).with_suffix(".js").read_bytes()
    return {
        "/data/index.html": html.encode(),
        "/data/page.js": page,
        "/data/avatar.ply": ply,
        "/data/avatar.splats": encode_avatar(avatar),
        "/data/walk.json": json.dumps(baked(walk)).encode(),
        "/data/pose.json": json.dumps(baked(walk)["frames"][STANDING]).encode(),
        "/vr/draw/programs.json": programs_json(),
    }


def own_renderer(side: int, view: tuple[float, float], frames: int) -> tuple[float, float]:
    """Median ms of a walking frame: drawn and read back, and that and encoded, as ``glsplat serve --exact`` does."""
    avatar = glsplat.default_avatar()
    walk = load_motion("walk", avatar.skeleton)
    distance, height = view
    drawn, encoded = [], []
    with glsplat.Renderer(avatar, size=(side, side), views=2) as renderer:
        for frame in range(frames + 1):
            angle = 2 * np.pi * frame / frames
            eye = np.array([distance * np.sin(angle), height, distance * np.cos(angle)])
            pair = list(view_of(eye, np.array([0, height - 0.1, 0]), (side, side), 50.0, ipd=0.063))
            begun = time.perf_counter()
            images = renderer.render(pair, walk.pose(frame % len(walk)))
            middle = time.perf_counter()
            for image in images:
                encode_picture(image[..., :3])
            if frame:
                drawn.append(middle - begun)
                encoded.append(time.perf_counter() - begun)
    return 1e3 * float(np.median(drawn)), 1e3 * float(np.median(encoded))


def main(folder: Path, sides: list[int]) -> None:
    """Print a table a side."""
    if not (folder / "node_modules").is_dir():
        subprocess.run(["npm", "install", "--silent", "--prefix", str(folder), *PACKAGES], check=True)
    from playwright.sync_api import sync_playwright

    from tests import needs

    web = Path(glsplat.__file__).parent / "net" / "web"
    _Handler.roots = {"vr": web, "npm": folder / "node_modules"}
    _Handler.data = files()
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Handler))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with sync_playwright() as play:
        flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist"]
        browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=flags)
        for side in sides:
            for name, (distance, height) in VIEWS.items():
                page = browser.new_page()
                page.on("pageerror", lambda error: print("page:", error, file=sys.stderr))
                page.goto(f"http://localhost:{server.server_port}/data/index.html")
                page.wait_for_function("window.ready", timeout=60_000)
                before = own_renderer(side, (distance, height), 16)
                question = {"side": side, "frames": 9, "rounds": 3, "distance": distance, "height": height}
                found = page.evaluate("(question) => measure(question)", question | {"pictures": False})["ms"]
                after = own_renderer(side, (distance, height), 16)
                page.close()
                best = [min(pair) for pair in zip(before, after, strict=True)]
                cells = {**found, "own renderer": best[0], "and JPEG": best[1]}
                print(
                    f"2 x {side}^2, {name}: " + ", ".join(f"{key} {ms:.0f} ms" for key, ms in cells.items()), flush=True
                )
        browser.close()
    server.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(side) for side in sys.argv[2:]] or [512, 1024])
