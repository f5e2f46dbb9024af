"""Files of two gigabytes of nothing, and .splat files, which have no mark: what is read of them, and what is not."""

from __future__ import annotations

import io
import os
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glsplat.errors import FormatError
from glsplat.formats import load, recognise, save
from glsplat.splats import Splats
from tests.api.test_files import run, same
from tests.formats.scenes import random_splats

# ---------------------------------------------------------------------------------------------------------- holes


def ply_header(kind: str, count: int) -> bytes:
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    lines = ["ply", f"format {kind} 1.0", f"element vertex {count}", *(f"property float {name}" for name in names)]
    return "\n".join([*lines, "end_header", ""]).encode()


def glb_head(length: int, json: bytes, declared: int | None = None) -> bytes:
    text = json + b" " * (-len(json) % 4)
    size = len(text) if declared is None else declared
    return struct.pack("<IIIII", 0x46546C67, 2, length, size, 0x4E4F534A) + text


SIZE = 2 << 30
RECORD = struct.pack("<6f8B", 1, 2, 3, 0.5, 0.25, 0.125, 255, 0, 51, 102, 255, 128, 128, 128)
HOLES = {
    "nothing.ply": b"",
    "nothing.splat": b"",
    "nothing.glb": b"",
    "nothing.gltf": b"",
    "head.splat": RECORD * 40_000,
    "ascii.ply": ply_header("ascii", 10),
    "rows.ply": ply_header("ascii", 2) + b"0 0 0 1 1 1 1 1 1 1 1 0 0 0\n",
    "behind.ply": ply_header("ascii", 1) + b"0 0 0 1 1 1 1 1 1 1 1 0 0 0\n",
    "few.ply": ply_header("binary_little_endian", 100),
    "json.glb": glb_head(SIZE, b"", SIZE - 20),
    "bin.glb": glb_head(SIZE, b'{"asset":{"version":"2.0"}}'),
    "short.glb": glb_head(SIZE + 4, b'{"asset":{"version":"2.0"}}'),
    "brace.gltf": b'{"asset": {"version": "2.0"},\n',
}


@pytest.mark.parametrize("name", HOLES)
def test_a_file_of_two_gigabytes_of_nothing_is_refused_without_reading_it(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(HOLES[name])
    os.truncate(path, SIZE)
    assert path.stat().st_blocks * 512 < 16 << 20  # a hole indeed
    script = (
        "import resource, sys, glsplat, glsplat.formats as formats\n"
        "def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10\n"
        "def taken(): return int(open('/proc/self/io').readline().split()[1]) >> 20\n"  # by read(2)
        "before, start = peak(), taken()\n"
        "for source in (sys.argv[1], open(sys.argv[1], 'rb')):\n"
        "    for reader in (glsplat.load, *([formats.load_splat] if '.splat' in sys.argv[1] else ())):\n"
        "        if not isinstance(source, str): source.seek(0)\n"
        "        try: reader(source); print('loaded')\n"
        "        except glsplat.GlsplatError as error: assert chr(10) not in str(error)\n"
        "print(peak() - before, taken() - start)\n"
    )
    done = run(script, path)
    assert done.returncode == 0, done.stderr
    kept, read = map(int, done.stdout.split())  # MiB
    assert kept < 64 and read < 64


def test_of_a_large_buffer_only_what_is_wanted_is_read(tmp_path: Path) -> None:
    """A good GLB with 2 GB of hole behind its data, and a .gltf with such a buffer beside it."""
    save(random_splats(50), tmp_path / "a.glb")
    data = bytearray((tmp_path / "a.glb").read_bytes())
    (length,) = struct.unpack_from("<I", data, 12)
    big = SIZE - (SIZE % 4)
    struct.pack_into("<I", data, 8, big)
    struct.pack_into("<I", data, 20 + length, big - 28 - length)
    (tmp_path / "b.glb").write_bytes(data)
    os.truncate(tmp_path / "b.glb", big)
    text = bytes(data[20 : 20 + length]).replace(b'"buffers":[{', b'"buffers":[{"uri":"c.bin",')
    (tmp_path / "c.gltf").write_bytes(text)
    (tmp_path / "c.bin").write_bytes(data[28 + length :])
    os.truncate(tmp_path / "c.bin", big)
    script = (
        "import resource, sys, glsplat\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "assert all(len(glsplat.load(path)) == 50 for path in sys.argv[1:])\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before >> 10)\n"
    )
    done = run(script, tmp_path / "b.glb", tmp_path / "c.gltf")
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 64
    same(load(tmp_path / "b.glb"), load(tmp_path / "a.glb"))


