"""SOG: values by hand from the specification, round trips within half a step, and files that lie or are broken."""

from __future__ import annotations

import json
import math
import os
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glsplat.errors import FormatError
from glsplat.extras.formats.sog.quantise import codebook, palette, palette_size
from glsplat.extras.formats.sog.sog import save_sog
from glsplat.extras.formats.sog.write import stored_order
from glsplat.formats import load, losses, recognise, save
from glsplat.splats import Splats
from tests.extras.formats.sog_files import by_hand, pack, webp, zipped
from tests.formats.scenes import SHARED_DATA, assert_equal, awkward_splats, load_sog, random_avatar, random_splats
from tests.formats.test_contract import refused
from tests.formats.test_fuzz import fuzz, mutated, only_format_errors

NAMES = ("means_l", "means_u", "quats", "scales", "sh0", "shN_centroids", "shN_labels")


def read(path: Path, data: bytes) -> Splats:
    path.write_bytes(data)
    scene = load(path)
    assert isinstance(scene, Splats)
    return scene


def test_version_2_by_hand(tmp_path: Path) -> None:
    scene = read(tmp_path / "a.sog", pack(*by_hand()))
    assert recognise(tmp_path / "a.sog") == "sog" and len(scene) == 2 and scene.sh_degree == 1 and not scene.antialias
    half = math.expm1(1 / 65535)  # 0x8000 is half a step above the middle: 2 * 0x8000 / 65535 - 1
    expected = [[math.e - 1, 0, 0], [half, math.exp(2) - 1, 0]]
    np.testing.assert_allclose(scene.means, expected, rtol=1e-6, atol=1e-9)
    small = (128 / 255 - 0.5) * math.sqrt(2)
    large = (1 - 0.5) * math.sqrt(2)
    np.testing.assert_allclose(scene.quats[0], [math.sqrt(1 - 3 * small**2), small, small, small], atol=1e-6)
    np.testing.assert_allclose(
        scene.quats[1], [large, small, math.sqrt(1 - large**2 - 2 * small**2), small], atol=1e-6
    )  # fmt: skip
    np.testing.assert_allclose(scene.scales, np.exp([[-1, -2, -3], [-3, -3, -3]]), rtol=1e-6)
    np.testing.assert_allclose(scene.opacities, [1, 0.2], rtol=1e-6)
    np.testing.assert_array_equal(
        scene.sh[0], [[0.5, 0.25, -0.5], [0.125, -0.125, 0], [0, 0.125, -0.125], [-0.125] * 3]
    )
    np.testing.assert_array_equal(scene.sh[1], [[-0.5] * 3, [0, 0, 0.125], [0, 0, 0], [0.125, 0, 0]])


