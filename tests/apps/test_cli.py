"""The list of commands: grouped as the site is, and what ``glsplat`` alone says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from apps import cli

ROOT = Path(__file__).resolve().parents[2]


def test_help_groups_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--help"])
    said = capsys.readouterr().out
    found: dict[str, list[str]] = {}
    for line in said.splitlines():
        if (head := re.fullmatch(r"([A-Z][a-z ]+):", line)) and head[1] in cli.GROUPS:
            found[head[1]] = []
        elif found and (name := re.match(r"  (\w+) +\S", line)):
            list(found.values())[-1].append(name[1])
    assert tuple(found) == cli.GROUPS and all(found.values())
    assert sorted(name for names in found.values() for name in names) == sorted(cli.COMMANDS)
    assert all(cli.COMMANDS[name].group == group for group, names in found.items() for name in names)


def test_what_it_says_next_is_understood(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Alone it prints three command lines, each of which its command takes."""
    assert cli.main([]) == 0
    assert len(re.findall(r"(?m)^  glsplat (\w+)", capsys.readouterr().out)) == 3
    for line in re.findall(r"(?m)^  glsplat (.*?)  ", cli.NEXT):
        command, *words = line.split()
        module = cli.import_module(f"apps.{cli.MODULES.get(command, command)}")
        taken = []
        monkeypatch.setattr(module, "run", lambda args, taken=taken: taken.append(args) or 0)
        assert cli.main([command, *words]) == 0 and len(taken) == 1


def test_a_full_disk_is_one_line() -> None:
    code = "import sys; from apps.cli import main; sys.exit(main([]))"
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 1 and done.stderr == "glsplat: No space left on device\n"
