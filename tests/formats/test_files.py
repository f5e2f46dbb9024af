"""``load`` and ``save`` on any name and any open file, links, modes, failures, and files of holes."""

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

import pytest

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.errors import FormatError
from glsplat.formats import all_formats, load, save
from glsplat.io.files import replace_file
from glsplat.splats import Splats
from tests.formats.scenes import (
    assert_equal,
    awkward_splats,
    load_gltf,
    load_ply,
    load_splat,
    random_avatar,
    random_splats,
)

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = {suffix for known in all_formats().values() if known.save for suffix in known.suffixes}
SUFFIXES = [suffix for suffix in (".ply", ".glb", ".gltf", ".splat", ".compressed.ply") if suffix in WRITTEN]
READERS: dict[str, Callable[..., Any]] = {".ply": load_ply, ".splat": load_splat, ".glb": load_gltf}


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


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", [*NAMES, *OPENED])
def test_every_way_to_say_which_file(tmp_path: Path, suffix: str, kind: str) -> None:
    path = tmp_path / f"a{suffix}"
    save(random_avatar(degree=1), path)
    expected = load(path)
    source = (NAMES | OPENED)[kind](path)
    same(load(source), expected)
    assert kind in NAMES or not getattr(source, "closed", False)
    if hasattr(source, "close"):
        source.close()
    again = (NAMES | OPENED)[kind](path)
    same(READERS.get(suffix, load)(again), expected)
    if hasattr(again, "close"):
        again.close()


@pytest.mark.parametrize("suffix", SUFFIXES)
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
        (io.BytesIO(b"\x1f\x8b" + bytes(30)), "gzip"),
        (io.BytesIO(b"PK\x03\x04" + bytes(28)), "ZIP"),
        (io.BytesIO(b"NGSP" + bytes(28)), r"\.spz"),
        (io.BytesIO(bytes(64)), "none of them"),
        (io.BytesIO(b'{"poses": []}'), "asset.version"),
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
        "save, scene = glsplat.save, random_splats(1)\n"
        "glsplat.formats.all_formats()\n"  # imported while it may be
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


# ------------------------------------------------------------------------------------------------------ real files


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


# ------------------------------------------------------------------------------------------- two gigabytes of holes


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


def test_files_of_two_gigabytes_of_nothing_are_refused_without_reading_them(tmp_path: Path) -> None:
    for name, head in HOLES.items():
        (tmp_path / name).write_bytes(head)
        os.truncate(tmp_path / name, SIZE)
        assert (tmp_path / name).stat().st_blocks * 512 < 16 << 20  # a hole indeed
    script = (
        "import resource, sys, glsplat\n"
        "def load_splat(source): return glsplat.load(source, format='splat')\n"
        "def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10\n"
        "def taken(): return int(open('/proc/self/io').readline().split()[1]) >> 20\n"  # by read(2)
        "before = peak()\n"
        "for name in sys.argv[1:]:\n"
        "    start = taken()\n"
        "    for source in (name, open(name, 'rb')):\n"
        "        for reader in (glsplat.load, *([load_splat] if '.splat' in name else ())):\n"
        "            if not isinstance(source, str): source.seek(0)\n"
        "            try: reader(source); print(name, 'loaded')\n"
        "            except glsplat.GlsplatError as error: assert chr(10) not in str(error)\n"
        "    if taken() - start >= 64 or peak() - before >= 64: print(name, taken() - start, peak() - before)\n"  # MiB
    )
    done = run(script, *(tmp_path / name for name in HOLES))
    assert done.returncode == 0 and not done.stdout, done.stdout + done.stderr


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


def test_the_default_avatar_through_memory() -> None:
    avatar, memory = default_avatar(), io.BytesIO()
    save(avatar, memory, format="glb")
    memory.seek(0)
    again = load(memory)
    assert isinstance(again, Avatar) and again.skeleton.names == avatar.skeleton.names
    same(again, avatar)
    assert (again.skin.weights == avatar.skin.weights).all()


@pytest.mark.check
def test_a_disk_that_is_full_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    """The system refuses in the middle of writing: a limit on the size of files stands in for the disk."""
    for suffix in SUFFIXES:
        save(random_splats(3), tmp_path / f"a{suffix}")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    script = (
        "import resource, sys, glsplat\n"
        "from tests.formats.scenes import random_splats\n"
        "scene = random_splats(30000)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200000, 200000))\n"
        "for path in sys.argv[1:]:\n"
        "    try: glsplat.save(scene, path)\n"
        "    except glsplat.GlsplatError as error: print(error)\n"
    )
    targets = [tmp_path / f"{name}{suffix}" for suffix in SUFFIXES for name in ("a", "new")]
    command = [sys.executable, "-c", script, *map(str, targets)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.splitlines() == [f"{target}: cannot be written (File too large)" for target in targets], done
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