# --------------------------------------------------------------------------------------------------------- .splat


def flat(count: int, **change: Any) -> Splats:
    parts: dict[str, Any] = {
        "means": np.zeros((count, 3)),
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "scales": np.zeros((count, 3)),
        "opacities": np.ones(count),
        "rgb": np.full((count, 3), 0.5),
    }
    if "sh" in change:
        del parts["rgb"]
    return Splats.create(**(parts | change))


AWKWARD = {
    "none": flat(0),
    "points": flat(4),
    "one point": flat(1),
    "black points": flat(9, opacities=np.zeros(9), rgb=np.zeros((9, 3))),
    "flat": flat(7, scales=np.tile([0.1, 0.2, 0.0], (7, 1))),
    "negative": flat(5, scales=np.full((5, 3), -0.1)),
    "not finite": flat(3, means=np.full((3, 3), np.nan), scales=np.full((3, 3), np.inf)),
    "no rotation": flat(3, quats=np.zeros((3, 4))),
    "turned back": flat(2, quats=np.full((2, 4), -0.5), opacities=[0.3, 0.3], rgb=np.full((2, 3), 0.2)),
    "far": flat(2, means=np.full((2, 3), 1e30), scales=np.full((2, 3), 1e20)),
}


@pytest.mark.parametrize("name", AWKWARD)
def test_what_save_writes_as_splat_load_reads(tmp_path: Path, name: str) -> None:
    splats = AWKWARD[name]
    save(splats, tmp_path / "a.splat")
    assert recognise(tmp_path / "a.splat") == "splat"
    again = load(tmp_path / "a.splat")
    memory = io.BytesIO()
    save(splats, memory, format="splat")
    memory.seek(0)
    assert isinstance(again, Splats)
    same(load(memory, format="splat"), again)
    np.testing.assert_array_equal(again.means, splats.means)
    np.testing.assert_array_equal(again.scales, np.abs(splats.scales))
    np.testing.assert_allclose(again.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    dots = np.abs((again.quats * splats.quats).sum(axis=1))
    assert (dots > 0.9998).all() or name == "no rotation"


floats = st.floats(width=32)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 5).flatmap(lambda n: hnp.arrays(np.float32, (n, 14), elements=floats)))
def test_any_splats_come_back_from_a_splat_file(values: np.ndarray) -> None:
    with np.errstate(all="ignore"):
        splats = flat(
            len(values), means=values[:, :3], quats=values[:, 3:7], scales=values[:, 7:10], sh=values[:, None, 10:13],
            opacities=values[:, 13],
        )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.splat"
        save(splats, path)
        again = load(path)
    assert isinstance(again, Splats)
    np.testing.assert_array_equal(again.means, splats.means)
    np.testing.assert_array_equal(again.scales, np.abs(splats.scales))


@pytest.mark.parametrize("start", [b"{", b" {", b"PK", b"PK\x03\x04", b"\x1f\x8b", b"NGSP", b"\xef\xbb\xbf{"])
@pytest.mark.parametrize("name", ["a.splat", "a.bin"])
def test_a_first_number_that_looks_like_a_mark_does_not_mislead(tmp_path: Path, start: bytes, name: str) -> None:
    """One file in 256 begins with the byte of a brace."""
    splats = random_splats(40)
    means = splats.means.copy()
    means[0, 0] = np.frombuffer(start.ljust(4, b"\x41")[:4], "<f4")[0]
    splats = Splats(means, splats.quats, splats.scales, splats.opacities, splats.sh)
    save(splats, tmp_path / name, format="splat")
    assert recognise(tmp_path / name) == "splat"
    assert load(tmp_path / name).means[0, 0] == means[0, 0]  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "content",
    [
        b"\x89PNG\r\n\x1a\n" + np.random.default_rng(1).bytes(32 * 50 - 8),
        b"\x1f\x8b\x08" + np.random.default_rng(2).bytes(32 * 50 - 3),
        b"a text of just the right size!!\n" * 20,
        bytes(320),
        bytes(33),
    ],
)
def test_the_name_alone_does_not_make_a_splat_file(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.splat").write_bytes(content)
    with pytest.raises(FormatError):
        load(tmp_path / "a.splat")
