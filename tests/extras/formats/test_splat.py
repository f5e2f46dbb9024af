""".splat: 32 bytes a splat, no magic."""

from __future__ import annotations

import io
import struct
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glsplat.errors import FormatError
from glsplat.extras.formats.splat import looks_like_splat, read_splat, save_splat
from glsplat.formats import load, losses, recognise, save
from glsplat.splats import SH_C0, Splats
from tests.formats.scenes import assert_equal, awkward_splats, load_ply, load_splat, random_splats
from tests.golden.stored import DATA


def test_what_cannot_be_kept_is_said() -> None:
    base = random_splats(5)
    scales, sh = base.scales.copy(), np.zeros((5, 1, 3), np.float32)
    scales[1, 0] *= -1
    sh[2:4, 0, 1] = 0.51 / SH_C0  # 1.01
    sh[4] = -3  # below 0 it is drawn as 0
    assert list(losses(replace(base, scales=scales, sh=sh, antialias=True), "a.splat"))[1:] == [
        "1 splats with negative scales are written with positive ones (their shape is the same)",
        "2 splats have colours above 1, which are clamped",
    ]


def test_one_splat_byte_by_byte(tmp_path: Path) -> None:
    record = struct.pack("<6f8B", 1, 2, 3, 0.5, 0.25, 0.125, 255, 0, 51, 102, 128, 128 + 127, 128, 128)
    (tmp_path / "a.splat").write_bytes(record)
    splats = load_splat(tmp_path / "a.splat")
    assert splats.means.tolist() == [[1, 2, 3]] and splats.scales.tolist() == [[0.5, 0.25, 0.125]]
    np.testing.assert_allclose(splats.sh[0, 0] * SH_C0 + 0.5, [1, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(splats.opacities, [0.4])
    assert splats.quats.tolist() == [[0, 1, 0, 0]]
    save_splat(splats, tmp_path / "b.splat")
    again = (tmp_path / "b.splat").read_bytes()
    assert again[:28] == record[:28] and again[29] == 255  # a quaternion of length 1 is clamped to 255


def test_degree_is_dropped_and_awkward_values_do_not_wrap(tmp_path: Path) -> None:
    save_splat(awkward_splats(), tmp_path / "a.splat")
    again = load_splat(tmp_path / "a.splat")
    assert again.sh_degree == 0
    assert np.isnan(again.means[0, 1]) and again.opacities[7] == 0 and again.opacities[8] == 1
    assert not again.quats[2].any()
    with pytest.raises(FormatError, match="3 of 10 splats"):
        load_splat(tmp_path / "a.splat", strict=True)


def test_size(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(33))
    with pytest.raises(FormatError, match="32 bytes a splat, but this one has 33"):
        load_splat(tmp_path / "a.splat")
    (tmp_path / "a.splat").write_bytes(b"")
    assert len(load_splat(tmp_path / "a.splat")) == 0


def test_a_file_that_becomes_shorter_while_it_is_read(tmp_path: Path) -> None:
    class Shrinking(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            data = super().read(size)
            self.truncate(32)
            return data

    save_splat(random_splats(3, 0), tmp_path / "a.splat")
    with pytest.raises(FormatError, match="became shorter"):
        read_splat(Shrinking((tmp_path / "a.splat").read_bytes()), 96)


def test_random_bytes_do_not_look_like_splats(rng: np.random.Generator) -> None:
    taken = sum(looks_like_splat(rng.bytes(32 * count)) for count in (1, 2, 3, 5, 100) for _ in range(200))
    assert taken <= 10  # one random record in a hundred passes; two never do
    for text in (bytes(64), b"a text of just the right size!!\n" * 4, b" " * 320, b"0.25 1 2 3 0.1 7\n" * 320):
        assert not looks_like_splat(text)
    assert not any(looks_like_splat(rng.bytes(32 * 1000)) for _ in range(20))


def test_real_file_agrees_with_its_ply() -> None:
    a = load_splat(DATA / "demosthenes_10k.splat")
    b = load_ply(DATA / "demosthenes_10k.ply")
    assert len(a) == len(b) == 10_000
    order_a, order_b = (np.lexsort(s.means.T) for s in (a, b))  # the converter reordered them
    a, b = a.take(order_a), b.take(order_b)
    np.testing.assert_allclose(a.means, b.means, atol=1e-6)
    np.testing.assert_allclose(a.scales, b.scales, rtol=2e-6)
    np.testing.assert_allclose(a.opacities, b.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(a.sh, b.sh, atol=0.5 / 255 / SH_C0 + 1e-5)
    # that converter reads a byte as (b - 127.5) / 127.5, so the rotations differ by half a step
    assert np.abs((a.quats * b.quats).sum(axis=1)).min() > 0.9999


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
    assert_equal(load(memory, format="splat"), again)  # type: ignore[arg-type]
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
