"""What a new user runs first: the search for system libraries, and `make demo` without being root."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests import needs

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "system"
STRANGER = 48_611  # a user that no account has
SYSTEM_PATH = "/usr/local/bin:/usr/bin:/bin"

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
@pytest.mark.parametrize("words", [(), ("test",)])
def test_where_all_is_there_nothing_is_said_or_done(system: Run, tmp_path: Path, uid: int, words: tuple[str]) -> None:
    done = system(*words, uid=uid)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not (tmp_path / "apt").exists()


def test_a_user_is_given_one_line_for_both_commands(system: Run, tmp_path: Path) -> None:
    for words in ((), ("test",)):
        done = system(*words, run="libegl1 libgl1", test="xvfb", browser="chromium npm")
        assert done.returncode == 1 and done.stdout == ""
        explained, line = done.stderr.splitlines()
        assert "enough for make demo and make test" in explained
        assert line == ASKED + "libegl1 libgl1 xvfb chromium npm"
    assert not (tmp_path / "apt").exists()
    # what only the tests want does not keep the demo from running, and is asked for by them
    assert system(test="xvfb").returncode == 0
    assert system("test", test="xvfb").stderr.endswith(ASKED + "xvfb\n")


def test_root_installs_only_what_is_missing_and_wanted(system: Run, tmp_path: Path) -> None:
    done = system(uid=0, run="libegl-mesa0", test="xvfb", browser="chromium")
    assert (done.returncode, done.stdout, done.stderr) == (0, "installing libegl-mesa0\n", "")
    update, install = (tmp_path / "apt").read_text().splitlines()
    assert update == "update -qq" and install == "install -y -qq --no-install-recommends libegl-mesa0"
    (tmp_path / "apt").unlink()
    done = system("test", uid=0, test="xvfb xdotool")
    assert (tmp_path / "apt").read_text().splitlines()[1].endswith(" xvfb xdotool")
    failing = system("test", uid=0, test="xvfb", fails_on="xvfb")
    assert failing.returncode != 0


def test_a_browser_is_installed_but_never_insisted_on(system: Run, tmp_path: Path) -> None:
    done = system("test", browser="chromium npm")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert system(uid=0, browser="chromium").stdout == "" and not (tmp_path / "apt").exists()
    done = system("test", uid=0, run="libegl1", browser="chromium npm")
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    installed = [line.partition("recommends ")[2] for line in (tmp_path / "apt").read_text().splitlines()]
    assert installed == ["", "libegl1", "chromium npm"]
    done = system("test", uid=0, browser="chromium", fails_on="chromium")
    assert done.returncode == 0 and "browser tests will be skipped" in done.stderr


def test_a_system_without_apt(system: Run) -> None:
    done = system("test", run="libegl1", test="xvfb", browser="npm", apt=False)
    assert done.returncode == 1 and done.stderr == (
        "glsplat needs these Debian packages, or what your system calls them: libegl1 xvfb\n"
    )
    assert system("test", uid=0, browser="npm", apt=False).returncode == 0


def test_where_no_bare_machine_can_be_made_ci_says_why_and_tests_this_one(tmp_path: Path) -> None:
    for name, text in (("id", "echo 1000"), ("make", 'echo "make $*"; exit 7'), ("dirname", '/usr/bin/dirname "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    script = ["/bin/bash", ROOT / ".ci" / "run"]
    done = subprocess.run(script, env={"PATH": str(tmp_path)}, capture_output=True, text=True, timeout=60)
    assert done.returncode == 7, done.stderr  # the suite's own
    assert done.stdout == "no bare machine can be made here (only root can): make test on this one\nmake test\n"


def test_an_old_or_missing_python_is_one_line(tmp_path: Path) -> None:
    for python in ("/bin/false", str(tmp_path / "nosuch")):
        variables = {"PATH": os.environ["PATH"], "PYTHON": python}
        done = subprocess.run(["sh", SCRIPT], env=variables, capture_output=True, text=True, timeout=60)
        assert done.returncode == 1 and "needs Python 3.11" in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.fixture
def stranger() -> Iterator[Run]:
    """Runs commands as a user without an account or rights, in a clone of the checkout that belongs to that user."""
    needs.require("setpriv")
    if not (ROOT / ".git").exists():
        pytest.skip("needs a checkout, to clone it")
    # not tmp_path: its parents are root's alone
    home = Path(tempfile.mkdtemp(prefix="glsplat-stranger-", dir="/tmp"))
    home.chmod(0o755)
    (home / ".gitconfig").write_text("[safe]\n\tdirectory = *\n")  # a checkout may belong to somebody else than root
    clone = ["git", "clone", "--quiet", "--depth", "1", f"file://{ROOT}", str(home / "glsplat")]
    subprocess.run(clone, env={**os.environ, "HOME": str(home)}, check=True, capture_output=True, timeout=60)
    subprocess.run(["chown", "-R", f"{STRANGER}:{STRANGER}", home], check=True)
    # how this machine reaches a package index is everybody's; all else is the user's own
    shared = {k: v for k, v in os.environ.items() if k.startswith(("PIP_", "SSL_")) or k.lower().endswith("_proxy")}
    become = ["setpriv", f"--reuid={STRANGER}", f"--regid={STRANGER}", "--clear-groups"]

    def run(*command: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*become, *command],
            cwd=home / "glsplat",
            env={**shared, "HOME": str(home), "PATH": SYSTEM_PATH, "LANG": "C.UTF-8"},
            capture_output=True,
            text=True,
            timeout=timeout,
        )

    yield run
    shutil.rmtree(home, ignore_errors=True)


def _needs_a_python_for_everybody(run: Run) -> None:
    if run("python3", "-c", "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))").returncode:
        pytest.skip(f"no Python 3.11 with venv that every user can run in {SYSTEM_PATH}")


@pytest.mark.root
def test_a_user_without_rights_finds_what_is_installed(stranger: Run) -> None:
    _needs_a_python_for_everybody(stranger)
    assert stranger("id", "-u").stdout.strip() == str(STRANGER)
    done = stranger(".ci/system")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.gl
@pytest.mark.root
@pytest.mark.slow
def test_a_user_without_rights_runs_the_demo(stranger: Run) -> None:
    _needs_a_python_for_everybody(stranger)
    done = stranger("make", "demo", "DEMO=--seconds 1 --sizes 128x128", timeout=280)
    if done.returncode and any(word in done.stderr for word in ("NewConnectionError", "No matching distribution")):
        pytest.skip(f"no package index within reach: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr[-2000:]
    assert "out/demo/contact_sheet.png" in done.stdout


def test_hosted_ci_runs_what_everybody_runs() -> None:
    """The workflow has no list of steps of its own: what has to hold stands in .ci/run and the Makefile."""
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    steps = re.findall(r"(?m)^      - run: (.*)$", text)
    assert ".ci/run" in steps and steps.index("sudo .ci/system test") < steps.index(".ci/run")
    targets = re.findall(r"(?m)^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"))
    for step in steps:
        program, *words = step.removeprefix("sudo ").split()
        assert (program == "make" and set(words) <= set(targets)) or os.access(ROOT / program, os.X_OK), step
