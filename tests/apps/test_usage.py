"""Mistakes on the command line: one line each, what was wrong and where help is, exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest

from apps import cli
from apps.cli import main


def mistake(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line that a wrong command prints."""
    try:
        code = main([str(word) for word in words])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert code == 2 and out == "", (code, out, err)
    assert err.count("\n") == 1 and err.startswith(f"glsplat {words[0]}" if words[0] in cli.COMMANDS else "glsplat: ")
    assert err.endswith("--help\n")
    return err


@pytest.mark.parametrize("command", list(cli.COMMANDS))
def test_an_option_that_is_not_there(capsys, command):
    words = {"avatar": ["export", "-o", "x.ply"], "tracking": ["solve", "-o", "x"], "convert": ["a", "b"]}
    words |= {"models": ["list"], "users": ["list"], "watermark": ["detect", "clip.mp4"]}
    words["render"] = ["-o", "x.png"]
    line = mistake(capsys, command, *words.get(command, []), "--nosuch")
    assert line == f"glsplat {command}: unrecognized arguments: --nosuch; see glsplat {command} --help\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nosuch"], "glsplat: nosuch: no such command; render, preview, serve, "),
        (["render", "-o", "x.png", "--level", "17"], "--level: a level is 0 to 16 or auto, not '17'"),
        (["render", "-o", "x.png", "--level", "fine"], "--level: a whole number of at least 0 is needed"),
        (["render", "-o", "x.png", "--lod-bias", "1"], "--lod-bias goes with --level auto"),
        (["render", "-o", "x.png", "--level", "auto", "--lod-bias", "9"], "--lod-bias needs -8 to 8, not 9"),
        (["serve", "--exact", "--level", "1"], "--exact and --level contradict each other"),
        (["demo", "--exact", "--cull-hidden"], "--exact and --cull-hidden contradict each other"),
        (["serve", "--fps", "0"], "--fps needs 1 to 240 pictures a second, not 0"),
        (["rendr", "-o", "x.png"], "glsplat: rendr: no such command; is it render?"),
        (["--verbose"], "glsplat: --verbose: no such command"),
        (["render", "-o", "a.png", "--background", "255,0,0"], "--background: a colour is R,G,B from 0 to 1"),
        (["render", "-o", "a.png", "--ipd", "nan"], "--ipd: a finite number of at least 0"),
        (["bench", "--motion", "nosuch"], "--motion nosuch: no such file and no such motion"),
        (["render"], "glsplat render: missing: -o/--output; see glsplat render --help"),
        (["render", "-o"], "glsplat render: -o/--output: expected one argument"),
        (["render", "-o", "a.png", "--size", "0"], "--size: a size is at least 1x1"),
        (["render", "-o", "a.png", "--fps", "fast"], "--fps: a finite number above 0"),
        (["render", "-o", "a.png", "--frame", "3"], "--frame needs --motion"),
        (["render", "-o", "a.png", "--motion", "walk", "--frame", "99999"], "--frame needs 0 to"),
        (["avatar"], "glsplat avatar: missing: ACTION"),
        (["avatar", "export"], "glsplat avatar export: missing: -o/--out; see glsplat avatar export --help"),
        (["avatar", "nosuch"], "glsplat avatar: ACTION: invalid choice: 'nosuch'"),
        (["avatar", "make", "p.npz", "-o", "x.glb", "--steps", "-1"], "--steps needs 0 or more"),
        (["tracking", "show", "-o", "x.webm", "--size", "9000"], "--size needs at most 4096"),
        (["replay", "--fps", "0"], "--fps needs 1 to 240"),
        (["demo", "--seconds", "0"], "--seconds needs 0.1 to 600"),
        (["serve", "--port", "99999"], "--port needs 0 to 65535"),
        (["bench", "--frames", "1"], "--frames needs at least 3"),
        (["report", "--size", "1"], "--size needs 16 to 1024"),
        (["preview", "--quality", "3"], "--quality goes with --connect"),
        (["inspect", "a", "b"], "unrecognized arguments: b"),
        (["convert", "a"], "missing: OUT"),
    ],
)
def test_mistakes_are_one_line(capsys, words, message):
    assert message in mistake(capsys, *words)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["render", "--motion", "nosuch", "-o", "x.png"], "--motion"),  # .png: it is not the output that is wrong
        (["render", "--motion", "nosuch", "-o", "x.mp4"], "--motion"),
        (["render", "--motion", "./nosuch", "-o", "x.mp4"], "--motion"),
        (["demo", "--motion", "nosuch", "-o", "demo"], "--motion"),
        (["replay", "nosuch"], "MOTION"),
        (["tracking", "from-motion", "nosuch", "-o", "x"], "MOTION"),
        (["avatar", "export", "--pose", "nosuch", "-o", "x.ply"], "--pose"),
    ],
)
def test_a_motion_that_is_not_there_is_blamed_itself(capsys, tmp_path, monkeypatch, words, option):
    monkeypatch.chdir(tmp_path)
    line = mistake(capsys, *words)
    assert line.startswith(f"glsplat {words[0]}: {option} ") and "nosuch: no such file and no such motion" in line
    assert "embedded are idle, walk, wave-and-turn; see" in line


@pytest.mark.parametrize(
    ("words", "output", "message"),
    [
        (["render", "--turntable", "3"], "out", "or {}/ for PNG files: a folder ends in /"),
        (["render", "--motion", "walk"], "out.gif", "a clip .mp4 or .webm for --motion walk, or {}/ for PNG files"),
        (["render", "--motion", "walk"], "out.png", "for one picture of it add --frame N"),
        (["render"], "out.mp4", "expected .png or .npy (for a clip"),
        (["render"], "out.tiff", "expected .png or .npy"),
        (["render"], "there", "this is a folder; give a file in it, .png or .npy"),
        (["replay", "--save"], "out", "or {}/ for PNG files: a folder ends in /"),
        (["tracking", "show"], "out", "or {}/ for PNG files: a folder ends in /"),
        (["tracking", "show"], "out.avi", "expected a clip .mp4 or .webm, a contact sheet .png, or {}/"),
    ],
)
def test_outputs_that_cannot_be(capsys, tmp_path, words, output, message):
    (tmp_path / "there").mkdir()
    path: Path = tmp_path / output
    option = [] if words[-1] == "--save" else ["-o"]
    assert message.format(path) in mistake(capsys, *words, *option, path)
    assert not path.is_file() and (output == "there" or not path.exists())
