"""The flags of the serve command and its server.toml."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from apps import cli
from apps.serve import command as serve
from apps.serve.options import ServeOptions, parsed
from apps.usage import CommandParser
from tests.apps.cli import mistake

Words = list[str]


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
    assert flags <= {one.name.replace("_", "-") for one in fields(ServeOptions)} | {"help", "config", "write-config"}
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
    assert listed == [one.name.replace("_", "-") for one in fields(ServeOptions)]


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
def test_what_a_file_cannot_mean(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "server.toml"
    for text, message in (
        ("prot = 1", "expected an option of glsplat serve, got 'prot'; is it port?"),
        ("max_clients = 1", "expected an option of glsplat serve, got 'max_clients'; is it max-clients?"),
        ("config = 'a.toml'", "expected an option of glsplat serve, got 'config'"),
        ("[limits]\nport = 1", "expected an option of glsplat serve, got 'limits'"),
        ("mirror = 1", "mirror: needs true or false, not 1"),
        ("port = true", "port: needs a text or a number, not true"),
        ("port = [1, 2]", "port: needs a text or a number, not [1, 2]"),
        ("room = [['a']]", 'room: needs a list of texts, not [["a"]]'),
        ("port = 2026-11-24", 'port: needs a text or a number, not "2026-11-24"'),
        ("port =", "this is no TOML"),
        ("port = 'x'", "port: needs a whole number of 0 to 65535, not x"),
        ("solver = 'magic'", "solver: needs one of learned, analytic, not 'magic'"),
        ("room = 'a:99'", "room: a room holds 1 to 64 people"),
    ):
        path.write_text(text)
        assert f"server.toml: {message}" in mistake(capsys, "serve", "--config", path)
    path.write_text("max-size = 64\nsize = 128")  # what no single option tells
    assert "--size needs at most 64 a side" in mistake(capsys, "serve", "--config", path)
    path.write_bytes(b"\xff")
    assert "this is no TOML" in mistake(capsys, "serve", "--config", path)
    assert "none.toml: cannot be read (No such file" in mistake(capsys, "serve", "--config", tmp_path / "none.toml")
