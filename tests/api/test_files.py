"""``load`` and ``save`` as a stranger calls them: any name, any open file, links, modes, full disks, holes."""

from __future__ import annotations

import gzip
import io
import os
import stat
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load, load_gltf, load_ply, load_splat, recognise, save
from glsplat.splats import Splats
from tests.formats.scenes import assert_equal, random_avatar, random_splats

ROOT = Path(__file__).resolve().parents[2]
SUFFIXES = (".ply", ".splat", ".glb", ".gltf")


class OwnPath:
    """os.PathLike, of bytes as the system allows."""

    def __init__(self, path: Path) -> None:
        self._path = os.fsencode(path)

    def __fspath__(self) -> bytes:
        return self._path


class Stream:
    """Reads once, forwards, a little at a time, and can do nothing else: a socket, a response."""

    def __init__(self, data: bytes) -> None:
        self._file = io.BytesIO(data)

    def read(self, count: int = -1) -> bytes:
        return self._file.read(count)


def same(a: Splats | Avatar, b: Splats | Avatar) -> None:
    a, b = (scene.splats if isinstance(scene, Avatar) else scene for scene in (a, b))
    assert_equal(a, b)


def zipped(path: Path) -> Any:
    with zipfile.ZipFile(path.with_suffix(".zip"), "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(path, f"inside/{path.name}")
    return zipfile.ZipFile(path.with_suffix(".zip")).open(f"inside/{path.name}")


def spooled(path: Path) -> Any:
    file = tempfile.SpooledTemporaryFile(max_size=1 << 20)
    file.write(path.read_bytes())
    file.seek(0)
    return file


def behind(path: Path) -> Any:
    """A file that begins in the middle of another, as in a container of one's own."""
    file = io.BytesIO(b"header" + path.read_bytes())
    file.seek(6)
    return file


def gzipped(path: Path) -> Any:
    return gzip.open(io.BytesIO(gzip.compress(path.read_bytes())))


NAMES: dict[str, Callable[[Path], Any]] = {
    "str": str,
    "bytes": os.fsencode,
    "Path": Path,
    "PathLike": OwnPath,
}
OPENED: dict[str, Callable[[Path], Any]] = {
    "BytesIO": lambda path: io.BytesIO(path.read_bytes()),
    "in the middle": behind,
    "open": lambda path: open(path, "rb"),
    "unbuffered": lambda path: open(path, "rb", buffering=0),
    "both ways": lambda path: open(path, "r+b"),
    "zip": zipped,
    "gzip": gzipped,
    "spooled": spooled,
    "stream": lambda path: Stream(path.read_bytes()),
}


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".compressed.ply"])
@pytest.mark.parametrize("kind", [*NAMES, *OPENED])
def test_every_way_to_say_which_file(tmp_path: Path, suffix: str, kind: str) -> None:
    path = tmp_path / f"a{suffix}"
    save(random_avatar(degree=1), path)
    expected = load(path)
    source = (NAMES | OPENED)[kind](path)
    same(load(source), expected)
    if kind in OPENED:
        assert not getattr(source, "closed", False)
        if hasattr(source, "close"):
            source.close()
        with_format = OPENED[kind](path)
        same(load(with_format, format=suffix[1:]), expected)
        if hasattr(with_format, "close"):
            with_format.close()
    for reader, own in ((load_ply, ".ply"), (load_splat, ".splat"), (load_gltf, ".glb")):
        if own == suffix:
            again = (NAMES | OPENED)[kind](path)
            same(reader(again), expected)
            if hasattr(again, "close"):
                again.close()


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".compressed.ply"])
def test_save_takes_them_too(tmp_path: Path, suffix: str) -> None:
    scene = random_avatar(degree=1)
    save(scene, tmp_path / f"a{suffix}")
    expected = (tmp_path / f"a{suffix}").read_bytes()
    for index, kind in enumerate(NAMES.values()):
        path = tmp_path / f"b{index}{suffix}"
        save(scene, kind(path))
        assert path.read_bytes() == expected
    memory = io.BytesIO(b"header")
    memory.seek(6)
    save(scene, memory, format=suffix[1:])
    assert memory.getvalue() == b"header" + expected and not memory.closed
    for buffering in (-1, 0):
        with open(tmp_path / f"c{suffix}", "wb", buffering=buffering) as file:
            save(scene, file)  # by its name
        assert (tmp_path / f"c{suffix}").read_bytes() == expected
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive, archive.open("x", "w") as member:
        save(scene, member, format=suffix)
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.read("x") == expected
    save(scene, tmp_path / "named.bin", format=suffix.upper())
    assert (tmp_path / "named.bin").read_bytes() == expected


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    name = os.fsencode(tmp_path) + b"/caf\xe9 \xff.ply"
    save(random_splats(3), name)
    assert len(load(name)) == 3  # type: ignore[arg-type]
    with open(name, "r+b") as file:
        file.truncate(os.path.getsize(name) - 5)
    with pytest.raises(FormatError, match="truncated") as caught:
        load(name)
    str(caught.value).encode()  # can be printed


