"""SOG beside splat-transform: what either reads of the other's files, and what is left of a picture.

    npm install @playcanvas/splat-transform@3.7.0
    python -m tests.formats.scripts.compare_sog node_modules/@playcanvas/splat-transform/bin/cli.mjs SCENE [CAMERA] ...

SCENE is a PLY, or a SOG of another maker that both only read; CAMERA (.camera.json) adds pictures. Not a test: Node.js
is not needed by the project. splat-transform clusters on the CPU here, one round, which takes minutes for SH.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from glsplat.camera import load_cameras
from glsplat.config import RenderConfig
from glsplat.evaluate.metrics.pixels import psnr
from glsplat.formats import load, save
from glsplat.renderer import Renderer
from glsplat.splats import Splats


def main(arguments: list[str]) -> None:
    tool, *rest = arguments
    cameras = {rest[i - 1]: name for i, name in enumerate(rest) if name.endswith(".camera.json")}
    for name in rest:
        if name in cameras.values():
            continue
        with tempfile.TemporaryDirectory() as folder:
            compare(tool, Path(name), cameras.get(name), Path(folder))


def compare(tool: str, path: Path, camera: str | None, folder: Path) -> None:
    if path.suffix != ".ply":
        told(f"{path.name}: read", load_splats(path), reread(tool, path, folder))
        return
    scene = load_splats(path)
    made = {"ours": folder / "ours.sog", "unpacked": folder / "ours" / "meta.json", "theirs": folder / "theirs.sog"}
    seconds = {}
    for kind, target in made.items():
        start = time.perf_counter()
        if kind == "theirs":
            run(tool, "-i", "1", str(path), str(target))
        else:
            save(scene, target)
        seconds[kind] = time.perf_counter() - start
        told(f"{path.name}: {kind}, read", load_splats(target), reread(tool, target, folder))
    for kind in ("ours", "theirs"):
        target = made[kind]
        size = target.stat().st_size
        print(f"{path.name}: {kind} has {size} bytes, {size / len(scene):.2f} a splat, {seconds[kind]:.1f} s", end="")
        print(f", {rendered(scene, load_splats(target), camera):.2f} dB" if camera else "")


def run(tool: str, *arguments: str) -> None:
    subprocess.run(["node", tool, "-q", "-w", "-g", "cpu", "--max-workers", "0", *arguments], check=True)


def reread(tool: str, path: Path, folder: Path) -> Splats:
    """As splat-transform reads a file: its PLY of it."""
    run(tool, str(path), str(folder / "reread.ply"))
    return load_splats(folder / "reread.ply")


def load_splats(path: Path) -> Splats:
    scene = load(path)
    assert isinstance(scene, Splats)
    return scene


def told(title: str, ours: Splats, theirs: Splats) -> None:
    """The largest differences, in quantisation steps where there are such."""
    assert len(ours) == len(theirs) and ours.sh.shape == theirs.sh.shape
    logs = [np.sign(s.means) * np.log1p(np.abs(s.means.astype(np.float64))) for s in (ours, theirs)]
    turned = theirs.quats * np.sign((ours.quats * theirs.quats).sum(axis=1, keepdims=True))
    steps = {
        "means": np.abs(logs[0] - logs[1]) / (np.ptp(logs[0], axis=0) / 65535),
        "quats": np.abs(ours.quats - turned) / (math.sqrt(2) / 255),
        "opacities": np.abs(ours.opacities - theirs.opacities) * 255,
        "log scales (absolute)": np.abs(np.log(ours.scales) - np.log(theirs.scales)),
        "SH (absolute)": np.abs(ours.sh - theirs.sh),
    }
    print(
        f"{title} by both, largest difference:", ", ".join(f"{key} {value.max():.2g}" for key, value in steps.items())
    )


def rendered(scene: Splats, other: Splats, camera: str) -> float:
    view = load_cameras(camera)[0]
    pictures = []
    for splats in (scene, other):
        config = RenderConfig(output="float32", target="32f")
        with Renderer(splats, size=(view.width, view.height), config=config) as renderer:
            pictures.append(np.clip(renderer.render([view])[0, ..., :3], 0, 1).astype(np.float64))
    return psnr(pictures[1], pictures[0])


if __name__ == "__main__":
    main(sys.argv[1:])