def test_version_1_by_hand(tmp_path: Path) -> None:
    scene = read(tmp_path / "a.sog", pack(*by_hand(1)))
    assert scene.sh_degree == 1
    np.testing.assert_allclose(scene.means[0], [math.e - 1, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(scene.scales[0], np.exp([-1, -2, -3 + 2 * 2 / 255]), rtol=1e-6)
    np.testing.assert_allclose(scene.sh[0, 0], [0, 2 / 255, 0], atol=1e-7)
    # logits from -2 to 2: 255 is 2, 51 is -2 + 4 / 5
    np.testing.assert_allclose(scene.opacities, [1 / (1 + math.exp(-2)), 1 / (1 + math.exp(1.2))], rtol=1e-6)
    np.testing.assert_allclose(scene.sh[0, 1], [2 / 255 - 1, 4 / 255 - 1, -1], rtol=1e-6)


@pytest.mark.parametrize("version", [1, 2])
def test_unpacked_with_other_names(tmp_path: Path, version: int) -> None:
    meta, files = by_hand(version)
    text = json.dumps(meta)
    (tmp_path / "images").mkdir()
    for index, (name, data) in enumerate(files.items()):
        text = text.replace(f'"{name}"', f'"images/{index}.webp"')
        (tmp_path / "images" / f"{index}.webp").write_bytes(data)
    (tmp_path / "meta.json").write_text(text)
    (tmp_path / "a.sog").write_bytes(pack(meta, files))
    assert recognise(tmp_path / "meta.json") == "sog"
    assert_equal(load(tmp_path / "meta.json"), load_sog(tmp_path / "a.sog"))  # type: ignore[arg-type]
    with open(tmp_path / "meta.json", "rb") as file, pytest.raises(FormatError, match="no folder; give its path"):
        load(file)
    with pytest.raises(FormatError, match="of an unpacked SOG, name its meta"):
        load(tmp_path)


def test_what_other_writers_leave(tmp_path: Path) -> None:
    """A folder in the zip, deflate, nulls, a short codebook, PNG, spare rows, wild tags and labels."""
    meta, files = by_hand()
    meta["scales"]["codebook"] = [None, -2.0, -3.0, *[0.0] * 252, -4.0]
    meta["sh0"]["codebook"] = [0.5, 0.25, -0.5]
    meta["shN"]["codebook"][1] = None
    meta["shN"]["count"] = 64
    meta["means"]["files"][0] = "means_l.png"
    image = cv2.imdecode(np.frombuffer(files.pop("means_l.webp"), np.uint8), cv2.IMREAD_UNCHANGED)
    files["means_l.png"] = cv2.imencode(".png", image)[1].tobytes()
    files["quats.webp"] = webp([[128, 128, 128, 251], [255, 128, 128, 254]], 2, 9)
    files["sh0.webp"] = webp([[0, 1, 2, 255], [2, 3, 2, 51]])
    named = {f"scene/{name}": data for name, data in {"meta.json": json.dumps(meta).encode(), **files}.items()}
    scene = read(tmp_path / "a.zip", zipped({**named, "__MACOSX/._meta.json": b"x"}, zipfile.ZIP_DEFLATED))
    assert scene.scales[0, 0] == pytest.approx(math.exp(-2 + (-2 + 4) / 255))
    np.testing.assert_array_equal(scene.quats[0], [1, 0, 0, 0])
    assert np.isnan(scene.sh[1, 0, 1]) and not np.isnan(scene.sh[0]).any()
    np.testing.assert_array_equal(scene.sh[0, 1], [0, -0.125, 0])  # null among the further ones is 0
    np.testing.assert_array_equal(scene.sh[1, 1:], np.zeros((3, 3)))  # label 64 of 64 sets
    np.testing.assert_allclose(scene.means[0], [math.e - 1, 0, 0], rtol=1e-6)


@pytest.mark.parametrize("key", [{"antialias": True}, {"model": "antialiased"}])
def test_antialias(tmp_path: Path, key: dict[str, Any]) -> None:
    meta, files = by_hand()
    assert read(tmp_path / "a.sog", pack(meta | key, files)).antialias
    assert not read(tmp_path / "a.sog", pack(meta | {"antialias": False, "model": "default"}, files)).antialias
    save(replace(random_splats(), antialias=True), tmp_path / "b.sog")
    written = json.loads(zipfile.ZipFile(tmp_path / "b.sog").read("meta.json"))
    assert written["antialias"] is True and written["model"] == "antialiased" and load_sog(tmp_path / "b.sog").antialias
    save(random_splats(), tmp_path / "b.sog")
    assert "model" not in json.loads(zipfile.ZipFile(tmp_path / "b.sog").read("meta.json"))


def logs(means: Any) -> Any:
    return np.sign(means) * np.log1p(np.abs(np.asarray(means, np.float64)))


def in_order(splats: Splats) -> Splats:
    """As a file has them."""
    return splats.take(stored_order(splats))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_within_the_quantisation(tmp_path: Path, degree: int) -> None:
    splats = random_splats(3000, degree)
    save(splats, tmp_path / "a.sog")
    a, b = in_order(splats), load_sog(tmp_path / "a.sog")
    assert b.sh_degree == degree and len(b) == 3000
    span = np.ptp(logs(a.means), axis=0)
    assert (np.abs(logs(a.means) - logs(b.means)) <= 0.5 * span / 65535 + 2e-7).all()
    assert np.abs(a.opacities - b.opacities).max() <= 0.5 / 255 + 1e-6
    quats = b.quats * np.sign((a.quats * b.quats).sum(axis=1, keepdims=True))
    stored = np.argsort(np.abs(a.quats), axis=1)[:, :3]
    three = [np.take_along_axis(q, stored, axis=1) for q in (quats, a.quats)]
    assert np.abs(three[0] - three[1]).max() <= 0.5 * math.sqrt(2) / 255 + 1e-6
    # the fourth is what makes it a unit: three times as far off where all are a half, and a little for the curve
    assert np.abs(quats - a.quats).max() <= 1.6 * math.sqrt(2) / 255
    for mine, theirs in ((np.log(a.scales), np.log(b.scales)), (a.sh[:, 0], b.sh[:, 0])):
        error = np.abs(mine - theirs)
        assert error.max() <= np.ptp(mine) / 60 and error.std() < np.ptp(mine) / 255 / math.sqrt(12)
    if degree:  # 2048 sets for 3000 splats of noise: the nearest is far, but far nearer than any
        error = (a.sh[:, 1:] - b.sh[:, 1:]).std() / a.sh[:, 1:].std()
        assert 0.1 < error < 0.7
    save(b, tmp_path / "b.sog")  # what went through once changes no more
    c = load_sog(tmp_path / "b.sog")
    for name in ("scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(b, name), getattr(c, name), err_msg=name)


def test_same_bytes_and_every_form(tmp_path: Path) -> None:
    splats = random_splats(200, 2)
    save(splats, tmp_path / "a.sog")
    stream = BytesIO()
    save(splats, stream, format="sog")
    save_sog(splats, tmp_path / "b.sog")
    assert stream.getvalue() == (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        assert all(info.compress_type == zipfile.ZIP_STORED for info in archive.infolist())
        assert sorted(archive.namelist()) == sorted(["meta.json", *(f"{name}.webp" for name in NAMES)])
        inside = {name: archive.read(name) for name in archive.namelist()}
    save(splats, tmp_path / "x" / "meta.json")
    save(splats, f"{tmp_path}/y/", format="sog")
    for folder in ("x", "y"):
        assert {file.name: file.read_bytes() for file in (tmp_path / folder).iterdir()} == inside
    assert_equal(load_sog(tmp_path / "x" / "meta.json"), load_sog(tmp_path / "a.sog"))


def test_what_is_lost_is_said(tmp_path: Path) -> None:
    awkward = awkward_splats()
    save(awkward, tmp_path / "a.sog")
    scene = load_sog(tmp_path / "a.sog")
    drawn = int((awkward.finite() & awkward.quats.any(axis=1)).sum())
    assert len(scene) == drawn and scene.finite().all() and (scene.scales >= 1e-9 * 0.999).all()
    many = replace(random_splats(3), opacities=np.array([-1, 2, 0.5]))
    for scene, words in (
        (awkward, ["6 splats that are not finite", "1 splats with negative scales"]),
        (random_splats(256, 3), []),
        (random_splats(300, 3), ["nearest of 256 sets"]),
        (many, ["2 opacities outside 0 to 1 are clamped"]),
        (random_avatar(), ["the rig of 5 joints is dropped"]),
    ):
        said = list(losses(scene, "a.sog"))
        assert bool(said) == bool(words) and all(any(word in line for line in said) for word in words), said


# --- what values become ---


@pytest.mark.check
def test_palette(rng: np.random.Generator) -> None:
    assert [palette_size(n) for n in (0, 1, 3, 1023, 1024, 31_000, 10**6)] == [0, 1, 2, 512, 1024, 16384, 65536]
    few = rng.normal(size=(100, 9)).astype(np.float32)
    rows = few[rng.integers(0, 100, 5000)]
    sets, labels = palette(rows, 128)
    assert len(sets) == 100
    np.testing.assert_allclose(sets[labels], rows, atol=1e-6)
    # 64 heaps: each gets its set, and no row is left with another heap's
    middles = rng.normal(0, 10, (64, 24)).astype(np.float32)
    rows = (middles[np.repeat(np.arange(64), 50)] + rng.normal(0, 0.1, (3200, 24))).astype(np.float32)
    sets, labels = palette(rows, 64)
    assert len(sets) == 64 and np.abs(sets[labels] - rows).max() < 1
    # more sets than are compared at once: still nearly what comparing all of them gives
    rows = rng.normal(size=(9000, 6)).astype(np.float32)
    sets, labels = palette(rows, 4096)
    mine = ((sets[labels] - rows) ** 2).sum()
    best = sum(((sets[None] - part[:, None]) ** 2).sum(axis=2).min(axis=1).sum() for part in np.array_split(rows, 90))
    assert best <= mine < 1.005 * best and len(np.unique(labels)) == len(sets)


# --- files of other makers ---


REAL = [
    ("angel.sog", 12345, [0.162977532, -1.16956866, -0.246226326], [-6.93876123, -5.35504341, -5.95631170],
     253 / 255, [-0.966161132]),
    ("playbot_5_sog/meta.json", 1234, [0.459835529, -0.0162209962, -0.431653112],
     [-7.25414038, -2.79890347, -6.37717819], 171 / 255,
     [0.254748613, -0.188464388, 0.0582868010, -0.330891371, -0.0675013065, 0.0346847624, -0.154599905,
      -0.0708329082, -0.0240509920]),
]  # fmt: skip


@pytest.mark.shared
def test_real_files(shared_data: Path) -> None:
    """Figures of splat-transform 3.7.0's reading of the same files, a splat each."""
    for name, index, means, scales, opacity, colour in REAL:
        scene = load(shared_data / "real" / "splats" / name)
        assert isinstance(scene, Splats) and scene.finite().all() and not scene.antialias
        np.testing.assert_allclose(scene.means[index], means, rtol=2e-6)
        np.testing.assert_allclose(np.log(scene.scales[index]), scales, rtol=2e-6)
        np.testing.assert_allclose(scene.opacities[index], opacity, rtol=1e-5)
        np.testing.assert_allclose(scene.sh[index, :, 1], colour, rtol=2e-6)


def without(meta: dict[str, Any], *steps: str) -> dict[str, Any]:
    inner = meta
    for step in steps[:-1]:
        inner = inner[step]
    del inner[steps[-1]]
    return meta


def changed(meta: dict[str, Any], value: Any, *steps: Any) -> dict[str, Any]:
    inner: Any = meta
    for step in steps[:-1]:
        inner = inner[step]
    inner[steps[-1]] = value
    return meta


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: changed(m, 3, "version"), "version 1 and 2 are read, this one is of version '3'"),
        (lambda m: changed(m, "2", "version"), "version 1 and 2 are read"),
        (lambda m: changed(m, 10**9, "count"), "claims 1000000000 splats; a SOG has 33554432 at most"),
        (lambda m: changed(m, -1, "count"), "claims -1 splats"),
        (lambda m: changed(m, 30_000_000, "count"), "30000000 splats, which .* bytes cannot hold"),
        (lambda m: changed(m, 5, "count"), r"means_l.webp has 2 x 2 pixels, but needs 5"),
        (lambda m: without(m, "count"), "does not say how many"),
        (lambda m: without(m, "quats"), "quats"),
        (lambda m: without(m, "scales", "codebook"), "scales of meta.json needs a codebook"),
        (lambda m: changed(m, [], "sh0", "codebook"), "codebook"),
        (lambda m: changed(m, [0] * 257, "sh0", "codebook"), "codebook"),
        (lambda m: changed(m, [0, 0], "means", "mins"), "mins"),
        (lambda m: changed(m, 4, "shN", "bands"), "shN.bands of meta.json is 1, 2 or 3, not 4"),
        (lambda m: changed(m, 2, "shN", "bands"), "64 sets of coefficients a row, 512 pixels, not 192"),
        (lambda m: changed(m, "none.webp", "quats", "files", 0), "names 'none.webp', which the zip does not hold"),
        (lambda m: changed(m, "../quats.webp", "quats", "files", 0), "relative to itself, not '../quats.webp'"),
        (lambda m: changed(m, "/etc/passwd", "quats", "files", 0), "relative to itself"),
        (lambda m: changed(m, "C:\\quats.webp", "quats", "files", 0), "relative to itself"),
        (lambda m: changed(m, "https://x.org/q.webp", "quats", "files", 0), "relative to itself"),
        (lambda m: changed(m, "", "quats", "files", 0), "relative to itself"),
    ],
)
def test_lying_meta(tmp_path: Path, change: Callable[[dict[str, Any]], dict[str, Any]], message: str) -> None:
    meta, files = by_hand()
    data = pack(change(meta), files)
    refused(tmp_path / "a.sog", data, message)


def resized(data: bytes, width: int, height: int) -> bytes:
    """A WebP whose header claims another size."""
    bits = struct.unpack_from("<I", data, 21)[0]
    bits = bits & ~0xFFFFFFF | (width - 1) | (height - 1) << 14
    return data[:21] + struct.pack("<I", bits) + data[25:]


def lossy(data: bytes) -> bytes:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, 80])[1].tobytes()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("means_u.webp", lambda d: webp([[0, 0, 0]], 1, 1), "means_u.webp has 1 x 1 pixels, but needs 2"),
        ("sh0.webp", lambda d: resized(d, 16383, 16383), "sh0.webp has 16383 x 16383 pixels"),
        ("sh0.webp", lambda d: webp([[0, 0, 0]], 1000, 1000), "sh0.webp has 1000 x 1000 pixels"),
        ("shN_centroids.webp", lambda d: resized(d, 16383, 16383), "shN_centroids.webp has 16383 x 16383 pixels"),
        ("shN_centroids.webp", lambda d: webp([[0, 0, 0]], 100, 2), "192 pixels, not 100"),
        ("quats.webp", lambda d: d[:30], "quats.webp cannot be decoded"),
        ("quats.webp", lambda d: d[:18], "quats.webp needs to be a WebP image without loss"),
        ("quats.webp", lambda d: b"", "quats.webp needs to be a WebP image without loss"),
        ("quats.webp", lambda d: b"GIF89a" + d, "quats.webp needs to be a WebP image without loss"),
        ("quats.webp", lossy, "quats.webp is WebP with loss"),
        ("quats.webp", lambda d: d + bytes(100_000), "quats.webp has 1000.. bytes, more than an image of 2 x 2"),
    ],
)
def test_wrong_images(
    tmp_path: Path, name: str, change: Callable[[bytes], bytes], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    meta, files = by_hand()
    refused(tmp_path / "a.sog", pack(meta, files | {name: change(files[name])}), message)
    assert capfd.readouterr() == ("", "")  # OpenCV says nothing of its own


def test_size_is_looked_at_before_decoding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    meta, files = by_hand()
    files["means_l.webp"] = webp([[0, 0, 0]], 1000, 1000)  # decodes well, from a few bytes
    (tmp_path / "a.sog").write_bytes(pack(meta, files))

    def never(*_: object) -> None:
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", never)
    with pytest.raises(FormatError, match="1000 x 1000 pixels"):
        load(tmp_path / "a.sog")


def test_zips_that_are_not_as_they_should_be(tmp_path: Path) -> None:
    meta, files = by_hand()
    good = pack(meta, files)
    text = json.dumps(meta).encode()
    locked = bytearray(good)
    for mark, at in ((b"PK\3\4", 6), (b"PK\1\2", 8)):  # the flag of encryption, in both headers of quats.webp
        start = good.index(mark, good.index(b"means_u.webp") if mark[2] == 3 else good.index(b"PK\1\2"))
        while b"quats.webp" not in good[start : start + 60]:
            start = good.index(mark, start + 1)
        locked[start + at] |= 1
    twice = BytesIO()
    with zipfile.ZipFile(twice, "w") as archive, pytest.warns(UserWarning, match="Duplicate"):
        for name, data in [*files.items(), ("meta.json", text), ("quats.webp", b"")]:
            archive.writestr(name, data)
    flipped = bytearray(good)
    flipped[good.index(b"VP8L") + 14] ^= 0xFF
    many = zipped({"meta.json": text, **files, **{f"{index}": b"" for index in range(1200)}})
    bomb = zipped({"meta.json": b" " * (2 << 20)}, zipfile.ZIP_DEFLATED)
    nameless = good.replace(b"meta.json", b"\0eta.json")
    cases = {
        nameless: "a zip that holds meta.json, this one holds",
        bytes(locked): "quats.webp is encrypted",
        twice.getvalue(): "2 files of the zip are called 'quats.webp'",
        bytes(flipped): "cannot be unpacked: Bad CRC",
        many: "1208 entries in .* bytes, a .sog a handful",
        bomb: "meta.json has 1048576 bytes at most, this one 2097152",
        good[:-10]: "no end record",
        good[: len(good) // 2]: "no end record",
        zipped({"a.txt": b"x"}): "a zip that holds meta.json, this one holds a.txt",
        zipped({"a/meta.json": text, "b/meta.json": text}): "2 folders of the zip hold a meta.json",
        zipped({"a/b/meta.json": text}): "this one holds a/b/meta.json",
        pack(meta, files | {"means_l.webp": b""}, **{"../means_l.webp": b"", "/means_l.webp": b""}): "without loss",
    }
    for data, message in cases.items():
        (tmp_path / "a.sog").write_bytes(data)
        before = sorted(tmp_path.parent.rglob("*"))
        with pytest.raises(FormatError, match=message) as caught:
            load(tmp_path / "a.sog")
        assert "\n" not in str(caught.value) and sorted(tmp_path.parent.rglob("*")) == before
    (tmp_path / "a.zip").write_bytes(zipped({"a.txt": b"x"}))
    with pytest.raises(FormatError, match=r"a ZIP archive without the meta\.json of a \.sog"):
        load(tmp_path / "a.zip")


def test_deflated_bomb_is_not_unpacked(tmp_path: Path) -> None:
    meta, files = by_hand()
    files["quats.webp"] += bytes(50_000_000)
    data = zipped({"meta.json": json.dumps(meta).encode(), **files}, zipfile.ZIP_DEFLATED)
    assert len(data) < 100_000
    (tmp_path / "a.sog").write_bytes(data)
    with pytest.raises(FormatError, match=r"quats.webp has 500.* bytes, more than an image of 2 x 2 pixels can need"):
        load(tmp_path / "a.sog")


def test_links_that_lead_out(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    save(random_splats(), folder / "meta.json")
    os.replace(folder / "quats.webp", tmp_path / "quats.webp")
    with pytest.raises(FormatError, match=r"quats\.webp"):
        load(folder / "meta.json")
    (folder / "quats.webp").symlink_to(tmp_path / "quats.webp")
    with pytest.raises(FormatError, match=r"'quats\.webp' lies outside the folder"):
        load(folder / "meta.json")


# --- a folder is whole, or as it was ---


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_a_folder_is_replaced_whole(tmp_path: Path) -> None:
    folder = tmp_path / "x"
    save(random_splats(60, 1), folder / "meta.json")
    (folder / "notes.txt").write_text("mine")
    (folder / "mine.webp").write_bytes(b"mine")
    first = content(folder)
    save(random_splats(61, 0, seed=2), folder / "meta.json")
    scene = load_sog(folder / "meta.json")
    assert len(scene) == 61 and scene.sh_degree == 0
    named = {name for entry in json.loads((folder / "meta.json").read_text()).values() if isinstance(entry, dict)
             for name in entry.get("files", [])}  # fmt: skip
    assert set(content(folder)) == named | {"meta.json", "notes.txt", "mine.webp"}
    save(random_splats(60, 1), folder / "meta.json")
    assert content(folder) == first


@pytest.mark.parametrize("there", [True, False])
def test_a_failure_leaves_the_folder_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool) -> None:
    folder = tmp_path / "x"
    if there:
        save(random_splats(60, 1), folder / "meta.json")
    before = content(folder) if there else None
    for failing in range(7):  # at each image, and at meta.json
        done = []

        def full(source: Any, target: Any, count: int = failing, done: list[Any] = done) -> None:
            done.append(target)
            if len(done) > count:
                raise OSError(28, "No space left on device")
            os.rename(source, target)

        with monkeypatch.context() as patch, pytest.raises(FormatError, match="No space left on device"):
            patch.setattr(os, "replace", full)
            save(random_splats(61, 0, seed=2) if failing < 6 else random_splats(61, 1, seed=2), folder / "meta.json")
        assert (content(folder) if folder.is_dir() else None) == before, failing


REAL_FOLDER = SHARED_DATA / "real" / "splats" / "playbot_5_sog"


@lru_cache(maxsize=1)
def seeds() -> list[dict[str, bytes]]:
    """Files by name: both versions by hand, one as we write it, one of another maker where it is there."""
    packed = BytesIO()
    save(random_splats(9, 2), packed, format="sog")
    found = [pack(*by_hand(1)), pack(*by_hand(2)), packed.getvalue()]
    out = []
    for data in found:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            out.append({name: archive.read(name) for name in archive.namelist()})
    if REAL_FOLDER.is_dir():
        out.append({path.name: path.read_bytes() for path in sorted(REAL_FOLDER.iterdir())})
    return out


def tried(folder: Path, files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> None:
    """As a zip, and unpacked."""
    (folder / "fuzz.sog").write_bytes(zipped(files, method))
    only_format_errors(folder / "fuzz.sog", load)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    only_format_errors(folder / "meta.json", load_sog)


@fuzz
@given(data=st.data())
def test_mutated_meta(tmp_path: Path, data: st.DataObject) -> None:
    files = dict(data.draw(st.sampled_from(seeds())))
    # of the codebooks, the first few numbers
    meta = mutated(data, json.loads(files["meta.json"]), lambda path: len(path) < 3 or path[2] in range(4))
    tried(tmp_path, files | {"meta.json": json.dumps(meta).encode()})


@fuzz
@given(data=st.data())
def test_mutated_images(tmp_path: Path, data: st.DataObject) -> None:
    files = dict(data.draw(st.sampled_from(seeds())))
    for _ in range(data.draw(st.integers(1, 3))):
        name = data.draw(st.sampled_from(sorted(files)))
        content = bytearray(files[name])
        kind = data.draw(st.sampled_from(["set", "head", "head", "cut", "swap"]))
        some = data.draw(st.binary(min_size=1, max_size=8))
        if kind == "swap":
            content = bytearray(files[data.draw(st.sampled_from(sorted(files)))])
        elif kind == "cut":
            del content[data.draw(st.integers(0, len(content))) :]
        else:
            at = data.draw(st.integers(0, min(len(content), 40 if kind == "head" else 5000)))
            content[at : at + len(some)] = some
        files[name] = bytes(content)
    tried(tmp_path, files, data.draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])))


