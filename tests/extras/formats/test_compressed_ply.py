"""Compressed PLY: words packed by hand, the format's own rounding, and headers that lie."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.formats.packed import morton_order
from glsplat.formats import load, losses, recognise, save
from glsplat.splats import Splats
from tests.formats.scenes import FIELDS, assert_equal, awkward_splats, load_ply, random_splats
from tests.formats.test_contract import refused

C0 = 0.28209479177387814
POSITION = [f"{end}_{name}" for end in ("min", "max") for name in "xyz"]
SCALE = [f"{end}_scale_{name}" for end in ("min", "max") for name in "xyz"]
COLOUR = [f"{end}_{name}" for end in ("min", "max") for name in "rgb"]
WORDS = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]


def header(chunks: int, splats: int, bounds: list[str] | None = None, rest: int = 0, form: str = "little") -> bytes:
    names = [*POSITION, *SCALE, *COLOUR] if bounds is None else bounds
    lines = ["ply", f"format binary_{form}_endian 1.0", "comment made by a test", f"element chunk {chunks}"]
    lines += [f"property float {name}" for name in names]
    lines += [f"element vertex {splats}", *(f"property uint {name}" for name in WORDS)]
    lines += [f"element sh {splats}", *(f"property uchar f_rest_{i}" for i in range(rest))] if rest else []
    return "\n".join([*lines, "end_header", ""]).encode()


# positions are their codes, logarithms of scales too; colours are their codes
BOUNDS = [0, 0, 0, 2047, 1023, 2047, -2047, -1023, -2047, 0, 0, 0, 0, 0, 0, 255, 255, 255]
FIRST = [
    5 << 21 | 7 << 11 | 9,
    2 << 30 | 1023 << 20 | 0 << 10 | 256,  # y is the largest; w and x are at their ends
    2047 << 21 | 1022 << 11 | 2045,
    0 << 24 | 128 << 16 | 255 << 8 | 51,
]
SECOND = [
    2047 << 21 | 1023 << 11 | 0,
    0 << 30 | 512 << 20 | 256 << 10 | 768,
    2046 << 21 | 1021 << 11 | 2044,
    1 << 24 | 2 << 16 | 3 << 8 | 255,
]


def by_hand(bounds: list[float] = BOUNDS, rest: bytes = b"", order: str = "<") -> bytes:
    names = [*POSITION, *SCALE, *COLOUR][: len(bounds)]
    form = {"<": "little", ">": "big"}[order]
    head = header(1, 2, names, len(rest) // 2, form)
    return head + np.array(bounds, order + "f4").tobytes() + np.array([*FIRST, *SECOND], order + "u4").tobytes() + rest


def read(tmp_path: Path, data: bytes) -> Splats:
    (tmp_path / "a").write_bytes(data)
    scene = load(tmp_path / "a")
    assert isinstance(scene, Splats)
    return scene


@pytest.mark.parametrize("order", ["<", ">"])
def test_words_packed_by_hand(tmp_path: Path, order: str) -> None:
    splats = read(tmp_path, by_hand(order=order))
    np.testing.assert_allclose(splats.means, [[5, 7, 9], [2047, 1023, 0]], atol=2e-4)
    np.testing.assert_allclose(np.log(splats.scales), [[0, -1, -2], [-1, -2, -3]], atol=1e-5)
    np.testing.assert_allclose(splats.sh[:, 0] * C0 + 0.5, [[0, 128, 255], [1, 2, 3]], atol=2e-5)
    np.testing.assert_allclose(splats.opacities, [51 / 255, 1])
    # (1023 / 1023 - 1/2) sqrt 2 = 0.7071; (256 / 1023 - 1/2) sqrt 2 = -0.3532: these two and -0.7071 exceed length 1
    first = np.array([0.70710678, -0.70710678, 0, -0.35320760])
    # (512, 256, 768) / 1023 - 1/2 times sqrt 2; w = sqrt(1 - 0.00069^2 - 0.35321^2 - 0.35459^2)
    second = np.array([0.86574222, 0.00069121, -0.35320760, 0.35459002])
    np.testing.assert_allclose(splats.quats[0], first / np.linalg.norm(first), atol=1e-6)
    np.testing.assert_allclose(splats.quats[1], second, atol=1e-6)
    assert recognise(tmp_path / "a") == "compressed-ply" and not splats.antialias


def test_each_component_can_be_the_largest(tmp_path: Path) -> None:
    others = [(code / 1023 - 0.5) * 2**0.5 for code in (700, 300, 600)]  # 0.26, -0.29, 0.12
    largest = (1 - sum(value**2 for value in others)) ** 0.5
    for which in range(4):
        word = which << 30 | 700 << 20 | 300 << 10 | 600
        words = np.array([*FIRST[:1], word, *FIRST[2:], *SECOND], "<u4").tobytes()
        splats = read(tmp_path, header(1, 2) + np.array(BOUNDS, "<f4").tobytes() + words)
        expected = [*others[:which], largest, *others[which:]]
        np.testing.assert_allclose(splats.quats[0], expected, atol=1e-6)
        save(splats.take([0]), tmp_path / "b.compressed.ply")
        assert (tmp_path / "b.compressed.ply").read_bytes()[-12:-8] == word.to_bytes(4, "little")


def test_without_bounds_colours_lie_in_0_to_1(tmp_path: Path) -> None:
    splats = read(tmp_path, by_hand(BOUNDS[:12]))
    np.testing.assert_allclose(splats.sh[:, 0] * C0 + 0.5, np.array([[0, 128, 255], [1, 2, 3]]) / 255, atol=1e-6)
    np.testing.assert_allclose(splats.means, [[5, 7, 9], [2047, 1023, 0]], atol=2e-4)


def test_harmonics_are_channel_major_bytes(tmp_path: Path) -> None:
    codes = [0, 255, 128, 127, 1, 254, 64, 192, 129], [128] * 9
    splats = read(tmp_path, by_hand(rest=bytes([*codes[0], *codes[1]])))
    assert splats.sh_degree == 1
    np.testing.assert_array_equal(splats.sh[0, 1:, 0], [-4, 4, 1 / 64])  # red
    np.testing.assert_array_equal(splats.sh[0, 1:, 1], [-1 / 64, -4 + 3 / 64, 4 - 3 / 64])
    np.testing.assert_array_equal(splats.sh[0, 1:, 2], [-2 + 1 / 64, 2 + 1 / 64, 3 / 64])
    np.testing.assert_array_equal(splats.sh[1, 1:], 1 / 64)


def test_elements_and_properties_in_another_order_and_more_of_them(tmp_path: Path) -> None:
    expected = read(tmp_path, by_hand(rest=bytes(range(18))))
    lines = ["ply", "format binary_little_endian 1.0", "element camera 1", "property double fov", "element sh 2"]
    lines += [*(f"property uchar f_rest_{i}" for i in reversed(range(9))), "property uchar more", "element vertex 2"]
    lines += [*(f"property uint {name}" for name in reversed(WORDS)), "property float more"]
    lines += ["element chunk 2", "property float more"]
    lines += [f"property float {name}" for name in reversed([*POSITION, *SCALE, *COLOUR])]
    data = "\n".join([*lines, "end_header", ""]).encode() + bytes(8)
    data += bytes([*reversed(range(9)), 7, *reversed(range(9, 18)), 7])
    for words in (FIRST, SECOND):
        data += np.array(words[::-1], "<u4").tobytes() + bytes(4)
    data += np.array([9, *BOUNDS[::-1]], "<f4").tobytes() + bytes(4 * 19)
    names = [*POSITION, *SCALE, *COLOUR]
    assert len(names) == len(BOUNDS)
    assert_equal(read(tmp_path, data), expected)


def test_the_same_signs_and_channels_as_a_plain_ply(tmp_path: Path) -> None:
    splats = random_splats(300, 3)
    save(splats, tmp_path / "a.ply")
    save(splats, tmp_path / "a.compressed.ply")
    plain, packed = load(tmp_path / "a.ply"), load(tmp_path / "a.compressed.ply")
    np.testing.assert_allclose(packed.sh[:, 1:], plain.sh[morton_order(plain.means), 1:], atol=1 / 64 + 1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 255, 256, 257, 33_000])
def test_round_trip_within_half_a_step(tmp_path: Path, degree: int, count: int) -> None:
    if degree and count > 300:
        count = 600
    splats = replace(random_splats(count, degree), antialias=degree == 1)
    path = tmp_path / "a.compressed.ply"
    save(splats, path)
    again = load(path)
    assert (len(again), again.sh_degree, again.antialias) == (count, degree, splats.antialias)
    rest = 3 * ((degree + 1) ** 2 - 1)
    body = path.read_bytes().split(b"end_header\n", 1)[1]
    assert len(body) == 72 * -(-count // 256) + (16 + rest) * count  # bytes a splat: 16 + 72 / 256 + rest
    moved = splats.take(morton_order(splats.means))
    chunk = np.arange(count) // 256
    starts = np.arange(0, count, 256)
    for name, old, new in (("means", moved.means, again.means), ("scales", np.log(moved.scales), np.log(again.scales))):
        extent = np.maximum.reduceat(old, starts) - np.minimum.reduceat(old, starts)
        error = np.abs(old - new) / (extent[chunk] / [2047, 1023, 2047] + 1e-9)
        assert error.max() < 0.502, name
        assert count == 1 or error.max() > 0.4, name  # as the format rounds, not finer
    colour = moved.sh[:, 0] * C0 + 0.5
    extent = np.maximum.reduceat(colour, starts) - np.minimum.reduceat(colour, starts)
    assert (np.abs(colour - again.sh[:, 0] * C0 - 0.5) <= extent[chunk] / 255 * 0.501 + 1e-6).all()
    np.testing.assert_allclose(again.opacities, moved.opacities, atol=0.5 / 255 + 1e-6)
    # three components are off by d = sqrt(2) / 2046 at most; the quaternion, whose largest is 1/2 at least, by
    # sqrt(3) d / (1/2) = 0.0024
    old, new = moved.quats.astype(float), again.quats.astype(float)
    new *= np.sign((old * new).sum(axis=1))[:, None]
    assert (np.linalg.norm(old - new, axis=1) < 0.0024).all()
    smaller = np.abs(old) < np.abs(old).max(axis=1, keepdims=True)
    assert np.abs(old - new)[smaller].max() < 2**0.5 / 2046 + 1e-6
    assert degree == 0 or np.abs(again.sh[:, 1:] - moved.sh[:, 1:]).max() <= 1 / 64 + 1e-6


def test_equal_positions_and_wide_chunks(tmp_path: Path) -> None:
    base = random_splats(600)
    means = np.zeros((600, 3), np.float32)
    means[:, 0] = 3.0
    splats = Splats(means, base.quats, base.scales, base.opacities, base.sh)
    save(splats, tmp_path / "a.compressed.ply")
    again = load(tmp_path / "a.compressed.ply")
    np.testing.assert_array_equal(again.means, means)
    means[::2, 1] = np.float32(3e38)
    means[1::2, 1] = -np.float32(3e38)
    save(Splats(means, base.quats, base.scales, base.opacities, base.sh), tmp_path / "a.compressed.ply")
    wide = load(tmp_path / "a.compressed.ply")
    assert isinstance(wide, Splats) and np.isfinite(wide.means).all()
    assert (np.sort(wide.means[:, 1]) == np.sort(means[:, 1])).all()


def test_what_is_never_drawn_is_left_out_and_said(tmp_path: Path) -> None:
    splats = awkward_splats()
    save(splats, tmp_path / "a.compressed.ply")
    again = load(tmp_path / "a.compressed.ply", strict=True)
    assert isinstance(again, Splats) and len(again) == 4  # splats 4, 5, 7 and 8 of 10
    kept = splats.take([4, 5, 7, 8])
    kept = kept.take(morton_order(kept.means))
    np.testing.assert_array_equal(again.opacities == 0, kept.opacities == 0)
    np.testing.assert_allclose(np.log(again.scales), np.log(np.maximum(np.abs(kept.scales), np.exp(-20))), atol=0.02)
    said = list(losses(splats, "a.compressed.ply"))
    assert said[0] == "6 splats with NaN, infinity or a zero quaternion, never drawn, are left out"
    assert any(line.startswith("1 splats with negative scales") for line in said)
    assert "1 splats with scales below 2e-9 m become that thick" in said


def test_each_kind_of_ply_is_known_by_its_header(tmp_path: Path) -> None:
    save(random_splats(), tmp_path / "a.compressed.ply")
    (tmp_path / "a.compressed.ply").rename(tmp_path / "b.ply")
    assert recognise(tmp_path / "b.ply") == "compressed-ply" and len(load(tmp_path / "b.ply")) == 50  # type: ignore[arg-type]
    with pytest.raises(FormatError, match=r"compressed PLY \(packed_position\), another format; glsplat.load reads it"):
        load_ply(tmp_path / "b.ply")
    save(random_splats(), tmp_path / "c.compressed.ply", format="ply")
    assert recognise(tmp_path / "c.compressed.ply") == "ply"
    data = (tmp_path / "b.ply").read_bytes()
    commented = data.replace(b"element chunk", b"comment " + b"x" * 900 + b"\nelement chunk")
    (tmp_path / "d.ply").write_bytes(commented.replace(b"\n", b"\r\n", 60))
    assert recognise(tmp_path / "d.ply") == "compressed-ply"
    plain = (tmp_path / "c.compressed.ply").read_bytes()
    said = b"comment property uint packed_position\nelement vertex"
    (tmp_path / "e.ply").write_bytes(plain.replace(b"element vertex", said))
    assert recognise(tmp_path / "e.ply") == "ply"


GOOD = by_hand(rest=bytes(18))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (GOOD[:-1], r"truncated: the header declares \d+ bytes, the file has \d+"),
        (GOOD + bytes(16), r"the header declares \d+ bytes, but the file has \d+"),
        (GOOD.replace(b"binary_little_endian", b"ascii"), "is binary, but the header of this one says ASCII"),
        (GOOD.replace(b"element chunk 1", b"element chank 1"), "needs the elements chunk and vertex"),
        (GOOD.replace(b"element vertex 2", b"element vertax 2"), "needs the elements chunk and vertex"),
        (GOOD.replace(b"float min_scale_y", b"float min_scale_q"), "need a property float min_scale_y"),
        (GOOD.replace(b"float max_g", b"float max_q"), "need a property float max_g"),
        (GOOD.replace(b"float max_x", b"uint max_x"), "need a property float max_x"),
        (GOOD.replace(b"uint packed_scale", b"uint packed_skale"), "need a property uint packed_scale"),
        (GOOD.replace(b"uint packed_position", b"ushort packed_position"), "need a property uint packed_position"),
        (GOOD.replace(b"vertex 2", b"vertex 257"), "257 splats need 2 chunks, found 1"),
        (GOOD.replace(b"vertex 2", b"vertex 999999999999999999"), "splats need 3906250000000000 chunks, found 1"),
        (GOOD.replace(b"chunk 1", b"chunk 999999999999999999"), "truncated"),
        (GOOD.replace(b"chunk 1", b"chunk 0"), "2 splats need 1 chunks, found 0"),
        (GOOD.replace(b"element sh 2", b"element sh 1"), "the element sh has 1 rows for 2 splats"),
        (GOOD.replace(b"uchar f_rest_3", b"float f_rest_3"), "properties of type uchar alone"),
        (GOOD.replace(b"f_rest_8", b"f_rest_9"), "needs 0, 9, 24 or 45 properties"),
        (GOOD.replace(b"uchar f_rest_8", b"list uchar int f_rest_8"), "the element 'sh' has a list property"),
    ],
)  # fmt: skip
def test_refuses(tmp_path: Path, data: bytes, message: str) -> None:
    refused(tmp_path / "a.ply", data, message)


def test_bounds_that_are_not_finite_are_kept(tmp_path: Path) -> None:
    bounds = [np.nan, -np.inf, 0, 1, 1, np.inf, 0, 0, 0, 900, 1, 1, 0, 0, 0, 1, 1, 1]
    splats = read(tmp_path, by_hand(bounds))
    assert not np.isfinite(splats.means).any() and np.isinf(splats.scales[:, 0]).all()
    with pytest.raises(FormatError, match="2 of 2 splats hold NaN or infinity"):
        load(tmp_path / "a", strict=True)


def test_morton_order_by_hand() -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    order = morton_order(corners)
    assert [tuple(corner) for corner in corners[order].astype(int)] == [
        (0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1), (1, 1, 1)
    ]  # fmt: skip
    flat = np.zeros((5, 3), np.float32)
    flat[:, 1] = (3, 1, 2, 1, 0)
    assert morton_order(flat).tolist() == [4, 1, 3, 2, 0]  # equal ones stay as they came
    places = np.zeros((400, 3), np.float32)
    places[:, 2] = np.random.default_rng(3).integers(0, 20, 400)
    order = morton_order(places)
    assert np.array_equal(order, np.argsort(places[:, 2], kind="stable"))
    assert morton_order(flat[:0]).tolist() == [] and morton_order(flat[:1]).tolist() == [0]


REAL = [
    ("means", 0, [-0.1045368, -2.3878982, -0.360811]),
    ("means", 77_777, [-0.1942245, -2.8126192, 0.0420555]),
    ("quats", 77_777, [0.9071567, -0.2757924, 0.2052891, 0.2426143]),
    ("quats", 152_745, [0.9981917, 0.04078133, -0.04216375, 0.01313297]),
    ("scales", 0, [0.002313678, 0.01489779, 0.0008667605]),
    ("opacities", 152_745, 0.05490196),
    ("sh", 0, [[0.5478685, 0.5222843, 0.5681518]]),
    ("sh", 77_777, [[-1.042393, -1.601362, -1.719296]]),
]


@pytest.mark.shared
def test_a_real_file(shared_data: Path) -> None:
    path = shared_data / "real" / "splats" / "biker.compressed.ply"
    splats = load(path, strict=True)
    assert isinstance(splats, Splats) and (len(splats), splats.sh_degree) == (152_746, 0)
    # what splat-transform 2.7.1 reads
    for name, index, expected in REAL:
        np.testing.assert_allclose(getattr(splats, name)[index], expected, rtol=2e-6, atol=1e-6, err_msg=name)
    assert all(np.isfinite(getattr(splats, name)).all() for name in FIELDS)


def test_a_crowd_in_one_cell_is_ordered_too() -> None:
    rng = np.random.default_rng(4)
    crowd = np.zeros((1001, 3), np.float32)
    crowd[:1000, 0] = rng.permutation(1000) * np.float32(1e-6)
    crowd[1000] = 5  # all others are in one cell of its grid
    order = morton_order(crowd)
    assert sorted(order) == list(range(1001)) and order[-1] == 1000
    assert (np.diff(crowd[order[:1000], 0]) > 0).all()


def test_harmonics_and_opacities_out_of_range_are_clamped(tmp_path: Path) -> None:
    base = random_splats(5, 1)
    sh, opacities = base.sh.copy(), base.opacities.copy()
    sh[0, 0, 0], sh[1, 2, 1], sh[2, 3, 2], opacities[3] = 9, -4.5, 4.0, 1.5
    save(Splats(base.means, base.quats, base.scales, opacities, sh), tmp_path / "a.compressed.ply")
    again = load(tmp_path / "a.compressed.ply")
    assert isinstance(again, Splats) and again.opacities.max() == 1
    assert (again.sh[:, 1:].min(), again.sh[:, 1:].max()) == (-4, 4)
    assert np.isclose(again.sh[:, 0].max(), 9)  # degree 0 has bounds
