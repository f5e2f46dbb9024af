"""SOG: values by hand from the specification, round trips within half a step, what a file does not keep."""

from __future__ import annotations

import json
import math
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats import load, load_sog, losses, recognise, save, save_sog
from glsplat.formats.sog.codebook import codebook
from glsplat.formats.sog.palette import palette, palette_size
from glsplat.formats.sog.write import stored_order
from glsplat.splats import Splats
from tests.formats.scenes import assert_equal, awkward_splats, random_avatar, random_splats
from tests.formats.sog_files import by_hand, pack, webp, zipped

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


def test_positions_by_hand(tmp_path: Path) -> None:
    """Two splats a metre apart, and one in the middle of a step: log 2 / 65535 = 1.0577e-5 a step."""
    step = math.log(2) / 65535
    means = [[0, 0, 0], [1, 0, 0], [math.expm1(1000.4 * step), 0, 0]]
    splats = Splats.create(means, [[1, 0, 0, 0]] * 3, [[0.1] * 3] * 3, [0, 0.5, 1], rgb=[[0.5] * 3] * 3)
    save(splats, tmp_path / "a.sog")
    scene = load_sog(tmp_path / "a.sog")
    np.testing.assert_allclose(sorted(scene.means[:, 0]), [0, math.expm1(1000 * step), 1], rtol=1e-6)
    np.testing.assert_allclose(sorted(scene.opacities), [0, 128 / 255, 1], rtol=1e-6)


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
    said = list(losses(awkward, "a.sog"))
    assert f"{len(awkward) - drawn} splats that are not finite or have no rotation are dropped (none is drawn)" in said
    assert any(line.startswith("1 splats with negative scales") for line in said)
    assert list(losses(random_splats(256, 3), "meta.json")) == []
    assert ["nearest of 256 sets" in line for line in losses(random_splats(300, 3), "a.sog")] == [True]
    many = replace(random_splats(3), opacities=np.array([-1, 2, 0.5]))
    assert list(losses(many, "a.sog")) == ["2 opacities outside 0 to 1 are clamped"]
    assert "the rig of 5 joints is dropped" in next(losses(random_avatar(), "a.sog"))
    save(random_avatar(), tmp_path / "b.sog")
    assert len(load_sog(tmp_path / "b.sog")) == 40


# --- what values become ---


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
