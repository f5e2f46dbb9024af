"""Holds our SPZ against readers and writers of others, on a real scene. For development; no test runs it.

    mkdir others && cd others && npm install @playcanvas/splat-transform @adobe/spz spz-js
    python tests/formats/scripts/compare_spz.py others scene.ply

Prints the largest difference of each attribute in steps of its quantisation (rotations: degrees, which differ
by half a turn where a splat's own axes have other signs; its shape counts), for files that they
write and both read, and for files that we write and they read. spz-js is an implementation of its own of versions 1
and 2 and does not turn the axes; the other two are Niantic's.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from glsplat.formats.ply import load_ply
from glsplat.formats.spz import load_spz, read_spz, save_spz
from glsplat.splats import Splats

SYSTEMS = {1: "LDB", 4: "RUB", 6: "RDF", 7: "LUF", 11: "LFU", 12: "RFU", 13: "LBD", 14: "RBD"}

READ = """
import { readFileSync, writeFileSync } from 'fs';
const [kind, from, to] = process.argv.slice(2);
let cloud;
if (kind === 'adobe') {
  const spz = await (await import('@adobe/spz')).default();
  cloud = spz.loadSpzFromBuffer(readFileSync(from), { to: spz.CoordinateSystem.RDF });
} else cloud = await (await import('spz-js')).loadSpz(readFileSync(from));
const names = ['positions', 'rotations', 'scales', 'alphas', 'colors', 'sh'];
const arrays = names.map(name => Float32Array.from(cloud[name]));
const head = Float32Array.from([cloud.numPoints, cloud.shDegree, cloud.antialiased ? 1 : 0]);
writeFileSync(to, Buffer.concat([head, ...arrays].map(a => Buffer.from(a.buffer))));
"""

WRITE = """
import { readFileSync, writeFileSync } from 'fs';
const [from, to, version, degree, antialiased] = process.argv.slice(2);
const spz = await (await import('@adobe/spz')).default();
const cloud = spz.loadSpzFromBuffer(readFileSync(from), { to: spz.CoordinateSystem.RDF });
if (+degree === 4) {  // degree 4 is made up
  const sh = new Float32Array(cloud.numPoints * 72).map((_, i) => ((i * 37) % 101) / 101 - 0.5);
  cloud.shDegree = 4; cloud.sh = sh;
}
cloud.antialiased = antialiased === '1';
const options = { version: +version, from: spz.CoordinateSystem.RDF, sh1Bits: 8, shRestBits: 8 };
writeFileSync(to, spz.saveSpzToBuffer(cloud, options));
"""


def main(others: Path, scene: Path) -> None:
    """All comparisons, a line each."""
    with tempfile.TemporaryDirectory(dir=others) as name:
        folder = Path(name)
        (folder / "read.mjs").write_text(READ)
        (folder / "write.mjs").write_text(WRITE)
        truth = load_ply(scene)
        for version in ("3", "4"):
            spz, ply = folder / f"v{version}.spz", folder / "theirs.ply"
            transform(others, scene, spz, "--spz-version", version)
            transform(others, spz, ply)
            show(f"theirs, v{version}: read by us | splat-transform", load_spz(spz), load_ply(ply))
            show(f"theirs, v{version}: read by us | @adobe/spz", load_spz(spz), theirs(folder, "adobe", spz))
            show(f"theirs, v{version}: read by us | the scene", load_spz(spz), truth)
        for written in (2, 3):
            ours = folder / f"ours{written}.spz"
            save_spz(truth, ours, version=written)
            show(f"ours, v{written}: read by us | @adobe/spz", load_spz(ours), theirs(folder, "adobe", ours))
            show(f"ours, v{written}: read by us | the scene", load_spz(ours), truth)
        transform(others, folder / "ours3.spz", folder / "ours.ply")
        show("ours, v3: read by us | splat-transform", load_spz(folder / "ours3.spz"), load_ply(folder / "ours.ply"))
        show(
            "ours, v2: read by us | spz-js", unturned(folder / "ours2.spz"), theirs(folder, "js", folder / "ours2.spz")
        )
        made = folder / "made.spz"
        for version, degree in (("3", "4"), ("4", "4"), ("2", "0")):
            node(folder, "write.mjs", folder / "ours3.spz", made, version, degree, "1")
            show(
                f"v{version} of degree {degree}: read by us | @adobe/spz", load_spz(made), theirs(folder, "adobe", made)
            )
        for code, system in SYSTEMS.items():  # of version 4: @adobe/spz 0.2.3 passes over those of older files
            made.write_bytes(with_axes((folder / "v4.spz").read_bytes(), code))
            show(f"v4, axes {system}: read by us | @adobe/spz", load_spz(made), theirs(folder, "adobe", made))


def with_axes(data: bytes, code: int) -> bytes:
    """The file with the extension that names its axes."""
    extension = struct.pack("<III", 0xADBE0003, 4, code)
    return data[:14] + b"\2" + data[15:16] + struct.pack("<I", 44) + data[20:32] + extension + data[32:]


def transform(others: Path, source: Path, target: Path, *more: str) -> None:
    """Run splat-transform."""
    program = others / "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    command = ["node", str(program), "-q", "-w", "-g", "cpu", *more, str(source), str(target)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def node(folder: Path, *words: object) -> None:
    """Run one of the scripts above; what a library prints is of no interest."""
    subprocess.run(["node", *map(str, words)], check=True, cwd=folder, stdout=subprocess.DEVNULL)


def theirs(folder: Path, kind: str, spz: Path) -> Splats:
    """What a library of others reads."""
    node(folder, "read.mjs", kind, spz, folder / "cloud")
    values = np.fromfile(folder / "cloud", "<f4")
    count, degree, antialias = (int(value) for value in values[:3])
    widths = (3, 4, 3, 1, 3, 3 * ((degree + 1) ** 2 - 1))
    parts = np.split(values[3:], np.cumsum([count * width for width in widths])[:-1])
    means, quats, scales, alphas, colours, rest = (
        part.reshape(count, width) for part, width in zip(parts, widths, strict=True)
    )
    sh = np.concatenate([colours[:, None], rest.reshape(count, -1, 3)], 1)[:, :16]
    with np.errstate(over="ignore"):
        opacities = 1 / (1 + np.exp(-alphas[:, 0]))
    return Splats(means, np.roll(quats, 1, axis=1), np.exp(scales), opacities, sh, bool(antialias))


def unturned(spz: Path) -> Splats:
    """The file in its own axes."""
    with open(spz, "rb") as file:
        return read_spz(file, spz.stat().st_size, turn=False)


def differences(a: Splats, b: Splats) -> Iterator[tuple[str, float]]:
    """The largest of each attribute, in steps."""
    yield "positions", np.abs(a.means - b.means).max() * 4096
    yield "opacities", np.abs(a.opacities - b.opacities).max() * 255
    yield "colours", np.abs(a.sh[:, 0] - b.sh[:, 0]).max() * 38.25
    yield "scales", np.abs(np.log(np.sort(a.scales) / np.sort(b.scales))).max() * 16
    yield "shapes (relative)", shape_difference(a, b)
    apart = np.minimum(np.linalg.norm(a.quats - b.quats, axis=1), np.linalg.norm(a.quats + b.quats, axis=1))
    yield "degrees", float(np.degrees(4 * np.arcsin(np.minimum(apart / 2, 1))).max())
    if a.sh_degree:
        yield "SH / 128", np.abs(a.sh[:, 1:] - b.sh[:, 1:]).max() * 128


def shape_difference(a: Splats, b: Splats) -> float:
    """Of the covariances, in parts of the larger splat's; a mirrored splat may have other axes and the same shape."""
    first, second = covariances(a), covariances(b)
    return float((np.linalg.norm(first - second, axis=(1, 2)) / np.linalg.norm(first, axis=(1, 2))).max())


def covariances(splats: Splats) -> np.ndarray:
    """[N, 3, 3], in float64."""
    w, x, y, z = splats.quats.astype(float).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    shapes = np.moveaxis(np.array(rows), -1, 0) * splats.scales[:, None, :].astype(float)
    return shapes @ shapes.transpose(0, 2, 1)


def show(title: str, a: Splats, b: Splats) -> None:
    """One line."""
    assert len(a) == len(b) and a.sh_degree == b.sh_degree, (a, b)
    flags = "" if a.antialias == b.antialias else " ANTIALIAS DIFFERS"
    print(f"{title}: " + ", ".join(f"{name} {value:.3g}" for name, value in differences(a, b)) + flags, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve())
