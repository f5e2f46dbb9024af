"""The flags of the serve command and its server.toml."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from apps import cli
from apps.serve import command as serve
from apps.serve import options
from apps.serve.options import ServeOptions, parsed
from apps.usage import CommandParser
from glsplat.errors import GlsplatError
from tests.apps.cli import mistake

NAMES = [one.name.replace("_", "-") for one in fields(ServeOptions) if one.metadata]


def parser() -> CommandParser:
    made = CommandParser(prog="glsplat serve")
    serve.add_arguments(made)
    return made


def of(tmp_path: Path, text: str, *words: str) -> ServeOptions:
    path = tmp_path / "server.toml"
    path.write_text(text)
    return parsed(parser(), ["--config", str(path), *words])


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    try:
        assert cli.main(["serve", *words]) == 0
    except SystemExit as stop:
        assert not stop.code
    return capsys.readouterr().out


def test_help_shows_the_flags(capsys: pytest.CaptureFixture[str]) -> None:
    flags = set(re.findall(r"^  (?:-h, )?--([a-z-]+)", printed(capsys, "--help"), re.M))
    assert flags <= set(NAMES) | {"help", "config", "write-config"}
    assert 10 <= len(flags) <= 16


def test_every_option_is_in_the_file_that_is_printed_and_read_from_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = printed(capsys, "--write-config")
    assert tomllib.loads(text) == {} and max(map(len, text.splitlines())) <= 100
    assert of(tmp_path, text) == ServeOptions()
    for line in re.findall(r"^#([a-z-]+ = .*)", text, re.M):
        of(tmp_path, line)  # each alone is read
    listed = re.findall(r"^#([a-z-]+) = ", text, re.M)
    assert listed == NAMES


def test_the_command_line_wins(tmp_path: Path) -> None:
    text = 'scene = "me.glb"\nport = 9000\nroom = ["a", "b:3"]\norigin = "https://a.example"\nmirror = true\nfps = 45\n'
    text += "insecure = false\nmax-clients = 20\n"
    found = of(tmp_path, text)
    assert (found.scene, found.port, found.fps, found.mirror) == ("me.glb", 9000, 45.0, True)
    assert [room.name for room in found.room] == ["a", "b"] and found.origin == ("https://a.example",)
    assert found.insecure is False and found.max_clients == 20
    found = of(tmp_path, text, "you.glb", "--port", "8000", "--room", "c", "--insecure")
    assert (found.scene, found.port, found.mirror, found.insecure) == ("you.glb", 8000, True, True)
    assert [room.name for room in found.room] == ["c"] and found.max_clients == 20


def test_the_file_of_the_docs_is_read(tmp_path: Path) -> None:
    """The one of docs/deploying.md, "TLS for twenty users"."""
    page = (Path(__file__).parents[3] / "docs" / "deploying.md").read_text(encoding="utf-8")
    (block,) = (one for one in re.findall(r"```toml\n(.*?)```", page, re.S) if "max-clients = 20" in one)
    found = of(tmp_path, re.sub(r"(?m)^scene = .*\n", "", block))
    assert found.max_clients == 20 and found.users and found.tls_cert


@pytest.mark.extra(name="learned")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("prot = 1", "expected an option of glsplat serve, got 'prot'; is it port?"),
        ("max_clients = 1", "expected an option of glsplat serve, got 'max_clients'; is it max-clients?"),
        ("config = 'a.toml'", "expected an option of glsplat serve, got 'config'; see"),
        ("serve = 1", "expected an option of glsplat serve, got 'serve'; see"),
        ("[limits]\nport = 1", "tables are not used: leave out [limits], each line is OPTION = VALUE"),
        ("[room]\nname = 'a'", "tables are not used: leave out [room], each line is OPTION = VALUE"),
        ("mirror = 1", "mirror: needs true or false, not 1"),
        ("port = true", "port: needs a whole number from 0 to 65535, not true"),
        ("port = [1, 2]", "port: needs a whole number from 0 to 65535, not [1, 2]"),
        ("port = 2026-11-24", 'port: needs a whole number from 0 to 65535, not "2026-11-24"'),
        ("port = '8000'", 'port: needs a whole number from 0 to 65535, not "8000"'),
        ("port = 8000.0", "port: needs a whole number from 0 to 65535, not 8000.0"),
        ("port = 65536", "port: needs a whole number from 0 to 65535, not 65536"),
        ("fov = '65'", 'fov: needs a number from 1 to 170 degrees, not "65"'),
        ("fov = nan", "fov: needs a number from 1 to 170 degrees, not nan"),
        ("max-cost = inf", "max-cost: needs a number of at least 1 pixels, not inf"),
        (f"max-cost = {10**400}", "max-cost: needs a number of at least 1 pixels, not 1000"),
        ("host = 1", "host: needs a text, not 1"),
        ("level = 1.5", "level: needs a text or a whole number, not 1.5"),
        ("workers = true", "workers: needs a text or a whole number, not true"),
        ("origin = [1, 2]", "origin: needs a text or a list of texts, not [1, 2]"),
        ("room = [['a']]", 'room: needs a text or a list of texts, not [["a"]]'),
        ("room = 'a:99'", "room: a room holds 1 to 64 people"),
        ("trusted-proxy = 'x'", "trusted-proxy: "),
        ("solver = 'magic'", 'solver: needs one of learned, analytic, not "magic"'),
        ("light = 'noon'", "light: a light is one of studio, day, evening, "),
        ("port =", "not TOML"),
        ("size = 128\nmax-size = 64", "size: needs at most 64 a side"),
        ("scene = 'nowhere.glb'", "scene: nowhere.glb: no such file"),
        ("avatar = 'nowhere.glb'", "avatar nowhere.glb: no such file"),
        ("users = 'nowhere'", "users: nowhere: "),
        ("trust = 'nowhere'", "trust: nowhere: "),
        ("calibration = 'nowhere'", "calibration: nowhere: "),
        ("tls-cert = 'nowhere'\ntls-key = 'key'", "tls-cert: nowhere: expected a PEM file"),
        ("token-file = 'nowhere'", "token-file: nowhere: "),
        ("watermark = 'nowhere'", "watermark: nowhere: "),
        ("room = 'lab=nowhere.glb'", "room: nowhere.glb: "),
        ("room = ['lab', 'lab']", "room lab: there are two rooms"),
        ("device = 'nvidia9'", "device: no EGL device 'nvidia9'; give an index or a part of a name: 0 = "),
        ("worker-cpus = 2", "worker-cpus is for workers: give workers, too, or leave it out"),
        ("worker-gpus = 0.0", "worker-gpus is for workers"),
        ("ray-address = 'auto'", "ray-address is for workers"),
        ("participant = 1", "participant is for study: give study, too, or leave it out"),
    ],
)
def test_what_a_file_cannot_mean(
    text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    Path("server.toml").write_text(text)
    line = mistake(capsys, "serve", "--config", "server.toml")
    assert line.startswith(f"glsplat serve: server.toml: {message}"), line
    assert line.endswith("; see glsplat serve --write-config\n")


def test_files_that_cannot_be_read_are_usage_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "server.toml"
    path.write_bytes(b"\xff")
    assert "not TOML" in mistake(capsys, "serve", "--config", path)
    line = mistake(capsys, "serve", "--config", tmp_path / "none.toml")
    assert "none.toml: cannot be read (No such file or directory); see glsplat serve --write-config" in line


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--fov 65", "--fov: no such flag, fov goes into the file of --config"),
        ("--fovv=65", "--fovv: no such flag, fov goes into the file of --config"),
        ("--no-fov", "--no-fov: no such flag, fov goes into the file of --config"),
        ("--avatr a.glb", "--avatr: no such flag, is it --avatar?"),
        ("--cnfig a.toml", "--cnfig: no such flag, is it --config?"),
        (
            "--fov 65 --port 1 --ipd 1",
            "--fov: no such flag, fov goes into the file of --config; "
            "--ipd: no such flag, ipd goes into the file of --config",
        ),
    ],
)
def test_unknown_flags(words: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = mistake(capsys, "serve", *words.split())
    assert line == f"glsplat serve: {message}; see glsplat serve --write-config\n"
    assert "unrecognized arguments: --serve; see glsplat serve --help" in mistake(capsys, "serve", "--serve")


@pytest.mark.parametrize(
    ("text", "extra"),
    [
        ("face-osc = 9000", "speech"),
        ("no-idle = false", "speech"),
        ('users = "a.json"', "accounts"),
        ("self-signed = true", "operations"),
        ('workers = "2"', "workers"),
        ('watermark = "on"', "watermark"),
    ],
)
def test_an_option_names_the_extra_that_it_lacks(
    text: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    absent = {extra}
    monkeypatch.setattr(options, "has_extra", lambda name: name not in absent)
    with pytest.raises(GlsplatError, match=f"server.toml: {text} needs glsplat.extras.{extra}, which is not installed"):
        serve.check(of(tmp_path, text))
    serve.check(of(tmp_path, "no-idle = true\nself-signed = false\nwatermark = 'off'"))
    absent.clear()
    serve.check(of(tmp_path, text))
