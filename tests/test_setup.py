"""The search for system libraries, which a new user runs first, and what CI does where it is not root."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "system"
ASKED = "    sudo apt-get update && sudo apt-get install -y --no-install-recommends "

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def system(tmp_path: Path) -> Run:
    """Run the script with a PATH of its own: a user id, missing packages by tier, an apt-get that takes notes."""
    world = tmp_path / "world"
    world.mkdir()
    (world / "dirname").symlink_to("/usr/bin/dirname")
    notes = tmp_path / "apt"

    def run(
        *words: str, uid: int = 1000, fails_on: str = "nothing", apt: bool = True, **lacks: str
    ) -> subprocess.CompletedProcess[str]:
        answers = "".join(f"{tier}) echo {packages};;" for tier, packages in lacks.items())
        scripts = {
            "id": f"echo {uid}",
            "python": f'case "$1" in -c) exec {sys.executable} "$@";; *needs.py) case "$2" in {answers} esac;; esac',
            "apt-get": f'echo "$@" >> {notes}; case "$*" in *{fails_on}*) exit 100;; esac' if apt else None,
        }
        for name, text in scripts.items():
            if text is not None:
                (world / name).write_text(f"#!/bin/sh\n{text}\n")
                (world / name).chmod(0o755)
        variables = {"PATH": str(world), "PYTHON": "python"}
        return subprocess.run(["/bin/sh", SCRIPT, *words], env=variables, capture_output=True, text=True, timeout=60)

    return run


@pytest.mark.parametrize("uid", [0, 1000])
def test_nothing_is_done_where_nothing_is_missing(system: Run, tmp_path: Path, uid: int) -> None:
    done = system("check", uid=uid)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not (tmp_path / "apt").exists()


def test_a_user_is_given_one_line_for_each_command(system: Run, tmp_path: Path) -> None:
    for words, asked, line in (
        ((), "make demo and make test", "libegl1"),
        (("check",), "make check", "libegl1 xvfb npm"),
    ):
        done = system(*words, run="libegl1", check="xvfb", browser="npm")
        assert done.returncode == 1 and done.stdout == ""
        assert f"(enough for {asked})" in done.stderr and done.stderr.endswith(f"{ASKED}{line}\n")
    assert not (tmp_path / "apt").exists()
    assert system(check="xvfb").returncode == 0  # demo and test run without it
    assert system("check", browser="chromium npm").returncode == 0  # a browser is never insisted on


def test_root_installs_what_is_missing_and_wanted(system: Run, tmp_path: Path) -> None:
    done = system(uid=0, run="libegl-mesa0", check="xvfb", browser="chromium")
    assert (done.returncode, done.stdout, done.stderr) == (0, "installing libegl-mesa0\n", "")
    update, install = (tmp_path / "apt").read_text().splitlines()
    assert update == "update -qq" and install == "install -y -qq --no-install-recommends libegl-mesa0"
    assert system("check", uid=0, check="xvfb", fails_on="xvfb").returncode != 0
    done = system("check", uid=0, browser="chromium", fails_on="chromium")
    assert done.returncode == 0 and "browser tests will be skipped" in done.stderr


def test_a_system_without_apt(system: Run) -> None:
    done = system("check", run="libegl1", check="xvfb", browser="npm", apt=False)
    assert done.returncode == 1 and done.stderr.endswith("libegl1 xvfb\n")
    assert system("check", uid=0, browser="npm", apt=False).returncode == 0


def test_an_old_or_missing_python_is_one_line(tmp_path: Path) -> None:
    for python in ("/bin/false", str(tmp_path / "nosuch")):
        variables = {"PATH": os.environ["PATH"], "PYTHON": python}
        done = subprocess.run(["sh", SCRIPT], env=variables, capture_output=True, text=True, timeout=60)
        assert done.returncode == 1 and "needs Python 3.11" in done.stderr and len(done.stderr.splitlines()) == 1


def test_without_root_ci_tests_this_machine(tmp_path: Path) -> None:
    for name, text in (("id", "echo 1000"), ("make", 'echo "make $*"; exit 7'), ("dirname", '/usr/bin/dirname "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    script = ["/bin/bash", str(ROOT / ".ci" / "run")]
    done = subprocess.run(script, env={"PATH": str(tmp_path)}, capture_output=True, text=True, timeout=60)
    assert done.returncode == 7, done.stderr  # the suite's own
    why, *targets = done.stdout.splitlines()
    assert "(only root can)" in why and targets == ["make test"]  # check would follow a make test that passes
