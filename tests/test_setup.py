"""The search for system libraries, which a new user runs first, and what CI does where it is not root."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "system"

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def system(tmp_path: Path) -> Run:
    """Runs the script in a world of the test's own: who one is, what is missing, an apt-get that takes notes.

    Nothing else is on the PATH, so what this machine has does not matter. ``lacks``: the packages that are missing, a
    tier each; what apt-get installs is missing no more. ``apt``: without it the system is not Debian.
    """
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


ASKED = "    sudo apt-get update && sudo apt-get install -y --no-install-recommends "


@pytest.mark.parametrize("uid", [0, 1000])
@pytest.mark.parametrize("words", [(), ("check",)])
def test_where_all_is_there_nothing_is_said_or_done(system: Run, tmp_path: Path, uid: int, words: tuple[str]) -> None:
    done = system(*words, uid=uid)
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


def test_root_installs_only_what_is_missing_and_wanted(system: Run, tmp_path: Path) -> None:
    done = system(uid=0, run="libegl-mesa0", check="xvfb", browser="chromium")
    assert (done.returncode, done.stdout, done.stderr) == (0, "installing libegl-mesa0\n", "")
    update, install = (tmp_path / "apt").read_text().splitlines()
    assert update == "update -qq" and install == "install -y -qq --no-install-recommends libegl-mesa0"
    (tmp_path / "apt").unlink()
    done = system("check", uid=0, check="xvfb xdotool")
    assert (tmp_path / "apt").read_text().splitlines()[1].endswith(" xvfb xdotool")
    failing = system("check", uid=0, check="xvfb", fails_on="xvfb")
    assert failing.returncode != 0


def test_a_browser_is_installed_but_never_insisted_on(system: Run, tmp_path: Path) -> None:
    done = system("check", browser="chromium npm")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert system(uid=0, browser="chromium").stdout == "" and not (tmp_path / "apt").exists()
    done = system("check", uid=0, run="libegl1", browser="chromium npm")
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    installed = [line.partition("recommends ")[2] for line in (tmp_path / "apt").read_text().splitlines()]
    assert installed == ["", "libegl1", "chromium npm"]
    done = system("check", uid=0, browser="chromium", fails_on="chromium")
    assert done.returncode == 0 and "browser tests will be skipped" in done.stderr


def test_a_system_without_apt(system: Run) -> None:
    done = system("check", run="libegl1", check="xvfb", browser="npm", apt=False)
    assert done.returncode == 1 and done.stderr == (
        "glsplat needs these Debian packages, or what your system calls them: libegl1 xvfb\n"
    )
    assert system("check", uid=0, browser="npm", apt=False).returncode == 0


def test_where_no_bare_machine_can_be_made_ci_says_why_and_tests_this_one(tmp_path: Path) -> None:
    for name, text in (("id", "echo 1000"), ("make", 'echo "make $*"; exit 7'), ("dirname", '/usr/bin/dirname "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    script = ["/bin/bash", ROOT / ".ci" / "run"]
    done = subprocess.run(script, env={"PATH": str(tmp_path)}, capture_output=True, text=True, timeout=60)
    assert done.returncode == 7, done.stderr  # the suite's own
    why, *targets = done.stdout.splitlines()
    assert "(only root can)" in why and targets == ["make test"]  # check would follow a make test that passes


def test_an_old_or_missing_python_is_one_line(tmp_path: Path) -> None:
    for python in ("/bin/false", str(tmp_path / "nosuch")):
        variables = {"PATH": os.environ["PATH"], "PYTHON": python}
        done = subprocess.run(["sh", SCRIPT], env=variables, capture_output=True, text=True, timeout=60)
        assert done.returncode == 1 and "needs Python 3.11" in done.stderr and len(done.stderr.splitlines()) == 1


def test_hosted_ci_runs_what_everybody_runs() -> None:
    """The workflow has no list of steps of its own: what has to hold stands in .ci/run and the Makefile."""
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    steps = re.findall(r"(?m)^      - run: (.*)$", text)
    assert ".ci/run" in steps and steps.index("sudo .ci/system check") < steps.index(".ci/run")
    targets = re.findall(r"(?m)^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"))
    for step in steps:
        program, *words = step.removeprefix("sudo ").split()
        assert (program == "make" and set(words) <= set(targets)) or os.access(ROOT / program, os.X_OK), step
