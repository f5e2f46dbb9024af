"""server.toml and the two helps of the serve command."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from apps.serve.settings import MATTER, parsed

from apps import cli
from apps.serve import command as serve
from apps.usage import CommandParser
from tests.apps.cli import mistake

Words = list[str]


def parser() -> CommandParser:
    made = CommandParser(prog="glsplat serve")
    serve.add_arguments(made)
    return made


def options() -> set[str]:
    names = {name for action in parser()._actions for name in action.option_strings if name.startswith("--")}
    return {name.removeprefix("--") for name in names}


def of(tmp_path: Path, text: str, *words: str) -> dict[str, object]:
    path = tmp_path / "server.toml"
    path.write_text(text)
    return vars(parsed(parser(), ["--config", str(path), *words]))


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    try:
        assert cli.main(["serve", *words]) == 0
    except SystemExit as stop:
        assert not stop.code
    return capsys.readouterr().out


def test_help_shows_ten_options_and_help_all_every_one(capsys: pytest.CaptureFixture[str]) -> None:
    short, whole = (
        set(re.findall(r"^  (?:-h, )?--([a-z-]+)", printed(capsys, word), re.M)) for word in ("--help", "--help-all")
    )
    assert len(MATTER) == 10 and short == {*MATTER, "help", "help-all", "write-config"}
    assert whole == options() and f"all {len(whole) - 3} options" in printed(capsys, "--help")


def test_every_option_is_in_the_file_that_is_printed_and_read_from_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = printed(capsys, "--write-config")
    assert tomllib.loads(text) == {} and max(map(len, text.splitlines())) <= 100
    assert of(tmp_path, text) == vars(parser().parse_args(["--config", str(tmp_path / "server.toml")]))
    for line in re.findall(r"^#([a-z-]+ = .*)", text, re.M):
        of(tmp_path, line)  # each alone is read
    assert {line.split(" =")[0] for line in re.findall(r"^#([a-z-]+ = )", text, re.M)} == options() - {
        "help", "help-all", "config", "write-config"
    } | {"scene"}  # fmt: skip


def test_the_command_line_wins(tmp_path: Path) -> None:
    text = 'scene = "me.glb"\nport = 9000\nroom = ["a", "b:3"]\norigin = "https://a.example"\nmirror = true\nfps = 45\n'
    text += "insecure = false\nmax-clients = 20\n"
    found = of(tmp_path, text)
    assert (found["scene"], found["port"], found["fps"], found["mirror"]) == ("me.glb", 9000, 45.0, True)
    assert [room.name for room in found["room"]] == ["a", "b"] and found["origin"] == ["https://a.example"]
    assert found["insecure"] is False and found["max_clients"] == 20
    found = of(tmp_path, text, "you.glb", "--port", "8000", "--room", "c", "--no-mirror", "--insecure")
    assert (found["scene"], found["port"], found["mirror"], found["insecure"]) == ("you.glb", 8000, False, True)
    assert [room.name for room in found["room"]] == ["c"] and found["max_clients"] == 20


def test_the_file_of_the_docs_is_read(tmp_path: Path) -> None:
    """The one of docs/deploying.md, "TLS for twenty users"."""
    page = (Path(__file__).parents[3] / "docs" / "deploying.md").read_text(encoding="utf-8")
    (block,) = (one for one in re.findall(r"```toml\n(.*?)```", page, re.S) if "max-clients = 20" in one)
    found = of(tmp_path, re.sub(r"(?m)^scene = .*\n", "", block))
    assert found["max_clients"] == 20 and found["users"] and found["tls_cert"]


def test_what_a_file_cannot_mean(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "server.toml"
    for text, message in (
        ("prot = 1", "there is no option 'prot'; is it port?"),
        ("max_clients = 1", "there is no option 'max_clients'; is it max-clients?"),
        ("config = 'a.toml'", "there is no option 'config'"),
        ("[limits]\nport = 1", "there is no option 'limits'"),
        ("mirror = 1", "mirror needs true or false, not 1"),
        ("port = true", "port needs a text or a number, not true"),
        ("port = [1, 2]", "port needs a text or a number, not [1, 2]"),
        ("room = [['a']]", 'room needs a list of texts, not [["a"]]'),
        ("port = 2026-11-24", 'port needs a text or a number, not "2026-11-24"'),
        ("port =", "this is no TOML"),
        ("port = 'x'", "--port: invalid int value: 'x'"),
        ("solver = 'magic'", "--solver: invalid choice: 'magic'"),
        ("room = 'a:99'", "--room: a room holds 1 to 64 people"),
    ):
        path.write_text(text)
        assert f"server.toml: {message}" in mistake(capsys, "serve", "--config", path)
    path.write_text("port = 99999")  # what no single option tells
    assert "--port needs 0 to 65535" in mistake(capsys, "serve", "--config", path)
    path.write_bytes(b"\xff")
    assert "this is no TOML" in mistake(capsys, "serve", "--config", path)
    assert "none.toml: cannot be read (No such file" in mistake(capsys, "serve", "--config", tmp_path / "none.toml")
