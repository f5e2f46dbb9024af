"""load by content, save by suffix, and what the file system may do to them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load, recognise, save
from glsplat.io.files import open_regular, replace_file
from tests.formats.scenes import assert_equal, awkward_splats, random_avatar, random_splats
from tests.golden.stored import DATA

SUFFIXES = (".ply", ".splat", ".glb", ".gltf")


def test_suffix_in_capitals_and_unknown(tmp_path: Path) -> None:
    save(random_splats(), tmp_path / "a.PLY")
    assert recognise(tmp_path / "a.PLY") == "ply"
    for name in ("a", "a.stl", "a.ply.gz", ".ply"):
        with pytest.raises(FormatError, match="needs to end in"):
            save(random_splats(), tmp_path / name)


def test_an_avatar_keeps_its_rig_only_in_gltf(tmp_path: Path) -> None:
    avatar = random_avatar()
    for suffix in SUFFIXES:
        save(avatar, tmp_path / f"a{suffix}")
        scene = load(tmp_path / f"a{suffix}")
        assert isinstance(scene, Avatar) == (suffix in (".glb", ".gltf"))
        splats = scene.splats if isinstance(scene, Avatar) else scene
        np.testing.assert_array_equal(splats.means, avatar.splats.means)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"is empty; expected 3DGS PLY, .*glTF/GLB with KHR_gaussian_splatting or triangles, OBJ, .*, or \.splat"),
        (b"hello", "none of them"),
        (b"\x1f\x8b" + bytes(30), "gzip"),
        (b"PK\x03\x04" + bytes(28), "ZIP"),
        (b"NGSP" + bytes(28), ".spz"),
        (bytes(64), "none of them"),
        (b"\x89PNG\r\n\x1a\n" + bytes(56), "none of them"),
        (b"{}", "asset.version"),
        (b'{"poses": []}', "asset.version"),
    ],
)
def test_nothing_known(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "x.ply"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_directory_pipe_missing_and_nul(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="directory"):
        load(tmp_path)
    with pytest.raises(FormatError, match="No such file"):
        load(tmp_path / "no.ply")
    with pytest.raises(FormatError, match="cannot be read"):
        load("a\0b")
    with pytest.raises(FormatError, match="cannot be read"):
        load(tmp_path / ("x" * 5000))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FormatError, match="not a regular file"):
        load(tmp_path / "pipe")
    with pytest.raises(FormatError, match="not a regular file"):
        load("/dev/zero")


def test_unreadable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.ply").write_bytes(b"ply\n")

    def refused(*_: object) -> int:  # a mode of 000 would not stop root
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refused)
    with pytest.raises(FormatError, match="Permission denied"):
        load(tmp_path / "a.ply")


def test_an_error_while_reading_is_a_format_error(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="cannot be read"), open_regular(__file__):
        raise OSError(5, "Input/output error")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_unwritable_output_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / f"folder{suffix}").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for target in (tmp_path / "none" / f"a{suffix}", tmp_path / "file" / f"a{suffix}", tmp_path / f"folder{suffix}"):
        with pytest.raises(FormatError, match="cannot be written") as caught:
            save(awkward_splats(), target)
        assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failure_while_writing_keeps_the_old_file(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(random_splats(), tmp_path / f"a{suffix}")
    old = (tmp_path / f"a{suffix}").read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(FormatError, match="No space left on device"):
        save(random_splats(3), tmp_path / f"a{suffix}")
    assert [p.name for p in tmp_path.iterdir()] == [f"a{suffix}"]
    assert (tmp_path / f"a{suffix}").read_bytes() == old


def test_an_interrupted_write_cleans_up(tmp_path: Path) -> None:
    def parts():  # type: ignore[no-untyped-def]
        yield b"half"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replace_file(tmp_path / "a.ply", parts())
    assert not list(tmp_path.iterdir())


def test_a_private_file_is_never_readable_for_others(tmp_path: Path) -> None:
    path, seen = tmp_path / "key.pem", []

    def parts():  # type: ignore[no-untyped-def]
        seen.extend(p.stat().st_mode & 0o777 for p in tmp_path.iterdir() if p.suffix == ".partial")
        yield b"secret"

    replace_file(path, parts(), private=True)
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o644)
    replace_file(path, parts(), private=True)
    assert path.stat().st_mode & 0o777 == 0o600 and seen == [0o600, 0o600]


def test_real_scene_through_every_format(tmp_path: Path) -> None:
    scene = load(DATA / "demosthenes_10k.splat")
    for suffix in SUFFIXES:
        save(scene, tmp_path / f"a{suffix}")
        again = load(tmp_path / f"a{suffix}")
        np.testing.assert_array_equal(again.means, scene.means)
        np.testing.assert_allclose(again.scales, scene.scales, rtol=1e-6)
        np.testing.assert_allclose(again.opacities, scene.opacities, atol=1e-6)
        np.testing.assert_allclose(again.sh, scene.sh, atol=1e-6)
        if suffix in (".glb", ".gltf"):
            assert_equal(again, scene)