@fuzz
@given(data=st.data())
def test_mutated_zip(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(zipped(data.draw(st.sampled_from(seeds()[:3])), zipfile.ZIP_STORED))
    directory = content.index(b"PK\1\2")
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(directory, len(content)) | st.integers(0, len(content)))
        content[at : at + 2] = data.draw(st.binary(min_size=1, max_size=4))
    (tmp_path / "fuzz.sog").write_bytes(content)
    only_format_errors(tmp_path / "fuzz.sog", load)


def test_codebook(rng: np.random.Generator) -> None:
    few = rng.normal(size=200).astype(np.float32)
    book, index = codebook(np.tile(few, (50, 1)))
    np.testing.assert_array_equal(book[index], np.tile(few, (50, 1)))
    for values in (
        rng.normal(size=50_000),
        np.concatenate([rng.normal(size=50_000), [1000.0]]),
        np.concatenate([rng.normal(0, 0.01, 20_000), rng.uniform(-9, 9, 300)]),
        np.exp(rng.normal(0, 2, 20_000)),
    ):
        book, index = codebook(values)
        assert len(book) == 256 and (np.diff(book) >= 0).all() and index.dtype == np.uint8
        error = np.abs(book[index] - values)
        assert error.max() <= np.ptp(values) / 60
        np.testing.assert_allclose(error, np.abs(values[:, None] - book).min(axis=1), atol=1e-5 * np.ptp(values))
    normal = rng.normal(size=200_000)
    book, index = codebook(normal)
    # Panter and Dite: sqrt(3) pi / 2 sigma^2 / 256^2 is what the best of all codebooks leaves
    assert (book[index] - normal).std() < 1.15 * math.sqrt(math.sqrt(3) * math.pi / 2) / 256


def test_targets_that_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "a.sog").mkdir()
    for target in ("none/x/meta.json", "file/meta.json", "none/a.sog", "a.sog"):
        with pytest.raises(FormatError, match="cannot be written"):
            save(random_splats(), tmp_path / target)
    with pytest.raises(FormatError, match=r"needs to end in .*\.sog or meta\.json, not '\.json'"):
        save(random_splats(), tmp_path / "other.json")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.sog", "file"]
