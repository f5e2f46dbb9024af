"""What the tests need of the system stands in one table, which the set-up script and README follow."""

from __future__ import annotations

import ast
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
TIERS = ("run", "check", "browser", "extra")
# of every Debian, of the README's first sentence, or names of files that the tests made themselves
EVERYWHERE = {"/bin/bash", "/bin/sh", "sh", "bash", "chown", "chroot", "git", "make", "mount", "umount"}


def packages(tier: str) -> list[str]:
    return [package for need in NEEDS.values() if need.tier == tier for package in need.packages]


def named(tree: ast.AST) -> tuple[set[str], set[str], set[str]]:
    """(libraries, programs, searches) that a test module names: CDLL("x"), subprocess.run(["x", ...]), which, ..."""
    libraries, programs, searches = set(), set(), set()
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        first = call.args[0] if call.args else None
        if name == "CDLL" and isinstance(first, ast.Constant) and first.value:
            libraries.add(first.value)
        elif name in ("which", "find_library"):
            searches.add(f"{name}() in line {call.lineno}")
    starts = [
        call.args[0]
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and ast.unparse(call.func).startswith("subprocess.") and call.args
    ]
    variables = {start.id for start in starts if isinstance(start, ast.Name)}
    starts += [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and {getattr(target, "id", "") for target in node.targets} & variables
    ]
    for start in starts:
        match start:
            case ast.List(elts=[ast.Constant(value=str(name)), *_]) if not name.startswith("-"):
                programs.add(name)
    return libraries, programs, searches


def offences(source: str) -> list[str]:
    """What a module of tests wants of the system that no row of the table has, or that it does not ask for."""
    libraries, programs, searches = named(ast.parse(source))
    asked = set(re.findall(r'"(\w+)"', " ".join(re.findall(r"(?:require|program|met)\(([^)]*)\)", source))))
    found = [f"{search}: ask tests.needs" for search in sorted(searches)]
    for kind, wanted in (("libraries", libraries), ("programs", programs - EVERYWHERE)):
        for thing in sorted(wanted):
            rows = {name for name, need in NEEDS.items() if thing in getattr(need, kind)}
            if not rows:
                found.append(f"{thing}: no row in tests/needs.py")
            elif not rows & asked and all(NEEDS[row].tier != "run" for row in rows):
                found.append(f'{thing}: never asked for; needs.require("{min(rows)}")')
    return found


def test_what_tests_want_of_the_system_is_in_the_table() -> None:
    found = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        if path.name not in ("needs.py", "test_needs.py") and path.parent.name != "scripts":  # those run by hand
            found += [f"{path.relative_to(ROOT)}: {offence}" for offence in offences(path.read_text(encoding="utf-8"))]
    assert found == []


def test_the_rule_finds_what_is_new() -> None:
    for new, words in (
        ('shutil.which("convert")', "ask tests.needs"),
        ('ctypes.CDLL("libnew.so.1")', "no row"),
        ('subprocess.run(["convert", "-version"])', "no row"),
        ('ctypes.CDLL("libOpenGL.so.0")', 'needs.require("opengl")'),
        ('subprocess.run(["Xvfb", "-displayfd", "3"])', 'needs.require("xvfb")'),
    ):
        (one,) = offences(new)
        assert words in one
    assert offences('ctypes.CDLL("libEGL.so.1")') == []


def test_rows_are_whole() -> None:
    for name, need in NEEDS.items():
        assert need.tier in TIERS and need.packages and need.what, name
        assert need.libraries or need.programs or need.modules or name == "driver", name


def test_readme_and_docs_ask_for_what_drawing_needs() -> None:
    drawing = packages("run")
    lines = [
        line.split()
        for file in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
        for line in re.findall(r"--no-install-recommends ([^`#|&]*libegl1[^`#|&]*)", file.read_text())
    ]
    assert lines and all(line == drawing for line in lines)


def test_probes_try_the_thing_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = tmp_path / "libnot.so.1"
    listed.write_text("no library")
    assert not Need("", ("x",), "check", libraries=(str(listed),)).met()
    assert Need("", ("x",), "check", libraries=(str(listed), "libc.so.6")).met()
    monkeypatch.setenv("PATH", str(tmp_path))
    for name, text, starts in (("well", "exit 0", True), ("broken", "exit 127", False)):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        assert not Need("", ("x",), "check", programs=(name,)).met()  # may not be run
        (tmp_path / name).chmod(0o755)
        assert Need("", ("x",), "check", programs=(name,)).met() is starts
    assert not Need("", ("x",), "check", modules=("json", "no_such_module")).met()


def test_what_is_missing_and_the_reason_of_a_skip(monkeypatch: pytest.MonkeyPatch) -> None:
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
    def lacking(**more: str) -> str:
        command = [sys.executable, ROOT / "tests" / "needs.py", "run"]
        done = subprocess.run(command, env=os.environ | more, capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.strip()

    assert lacking() == ""
    assert lacking(__EGL_VENDOR_LIBRARY_DIRS=str(tmp_path)) == "libegl-mesa0 libgl1-mesa-dri"
