"""Measure seconds, bytes and memory of a million splats in every format: the table of docs/formats.md.

    python -m tools.docs.million [DEGREE]

A new process reads each file; memory is the growth of its peak.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import glsplat
from glsplat.formats import all_formats, save
from glsplat.splats import Splats

COUNT = 1_000_000


def scene(degree: int) -> Splats:
    """Return a million splats on a bumpy ground of ten metres."""
    rng = np.random.default_rng(1)
    means = rng.uniform(-5, 5, (COUNT, 3)).astype(np.float32)
    means[:, 1] = 0.3 * np.sin(means[:, 0]) + rng.normal(0, 0.02, COUNT)
    quats = rng.normal(0, 1, (COUNT, 4)).astype(np.float32)
    sh = rng.normal(0, 0.1, (COUNT, (degree + 1) ** 2, 3)).astype(np.float32)
    sh[:, 0] *= 8
    return Splats(
        means=means,
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        scales=np.exp(rng.normal(-4.5, 0.6, (COUNT, 3))).astype(np.float32),
        opacities=rng.uniform(0.05, 0.99, COUNT).astype(np.float32),
        sh=sh,
    )


def _peak() -> int:
    status = Path("/proc/self/status").read_text()  # ru_maxrss begins with the parent's
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


def _one(path: str) -> None:
    before, begun = _peak(), time.perf_counter()
    found = glsplat.load(path)
    seconds = time.perf_counter() - begun
    arrays = (found.means, found.quats, found.scales, found.opacities, found.sh)
    decoded = sum(array.nbytes for array in arrays)
    print(f"read {seconds:5.2f} s, memory {(_peak() - before) / decoded:4.2f} of the decoded size")


def main(degree: int) -> None:
    """Print a line per format."""
    splats = scene(degree)
    with tempfile.TemporaryDirectory() as folder:
        for form in all_formats().values():
            if form.save is None:
                continue
            path = Path(folder) / f"million{form.suffixes[0]}"
            begun = time.perf_counter()
            save(splats, path, format=form.name)
            seconds = time.perf_counter() - begun
            size = sum(file.stat().st_size for file in Path(folder).iterdir()) / COUNT
            print(f"{form.suffixes[0]:16} {size:6.1f} bytes a splat, write {seconds:5.2f} s, ", end="", flush=True)
            subprocess.run([sys.executable, "-m", "tools.docs.million", "--read", str(path)], check=True)
            for file in Path(folder).iterdir():
                file.unlink()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--read"]:
        _one(sys.argv[2])
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
