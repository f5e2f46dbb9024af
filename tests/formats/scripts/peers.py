"""Holds compressed PLY and KSPLAT against other programs, on real scenes.

    cd FOLDER; npm install @playcanvas/splat-transform @mkkellogg/gaussian-splats-3d three
    python -m tests.formats.scripts.peers FOLDER SCENE.ply ...

Prints, for each scene, the largest differences in steps of the format's quantisation (a step of each attribute is in
the text of glsplat/formats/compressed_ply.py and ksplat.py):

- read: a compressed PLY of splat-transform as read here, against splat-transform's own reading of it
- written: a compressed PLY written here as splat-transform reads it, against the scene: half a step is rounding, but
  the largest component of a rotation follows from the other three and may be off by one and a half;
  and how many bytes behind the header differ from the file that splat-transform writes
- ksplat 0, 1, 2: a KSPLAT of GaussianSplats3D as read here, against its getters, and against splat-transform
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.formats import load, load_ply, save
from glsplat.formats.morton import morton_order
from glsplat.splats import Splats

# writes a KSPLAT, and what the library's own getters say of it: means, scales, quaternions wxyz, rgba, SH
KSPLAT = """
import fs from 'node:fs';
globalThis.window ??= globalThis; globalThis.self ??= globalThis;
const { PlyLoader } = await import('@mkkellogg/gaussian-splats-3d');
const THREE = await import('three');
const [,, source, target, level, degree] = process.argv;
const bytes = fs.readFileSync(source);
const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const buffer = await PlyLoader.loadFromFileData(data, 0, Number(level), true, Number(degree), 4000);
fs.writeFileSync(target, Buffer.from(buffer.bufferData));
const count = buffer.getSplatCount(), rest = [0, 9, 24][Number(degree)];
const out = new Float32Array(count * (14 + rest));
const mean = new THREE.Vector3(), scale = new THREE.Vector3(), rgba = new THREE.Vector4();
const turn = new THREE.Quaternion(), sh = new Float32Array(count * rest);
// with a transform the values come unpacked, coefficient by coefficient
if (rest) buffer.fillSphericalHarmonicsArray(sh, Number(degree), new THREE.Matrix4(), 0, count - 1, 0, 0);
for (let i = 0; i < count; i++) {
    buffer.getSplatCenter(i, mean);
    buffer.getSplatScaleAndRotation(i, scale, turn);
    buffer.getSplatColor(i, rgba);
    const row = [...mean.toArray(), ...scale.toArray(), turn.w, turn.x, turn.y, turn.z, ...rgba.toArray()];
    out.set(row, i * (14 + rest));
    out.set(sh.subarray(i * rest, (i + 1) * rest), i * (14 + rest) + 14);
}
fs.writeFileSync(target + '.f32', Buffer.from(out.buffer));
"""


def main(folder: Path, scenes: list[Path]) -> None:
    """Prints a block for each scene."""
    (folder / "peers.mjs").write_text(KSPLAT)
    for scene in scenes:
        with tempfile.TemporaryDirectory(dir=folder) as work:
            print(scene.name)
            _compressed(folder, scene, Path(work))
            _ksplat(folder, scene, Path(work))


def _transform(folder: Path, source: Path, target: Path) -> None:
    program = folder / "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    subprocess.run(["node", str(program), "-q", "-w", "-g", "cpu", str(source), str(target)], check=True)


def _read(path: Path) -> Splats:
    scene = load(path)
    assert isinstance(scene, Splats)
    return scene


def _compressed(folder: Path, source: Path, work: Path) -> None:
    scene = _read(source)
    order = morton_order(scene.means)
    theirs, ours = work / "theirs.compressed.ply", work / "ours.compressed.ply"
    _transform(folder, source, theirs)
    _transform(folder, theirs, work / "theirs.ply")
    _say("read", _steps(_read(theirs), load_ply(work / "theirs.ply"), _chunk_steps(_read(theirs))))
    save(scene, ours)
    _transform(folder, ours, work / "ours.ply")
    _say("written", _steps(scene.take(order), load_ply(work / "ours.ply"), _chunk_steps(_read(ours))))
    a, b = (np.frombuffer(p.read_bytes().split(b"end_header\n", 1)[1], np.uint8) for p in (ours, theirs))
    print(f"  bytes    {int((a != b).sum()) if len(a) == len(b) else 'all'} of {len(a)} differ")


def _ksplat(folder: Path, source: Path, work: Path) -> None:
    degree = min(load_ply(source).sh_degree, 2)
    rest = (0, 9, 24)[degree]
    for level in (0, 1, 2):
        target = work / f"{level}.ksplat"
        command = [
            "node",
            "--no-deprecation",
            str(folder / "peers.mjs"),
            str(source),
            str(target),
            str(level),
            str(degree),
        ]
        subprocess.run(command, check=True, cwd=folder)
        ours = _read(target)
        raw = np.fromfile(f"{target}.f32", np.float32).reshape(len(ours), 14 + rest)
        sh = np.empty((len(ours), 1 + rest // 3, 3), np.float32)
        sh[:, 0] = (raw[:, 10:13] / 255 - 0.5) / 0.28209479177387814
        sh[:, 1:] = raw[:, 14:].reshape(len(ours), -1, 3)
        theirs = Splats(raw[:, :3], raw[:, 6:10], raw[:, 3:6], raw[:, 13] / 255, sh)
        steps = _ksplat_steps(theirs, level)
        _say(f"ksplat {level}", _steps(ours, theirs, steps))
        _transform(folder, target, work / "k.ply")
        _say("  and", _steps(ours, load_ply(work / "k.ply"), steps))


def _chunk_steps(splats: Splats) -> dict[str, NDArray[np.float64]]:
    """Steps of a compressed PLY: the least and greatest of a chunk are always there."""
    starts = np.arange(0, len(splats), 256)
    chunk = np.arange(len(splats)) // 256
    out = {}
    for name, values, parts in (
        ("means", splats.means, [2047, 1023, 2047]),
        ("scales", np.log(splats.scales.astype(float)), [2047, 1023, 2047]),
        ("colours", splats.sh[:, 0], [255, 255, 255]),
    ):
        extent = np.maximum.reduceat(values, starts).astype(float) - np.minimum.reduceat(values, starts)
        out[name] = np.maximum(extent[chunk] / parts, 1e-6)
    return out | {"quats": np.array(2**0.5 / 1023), "opacities": np.array(1 / 255), "sh": np.array(1 / 32)}


def _ksplat_steps(splats: Splats, level: int) -> dict[str, NDArray[np.float64]]:
    """Steps of a KSPLAT in blocks of 5 m; of level 0 those of float32."""
    bits = -23 if level == 0 else -10
    rest = splats.sh[:, 1:]
    coarse = (rest.max(initial=0) - rest.min(initial=0)) / 255 if level == 2 else 2.0**bits
    means = np.array(2.5 / 32767) if level else np.maximum(np.abs(splats.means).astype(float), 1) * 2.0**bits
    out = {"means": means, "scales": np.array(2.0**bits), "quats": np.array(2.0**bits)}
    return out | {"colours": np.array(1 / 255), "opacities": np.array(1 / 255), "sh": np.array(max(coarse, 1e-9))}


def _steps(a: Splats, b: Splats, steps: dict[str, NDArray[np.float64]]) -> dict[str, float]:
    """Largest difference of each attribute, in steps."""
    sign = np.sign((a.quats * b.quats).sum(axis=1, keepdims=True))
    with np.errstate(divide="ignore"):
        pairs = {
            "means": (a.means, b.means),
            "scales": (np.log(a.scales.astype(float)), np.log(b.scales.astype(float))),
            "quats": (a.quats, b.quats * sign),
            "opacities": (a.opacities, b.opacities),
            "colours": (a.sh[:, 0], b.sh[:, 0]),
            "sh": (a.sh[:, 1:], b.sh[:, 1:]),
        }
    return {
        name: float((np.abs(one.astype(float) - other) / steps[name]).max(initial=0))
        for name, (one, other) in pairs.items()
    }


def _say(what: str, found: dict[str, float]) -> None:
    print(f"  {what:8} " + ", ".join(f"{name} {value:.3g}" for name, value in found.items()), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), [Path(name).resolve() for name in sys.argv[2:]])
