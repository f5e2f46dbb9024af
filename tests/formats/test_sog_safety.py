"""SOG files that lie or are broken: one line each, nothing large is decoded; a folder is whole, or as it was."""

from __future__ import annotations

import json
import os
import struct
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats import load, load_sog, save
from tests.formats.scenes import random_splats
from tests.formats.sog_files import by_hand, pack, webp, zipped
from tests.formats.test_contract import refused


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


def test_targets_that_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "a.sog").mkdir()
    for target in ("none/x/meta.json", "file/meta.json", "none/a.sog", "a.sog"):
        with pytest.raises(FormatError, match="cannot be written"):
            save(random_splats(), tmp_path / target)
    with pytest.raises(FormatError, match=r"needs to end in .*\.sog, meta\.json.* not '\.json'"):
        save(random_splats(), tmp_path / "other.json")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.sog", "file"]
