"""3DGS PLY: every layout the format allows, and every way a file can lie about itself."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats.ply import read_ply, save_ply
from glsplat.splats import Splats
from tests.formats.scenes import FIELDS, awkward_splats, load_ply, random_splats
from tests.formats.test_contract import refused
from tests.golden.stored import DATA

BASE = [
    *"xyz",
    *(f"f_dc_{i}" for i in range(3)),
    "opacity",
    *(f"scale_{i}" for i in range(3)),
    *(f"rot_{i}" for i in range(4)),
]


def columns(splats: Splats) -> dict[str, np.ndarray]:
    """The stored (not activated) values by property name, written out independently of the code under test."""
    out = dict(zip("xyz", splats.means.T.astype(float), strict=True))
    for i in range(3):
        out[f"f_dc_{i}"] = splats.sh[:, 0, i].astype(float)
        out[f"scale_{i}"] = np.log(splats.scales[:, i].astype(float))
    for i in range(4):
        out[f"rot_{i}"] = splats.quats[:, i].astype(float)
    out["opacity"] = -np.log(1 / splats.opacities.astype(float) - 1)
    rest = splats.sh.shape[1] - 1
    for channel in range(3):
        for k in range(rest):
            out[f"f_rest_{channel * rest + k}"] = splats.sh[:, 1 + k, channel].astype(float)
    return out


def ply(
    values: dict[str, np.ndarray], order: str = "<", kind: str = "float", extra: str = "", tail: bytes = b""
) -> bytes:
    names, count = list(values), len(next(iter(values.values())))
    form = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    header = f"ply\nformat {form} 1.0\ncomment made by a test\nelement vertex {count}\n"
    header += "".join(f"property {kind} {name}\n" for name in names) + extra + "end_header\n"
    table = np.stack([values[name] for name in names], axis=1)
    if order:
        body = table.astype(order + {"float": "f4", "double": "f8"}[kind]).tobytes()
    else:
        body = "".join(" ".join(repr(float(v)) for v in row) + "\n" for row in table).encode()
    return header.encode() + body + tail


def header(count: int, names: list[str] = BASE, form: str = "binary_little_endian") -> bytes:
    lines = ["ply", f"format {form} 1.0", f"element vertex {count}", *(f"property float {n}" for n in names)]
    return "\n".join([*lines, "end_header", ""]).encode()


def close(a: Splats, b: Splats, tolerance: float = 3e-6) -> None:
    for name in FIELDS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=tolerance, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize("kind", ["float", "double"])
def test_reads_every_layout(tmp_path: Path, degree: int, order: str, kind: str) -> None:
    splats = random_splats(30, degree)
    values = columns(splats)
    shuffled = list(values)
    np.random.default_rng(2).shuffle(shuffled)
    values = {name: values[name] for name in shuffled} | {"nx": np.ones(30), "confidence": np.zeros(30)}
    (tmp_path / "a.ply").write_bytes(ply(values, order, kind))
    close(load_ply(tmp_path / "a.ply"), splats)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_round_trip(tmp_path: Path, degree: int) -> None:
    splats = replace(random_splats(40_000, degree), antialias=degree == 1)  # more than one chunk
    save_ply(splats, tmp_path / "a.ply")
    again = load_ply(tmp_path / "a.ply")
    close(again, splats)
    assert again.sh_degree == degree and again.antialias == splats.antialias
    np.testing.assert_array_equal(again.means, splats.means)
    np.testing.assert_array_equal(again.quats, splats.quats)
    np.testing.assert_array_equal(again.sh, splats.sh)


def test_integer_properties_and_carriage_returns(tmp_path: Path) -> None:
    lines = header(1).decode().replace("float x", "uchar x").replace("float y", "int16 y")
    body = np.zeros(1, [("x", "u1"), ("y", "<i2"), ("rest", "<f4", 12)])
    body["x"], body["y"] = 200, -300
    body["rest"][0, 8] = 1
    (tmp_path / "a.ply").write_bytes(lines.replace("\n", "\r\n").encode() + body.tobytes())
    splats = load_ply(tmp_path / "a.ply")
    assert splats.means[0].tolist() == [200, -300, 0]
    assert splats.opacities[0] == 0.5 and splats.scales[0, 0] == 1


@pytest.mark.parametrize("order", ["<", ""])
def test_other_elements_are_passed_over(tmp_path: Path, order: str) -> None:
    splats = random_splats(4)
    data = ply(
        columns(splats), order, extra="element face 1\nproperty list uchar int vertex_indices\n", tail=b"3 0 1 2\n"
    )
    camera = "element camera 2\nproperty float fov\nproperty uchar flags\n"
    skipped = b"\x01\x02\x03\x04\x05" * 2 if order else b"60.0 1\n61.0 2\n"
    end = data.index(b"end_header\n") + 11
    data = data[:end].replace(b"element vertex", camera.encode() + b"element vertex") + skipped + data[end:]
    (tmp_path / "a.ply").write_bytes(data)
    close(load_ply(tmp_path / "a.ply"), splats)


def test_windows_line_ends_and_a_list_before_the_vertices_in_ascii(tmp_path: Path) -> None:
    splats = random_splats(4)
    head, body = ply(columns(splats), "").split(b"end_header\n")
    head = head.replace(b"element vertex", b"element face 2\nproperty list uchar int vertex_indices\nelement vertex")
    data = head + b"end_header\n3 0 1 2\n4 0 1 2 3\n" + body
    (tmp_path / "a.ply").write_bytes(data.replace(b"\n", b"\r\n"))
    close(load_ply(tmp_path / "a.ply"), splats)


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_two_scales_are_flat_splats(tmp_path: Path, order: str) -> None:
    splats = random_splats(4, 1)
    values = columns(splats)
    del values["scale_2"]
    (tmp_path / "a.ply").write_bytes(ply(values, order))
    again = load_ply(tmp_path / "a.ply")
    np.testing.assert_allclose(again.scales[:, :2], splats.scales[:, :2], rtol=3e-6)
    assert not again.scales[:, 2].any()


@pytest.mark.parametrize("order", ["<", ""])
def test_colours_of_bytes_or_floats_where_there_are_no_coefficients(tmp_path: Path, order: str) -> None:
    values = columns(random_splats(3))
    for name in ("f_dc_0", "f_dc_1", "f_dc_2"):
        del values[name]
    bare = dict(values)
    values |= {"red": np.array([0, 0.5, 1]), "green": np.array([0.2, 0.4, 0.6]), "blue": np.array([1.0, 1, 1])}
    (tmp_path / "a.ply").write_bytes(ply(values, order))
    expected = np.array([[0, 0.2, 1], [0.5, 0.4, 1], [1, 0.6, 1]])
    shown = load_ply(tmp_path / "a.ply").sh[:, 0] * 0.28209479177387814 + 0.5
    np.testing.assert_allclose(shown, expected, atol=1e-6)
    head, _ = ply(bare, order).split(b"end_header\n")
    head += b"".join(b"property uchar %b\n" % name for name in (b"red", b"green", b"blue")) + b"end_header\n"
    rows = [list(row) for row in np.stack(list(bare.values()), axis=1)]
    ends = [(0, 51, 255), (255, 102, 0), (1, 2, 3)]
    if order:
        body = b"".join(np.array(row, "<f4").tobytes() + bytes(end) for row, end in zip(rows, ends, strict=True))
    else:
        lines = [" ".join(map(repr, [*map(float, row), *end])) for row, end in zip(rows, ends, strict=True)]
        body = "\n".join([*lines, ""]).encode()
    (tmp_path / "b.ply").write_bytes(head + body)
    shown = load_ply(tmp_path / "b.ply").sh[:, 0] * 0.28209479177387814 + 0.5
    np.testing.assert_allclose(shown, np.array(ends) / 255, atol=1e-6)


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ([], False),
        (["SplatRenderMode: mip"], True),
        (["splatrendermode:  MIP "], True),
        (["SplatRenderMode: default"], False),
        (["SplatRenderMode: 2dgs"], False),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["glsplat antialias"], True),
        (["antialiased 1", "SplatRenderMode: default"], False),  # the last one counts
        (["SplatRenderMode: default", "antialiased 1", "by somebody"], True),
        (["antialiased images of a garden"], False),
    ],
)
def test_comments_that_ask_for_opacity_compensation(tmp_path: Path, comments: list[str], expected: bool) -> None:
    said = "".join(f"comment {comment}\n" for comment in comments).encode()
    (tmp_path / "a.ply").write_bytes(GOOD.replace(b"comment made by a test\n", said))
    assert load_ply(tmp_path / "a.ply").antialias == expected


def test_extreme_logits_do_not_overflow(tmp_path: Path) -> None:
    values = columns(random_splats(4))
    values["opacity"] = np.array([1e4, -1e4, 0.0, np.nan])
    values["scale_0"] = np.array([-200.0, 200.0, 0.0, np.nan])
    (tmp_path / "a.ply").write_bytes(ply(values))
    splats = load_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(splats.opacities, [1, 0, 0.5, np.nan])
    np.testing.assert_array_equal(splats.scales[:, 0], [0, np.inf, 1, np.nan])


def test_awkward_values_survive_a_round_trip(tmp_path: Path) -> None:
    splats = awkward_splats()
    save_ply(splats, tmp_path / "a.ply")
    stored = np.frombuffer((tmp_path / "a.ply").read_bytes().split(b"end_header\n")[1], "<f4").reshape(10, -1)
    assert np.isfinite(stored[7:9]).all()  # opacities 0 and 1 as finite logits
    again = load_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(again.means, splats.means)
    np.testing.assert_array_equal(again.quats, splats.quats)
    np.testing.assert_array_equal(again.opacities[7:], splats.opacities[7:])
    np.testing.assert_allclose(again.scales, np.abs(splats.scales), rtol=3e-6)


MESH = b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"".join(b"property float %c\n" % c for c in b"xyz")
MESH += b"end_header\n0 0 0\n"
GOOD = ply(columns(random_splats(6)))
ASCII = ply(columns(random_splats(6)), "")
LISTED = b"element face 1\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a PLY file"),
        (b"ply", "not a PLY file"),
        (b"plywood\n" * 9, "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "no line \"end_header\""),
        (b"ply\n" + b"comment " + b"x" * 200_000 + GOOD[4:], "no line \"end_header\" in its first 65536 bytes"),
        (MESH, "not of Gaussian splats: its vertices lack f_dc_0, f_dc_1, f_dc_2, opacity, scale_0"),
        (b"ply\nformat ascii 1.0\nelement face 0\nend_header\n", "needs an element vertex, found face"),
        (header(0, ["packed_position"]), "compressed PLY .*, another format"),
        (header(0, [n for n in BASE if n != "rot_3"]), "lack rot_3"),
        (header(0, [n for n in BASE if n != "scale_1"]), "lack scale_1"),
        (header(0, [*(n for n in BASE if n != "f_dc_2"), "red", "green", "blue"]), "lack f_dc_2"),
        (header(0, [*BASE, "f_rest_0"]), "0, 9, 24 or 45 properties"),
        (header(0, [*BASE, *(f"f_rest_{i + 1}" for i in range(9))]), "0, 9, 24 or 45 properties"),
        (header(0, [*BASE, "x"]), "declares 'x' twice"),
        (header(0, form="binary_middle_endian"), "cannot be understood"),
        (header(0).replace(b"format binary_little_endian 1.0\n", b""), "no format line"),
        (header(0).replace(b"vertex 0", b"vertex -1"), "cannot be understood"),
        (header(0).replace(b"vertex 0", b"vertex 1e3"), "cannot be understood"),
        (header(0).replace(b"float x", b"float128 x"), "cannot be understood"),
        (header(0).replace(b"property float x", b"property list uchar int i\nproperty float x"), "list property"),
        (GOOD.replace(b"element vertex", LISTED + b"element vertex"), "list properties before the vertices"),
        (GOOD[:-1], "truncated: the header declares 6 splats, the file holds 5"),
        (GOOD.replace(b"vertex 6", b"vertex 5"), "declares 5 splats, but the file holds 6"),
        (GOOD.replace(b"vertex 6", b"vertex 999999999999999999"), "truncated: .* the file holds 6"),
        (ASCII.replace(b"vertex 6", b"vertex 999999999999999999"), "truncated"),
        (ASCII.replace(b"vertex 6", b"vertex 7"), "truncated: the header declares 7 splats, the file holds 6"),
        (ASCII.replace(b"vertex 6", b"vertex 5"), "declares 5 splats, but the file holds more"),
        (ASCII[:-30], "needs 14 values, found 1"),
        (ASCII.replace(b"\nend_header\n", b"\nend_header\nfour "), "needs 14 values, found 15"),
        (ASCII.replace(b"0.", b"o.", 1), "could not convert"),
        (header(99_999_999) + bytes(56), "truncated: .* the file holds 1"),
        (b"ply\nformat ascii 1.0\nelement other 999999999999\n" + header(0)[36:], "truncated"),
    ],
)  # fmt: skip
def test_refuses(tmp_path: Path, data: bytes, message: str) -> None:
    refused(tmp_path / "a.ply", data, message, load_ply)


def test_comment_in_any_encoding(tmp_path: Path) -> None:
    data = GOOD.replace(b"made by a test", b"by \xff\xfe\x85\xa0 \xc3\x85ngstr\xf6m \x00")
    (tmp_path / "a.ply").write_bytes(data)
    assert len(load_ply(tmp_path / "a.ply")) == 6


def test_refuses_a_huge_count_at_once() -> None:
    for form in ("ascii", "binary_big_endian"):
        start = header(10**17, form=form)
        file = io.BytesIO(start + b"0 " * 500)
        with pytest.raises(FormatError, match="truncated"):
            read_ply(file, len(file.getvalue()))
        assert file.tell() == len(start)  # nothing behind the header was read


def test_huge_ascii_count_after_a_full_chunk_allocates_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(header(10**9, form="ascii") + (b"0 " * 14 + b"\n") * 33_000)
    with pytest.raises(FormatError, match="declares 1000000000 splats, the file has 957000 bytes"):
        load_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "count", "degree"),
    [("playbot_lod6", 1873, 2), ("splatapult_sh3_16", 16, 3), ("demosthenes_10k", 10000, 0)],
)
def test_real_files(name: str, count: int, degree: int) -> None:
    splats = load_ply(DATA / f"{name}.ply")
    assert (len(splats), splats.sh_degree) == (count, degree)
    assert splats.finite().all() and (splats.scales > 0).all()
    assert (splats.opacities >= 0).all() and (splats.opacities <= 1).all()
    np.testing.assert_allclose(np.linalg.norm(splats.quats, axis=1), 1, atol=1e-6)


def test_sh_of_a_real_file_against_its_bytes() -> None:
    path = DATA / "splatapult_sh3_16.ply"
    head, body = path.read_bytes().split(b"end_header\n")
    names = [line.split()[-1] for line in head.decode().splitlines() if line.startswith("property")]
    raw = dict(zip(names, np.frombuffer(body, "<f4").reshape(16, -1).T, strict=True))
    splats = load_ply(path)
    np.testing.assert_array_equal(splats.sh[:, 5, 1], raw["f_rest_19"])  # coefficient 5 is 4 of 15, green
    np.testing.assert_allclose(splats.scales[:, 2], np.exp(raw["scale_2"]), rtol=1e-6)
    np.testing.assert_allclose(splats.opacities, 1 / (1 + np.exp(-raw["opacity"])), rtol=1e-6)


def test_none_and_one_in_ascii(tmp_path: Path) -> None:
    for count in (0, 1):
        (tmp_path / "a.ply").write_bytes(ply(columns(random_splats(count, 1)), ""))
        splats = load_ply(tmp_path / "a.ply")
        assert len(splats) == count and splats.sh_degree == 1