def closed() -> io.BytesIO:
    file = io.BytesIO(b"ply\n")
    file.close()
    return file


class Failing(Stream):
    def read(self, count: int = -1) -> bytes:
        raise EOFError("ends early")

    def write(self, data: Any) -> int:
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (5, "expected a path .* or a file open in binary mode, not int"),
        (None, "not NoneType"),
        ([1], "not list"),
        (io.StringIO("ply\n"), "binary mode"),
        (closed(), "closed file"),
        (io.BytesIO(b""), "<BytesIO>: the file is empty"),
        (Stream(b"hello"), "<Stream>: expected 3DGS PLY"),
        (Failing(b""), "EOFError: ends early"),
    ],
)
def test_what_cannot_be_read_is_one_line(source: Any, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        load(source)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    scene = random_splats(3)
    (tmp_path / "a").write_bytes(b"")
    with open(tmp_path / "a", "rb") as reading, open(tmp_path / "b.ply", "w") as text:
        for target, more, message in (
            (io.BytesIO(), {}, "<BytesIO>: the name needs to end in .* or say which by format"),
            (io.BytesIO(), {"format": "stl"}, "format is one of ply, .*, gltf, .*, not 'stl'"),
            (io.BytesIO(), {"format": 3}, "format is one of"),
            (io.StringIO(), {"format": "ply"}, "binary mode"),
            (text, {}, "b.ply: .*binary mode"),
            (reading, {"format": "ply"}, "cannot be written"),
            (closed(), {"format": "ply"}, "closed file"),
            (Failing(b""), {"format": "ply"}, "No space left on device"),
            (7, {}, "not int"),
        ):
            with pytest.raises(FormatError, match=message) as caught:
                save(scene, target, **more)  # type: ignore[arg-type]
            assert "\n" not in str(caught.value)
    with pytest.raises(FormatError, match="format is one of"):
        load(tmp_path / "a", format="jpg")


def test_a_broken_member_of_an_archive_is_one_line(tmp_path: Path) -> None:
    save(random_splats(200), tmp_path / "a.ply")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.write(tmp_path / "a.ply", "a.ply")
    data = bytearray((tmp_path / "a.zip").read_bytes())
    data[3000] ^= 255
    with zipfile.ZipFile(io.BytesIO(data)) as archive, archive.open("a.ply") as member:
        with pytest.raises(FormatError, match=r"a\.ply: cannot be read .BadZipFile: Bad CRC"):
            load(member)


def test_a_gltf_with_a_buffer_beside_it_needs_its_path(tmp_path: Path) -> None:
    save(random_splats(5), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    text = data[20 : 20 + length].replace(b'"buffers":[{', b'"buffers":[{"uri":"a.bin",')
    (tmp_path / "a.gltf").write_bytes(text)
    (tmp_path / "a.bin").write_bytes(data[28 + length :])
    same(load(tmp_path / "a.gltf"), load(tmp_path / "a.glb"))
    with open(tmp_path / "a.gltf", "rb") as file, pytest.raises(FormatError, match="has no folder; give its path"):
        load(file)


# ------------------------------------------------------------------------------------------------ links and modes


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_link_is_followed_and_stays(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "store").mkdir()
    target, link, far = tmp_path / "store" / f"v1{suffix}", tmp_path / f"now{suffix}", tmp_path / f"far{suffix}"
    link.symlink_to(Path("store") / f"v1{suffix}")  # relative, and to what is not there yet
    far.symlink_to(link)
    for count in (3, 5):
        save(random_splats(count), far)
        assert link.is_symlink() and far.is_symlink() and not target.is_symlink()
        assert len(load(target)) == len(load(link)) == count  # type: ignore[arg-type]
    assert sorted(p.name for p in tmp_path.rglob("*")) == sorted(["store", link.name, far.name, target.name])


def test_links_in_a_circle_and_into_nowhere_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.ply").symlink_to("b.ply")
    (tmp_path / "b.ply").symlink_to("a.ply")
    (tmp_path / "c.ply").symlink_to("none/c.ply")
    for name in ("a.ply", "b.ply", "c.ply"):
        with pytest.raises(FormatError, match="cannot be written"):
            save(random_splats(1), tmp_path / name)
        assert (tmp_path / name).is_symlink()
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_old_file_keeps_its_mode_and_a_new_one_gets_the_masks(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    before = os.umask(0o027)
    try:
        save(random_splats(1), path)
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        for mode in (0o600, 0o664, 0o666, 0o755):
            path.chmod(mode)
            save(random_splats(2), path)
            assert stat.S_IMODE(path.stat().st_mode) == mode
    finally:
        os.umask(before)
    assert len(load(path)) == 2  # type: ignore[arg-type]


def run(script: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


def test_a_file_that_may_not_be_written_is_not_replaced() -> None:
    script = (
        "import os, sys, glsplat\n"
        "from tests.formats.scenes import random_splats\n"
        "save, scene = glsplat.save, random_splats(1)\n"  # imported while it may be
        "if os.geteuid() == 0: os.setgid(65534); os.setuid(65534)\n"  # to root nothing is forbidden
        "try: save(scene, sys.argv[1])\n"
        "except glsplat.GlsplatError as error: print(error)\n"
    )
    with tempfile.TemporaryDirectory() as folder:  # one that others may enter
        os.chmod(folder, 0o777)
        path = Path(folder) / "a.ply"
        path.write_bytes(b"precious")
        path.chmod(0o444)
        done = run(script, path)
        assert done.stdout == f"{path}: cannot be written (Permission denied)\n", done.stderr
        assert path.read_bytes() == b"precious" and len(list(Path(folder).iterdir())) == 1


@pytest.mark.check
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_disk_that_is_full_leaves_the_old_file_and_nothing_else(tmp_path: Path, suffix: str) -> None:
    """The system refuses in the middle of writing: a limit on the size of files stands in for the disk."""
    path = tmp_path / f"a{suffix}"
    save(random_splats(3), path)
    old = path.read_bytes()
    script = (
        "import resource, sys, glsplat\n"
        "from tests.formats.scenes import random_splats\n"
        "scene = random_splats(30000)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200000, 200000))\n"
        "try: glsplat.save(scene, sys.argv[1])\n"
        "except glsplat.GlsplatError as error: print(error)\n"
    )
    for target in (path, tmp_path / f"new{suffix}"):
        done = run(script, target)
        assert done.stdout == f"{target}: cannot be written (File too large)\n", done.stderr
    assert [p.name for p in tmp_path.iterdir()] == [path.name] and path.read_bytes() == old


# ------------------------------------------------------------------------------------------------------ real files


@pytest.mark.shared
@pytest.mark.parametrize(
    "name", ["splats/avatar40k.ply", "splats/demosthenes_10k.splat", "real/splats/boat_10k.splat",
             "real/splats/train3_sh3.ply", "formats/splat-transform/minimal.splat"],
)  # fmt: skip
def test_real_files_by_every_way_and_through_every_format(shared_data: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / Path(name).name
    path.write_bytes((shared_data / name).read_bytes())
    expected = load(shared_data / name)
    for kind, opened in (NAMES | OPENED).items():
        source = opened(path)
        same(load(source), expected)
        if kind in OPENED and hasattr(source, "close"):
            source.close()
    assert isinstance(expected, Splats)
    for suffix in SUFFIXES:
        memory = io.BytesIO()
        save(expected, memory, format=suffix)
        memory.seek(0)
        again = load(memory)
        assert isinstance(again, Splats) and recognise(io.BytesIO(memory.getvalue())) == suffix[1:]
        np.testing.assert_array_equal(again.means, expected.means)
        np.testing.assert_allclose(again.scales, np.abs(expected.scales), rtol=2e-5)
        if suffix in (".glb", ".gltf"):
            same(again, expected)


def test_the_default_avatar_through_memory() -> None:
    avatar, memory = glsplat.default_avatar(), io.BytesIO()
    save(avatar, memory, format="glb")
    memory.seek(0)
    again = load(memory)
    assert isinstance(again, Avatar) and again.skeleton.names == avatar.skeleton.names
    same(again, avatar)
    np.testing.assert_array_equal(again.skin.weights, avatar.skin.weights)
