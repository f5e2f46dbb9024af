"""The table of what tests need of the system: its probes, its skips, and the lines of README and docs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import needs
from tests.needs import NEEDS, Need

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]


def test_readme_and_docs_ask_for_the_packages_of_the_table() -> None:
    packages = [package for need in NEEDS.values() if need.tier == "run" for package in need.packages]
    lines = [
        line.split()
        for file in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
        for line in re.findall(r"--no-install-recommends ([^`#|&]*libegl1[^`#|&]*)", file.read_text())
    ]
    assert lines and all(line == packages for line in lines)


def test_probes_try_the_thing_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = tmp_path / "libnot.so.1"
    listed.write_text("no library")
    assert not Need("", ("x",), "check", libraries=(str(listed),)).met()
    assert Need("", ("x",), "check", libraries=(str(listed), "libc.so.6")).met()
    monkeypatch.setenv("PATH", str(tmp_path))
    for name, text, starts in (("well", "exit 0", True), ("broken", "exit 127", False)):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        assert not Need("", ("x",), "check", programs=(name,)).met()  # not executable
        (tmp_path / name).chmod(0o755)
        assert Need("", ("x",), "check", programs=(name,)).met() is starts
    assert not Need("", ("x",), "check", modules=("json", "no_such_module")).met()


def test_missing_packages_and_the_reason_of_a_skip(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {
        "a": Need("an A", ("a1", "a2"), "check", modules=("no_such_a",)),
        "b": Need("a B", ("b",), "check", modules=("json",)),
        "c": Need("a C", ("c",), "browser", modules=("no_such_c",)),
    }
    monkeypatch.setattr(needs, "NEEDS", rows)
    monkeypatch.delenv("GLSPLAT_NEEDS", raising=False)
    needs.met.cache_clear()
    try:
        assert needs.missing("check") == ["a1", "a2"] and needs.missing("browser") == ["c"]
        needs.require("b")
        with pytest.raises(pytest.skip.Exception, match=r"^no an A, a C here: apt-get install a1 a2 c$"):
            needs.require("a", "b", "c")
        monkeypatch.setenv("GLSPLAT_NEEDS", "all")
        with pytest.raises(pytest.fail.Exception, match="apt-get install c"):
            needs.require("c")
    finally:
        needs.met.cache_clear()


@pytest.mark.gl
def test_egl_without_a_driver_is_found_out(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "tests" / "needs.py"), "run"]
    variables = os.environ | {"__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path)}
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "libegl-mesa0 libgl1-mesa-dri\n")
