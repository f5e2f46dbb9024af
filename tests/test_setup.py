"""What a new user runs first: the search for system libraries, and `make demo` without being root."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "system"
STRANGER = 48_611  # a user that no account has
SYSTEM_PATH = "/usr/local/bin:/usr/bin:/bin"

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def system(tmp_path: Path) -> Run:
    """Runs the script as root or not, with vendor folders and programs of the test's own; apt-get only takes notes."""
    programs = tmp_path / "bin"
    programs.mkdir()
    notes = tmp_path / "apt"

    def run(
        *words: str, uid: int = 1000, folders: tuple[Path, ...] = (), fails_on: str = "nothing", **more: str
    ) -> subprocess.CompletedProcess[str]:
        take_notes = f'echo "$@" >> {notes}; case "$*" in *{fails_on}*) exit 100;; esac'
        for name, text in (("id", f"echo {uid}"), ("apt-get", take_notes)):
            (programs / name).write_text(f"#!/bin/sh\n{text}\n")
            (programs / name).chmod(0o755)
        variables = {"PATH": f"{programs}:{os.environ['PATH']}", "HOME": str(tmp_path), "PYTHON": sys.executable}
        variables |= more
        if folders:
            variables["__EGL_VENDOR_LIBRARY_DIRS"] = ":".join(map(str, folders))
        return subprocess.run(["sh", SCRIPT, *words], env=variables, capture_output=True, text=True, timeout=60)

    return run


@pytest.mark.parametrize("first", ["absent", "empty", "full"])
@pytest.mark.parametrize("second", ["absent", "empty", "full"])
def test_a_driver_in_either_folder_is_enough(system: Run, tmp_path: Path, first: str, second: str) -> None:
    folders = []
    for name, state in (("usr share", first), ("etc", second)):
        folder = tmp_path / name
        folders.append(folder)
        if state != "absent":
            folder.mkdir()
        if state == "full":
            (folder / "50_mesa.json").write_text("{}")
    done = system("test", folders=tuple(folders))
    if "full" in (first, second):
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    else:
        assert done.returncode == 1
        line = done.stderr.splitlines()[-1].strip()
        expected = "sudo apt-get update && sudo apt-get install -y --no-install-recommends libegl-mesa0"
        assert line == expected and len(done.stderr.splitlines()) == 2


def test_root_installs_only_what_is_missing(system: Run, tmp_path: Path) -> None:
    assert system("test", uid=0).stdout == ""
    assert not (tmp_path / "apt").exists()
    done = system(uid=0, folders=(tmp_path / "none",))
    assert done.returncode == 0, done.stderr
    *_, install = (tmp_path / "apt").read_text().splitlines()
    assert install == "install -y -qq --no-install-recommends libegl-mesa0"


def test_a_browser_is_installed_but_never_insisted_on(system: Run, tmp_path: Path) -> None:
    missing = {"CHROMIUM": "no-such-browser"}
    done = system("test", **missing)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    done = system("test", folders=(tmp_path / "none",), **missing)
    assert done.returncode == 1 and done.stderr.rstrip().endswith(" libegl-mesa0 chromium")
    assert system(uid=0, **missing).stdout == "" and not (tmp_path / "apt").exists()
    done = system("test", uid=0, folders=(tmp_path / "none",), **missing)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    installed = [line.rpartition(" ")[2] for line in (tmp_path / "apt").read_text().splitlines()]
    assert installed == ["-qq", "libegl-mesa0", "chromium"]
    done = system("test", uid=0, fails_on="chromium", **missing)
    assert done.returncode == 0 and "browser tests will be skipped" in done.stderr


def test_an_old_or_missing_python_is_one_line(tmp_path: Path) -> None:
    for python in ("/bin/false", str(tmp_path / "nosuch")):
        variables = {"PATH": os.environ["PATH"], "PYTHON": python}
        done = subprocess.run(["sh", SCRIPT], env=variables, capture_output=True, text=True, timeout=60)
        assert done.returncode == 1 and "needs Python 3.11" in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.fixture
def stranger() -> Iterator[Run]:
    """Runs commands as a user without an account or rights, in a clone of the checkout that belongs to that user."""
    if os.getuid() != 0:
        pytest.skip("only root can become another user")
    if shutil.which("setpriv") is None or shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("needs setpriv (util-linux), git, and a checkout")
    # not tmp_path: its parents are root's alone
    home = Path(tempfile.mkdtemp(prefix="glsplat-stranger-", dir="/tmp"))
    home.chmod(0o755)
    (home / ".gitconfig").write_text("[safe]\n\tdirectory = *\n")  # a checkout may belong to somebody else than root
    clone = ["git", "clone", "--quiet", "--no-local", f"file://{ROOT}", str(home / "glsplat")]
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


def test_a_user_without_rights_finds_what_is_installed(stranger: Run) -> None:
    _needs_a_python_for_everybody(stranger)
    assert stranger("id", "-u").stdout.strip() == str(STRANGER)
    done = stranger(".ci/system", "test")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.gl
@pytest.mark.slow
def test_a_user_without_rights_runs_the_demo(stranger: Run) -> None:
    _needs_a_python_for_everybody(stranger)
    done = stranger("make", "demo", "DEMO=--seconds 1 --sizes 128x128", timeout=280)
    if done.returncode and any(word in done.stderr for word in ("NewConnectionError", "No matching distribution")):
        pytest.skip(f"no package index within reach: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr[-2000:]
    assert "out/demo/contact_sheet.png" in done.stdout
