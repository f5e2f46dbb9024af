""".splat: 32 bytes a splat, no magic."""

from __future__ import annotations

import io
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats import load_ply, load_splat, losses, save_splat
from glsplat.formats.splat import looks_like_splat, read_splat
from glsplat.splats import SH_C0
from tests.formats.scenes import awkward_splats, random_splats
from tests.golden.stored import DATA


def test_what_cannot_be_kept_is_said() -> None:
    base = random_splats(5)
    scales, sh = base.scales.copy(), np.zeros((5, 1, 3), np.float32)
    scales[1, 0] *= -1
    sh[2:4, 0, 1] = 0.51 / SH_C0  # 1.01
    sh[4] = -3  # below 0 it is drawn as 0
    assert list(losses(replace(base, scales=scales, sh=sh), "a.splat")) == [
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


def test_round_trip_to_the_precision_of_the_format(tmp_path: Path) -> None:
    splats = random_splats(70_000)
    save_splat(splats, tmp_path / "a.splat")
    again = load_splat(tmp_path / "a.splat")
    np.testing.assert_array_equal(again.means, splats.means)
    np.testing.assert_array_equal(again.scales, splats.scales)
    np.testing.assert_allclose(again.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    rgb = np.clip(splats.sh[:, 0] * SH_C0 + 0.5, 0, 1)
    np.testing.assert_allclose(again.sh[:, 0] * SH_C0 + 0.5, rgb, atol=0.5 / 255 + 1e-6)
    assert np.abs((again.quats * splats.quats).sum(axis=1)).min() > 0.9998  # 2 degrees


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


def test_real_files_look_like_splats() -> None:
    for name in ("demosthenes_10k.splat", "minimal.splat"):
        assert looks_like_splat((DATA / name).read_bytes())
        assert load_splat(DATA / name).finite().all()


@pytest.mark.shared
def test_another_real_file_looks_like_splats(shared_data: Path) -> None:
    path = shared_data / "splats" / "spot_10k.splat"
    assert looks_like_splat(path.read_bytes()) and load_splat(path).finite().all()
