"""Delete an extra from a copy of the repository and check that the rest still works.

    python -m tools.without_extra rooms speech     # each in turn; --all: each extra; --core: all of them at once
    python -m tools.without_extra rooms --tests    # and all remaining tests but the checks

Also deleted are the extras that require it (REQUIRES in their ``__init__``), their lines in pyproject.toml and their
tests: ``tests/extras/NAME``, other test files that import them, and tests marked ``@pytest.mark.extra(name=NAME)``.
The program then checks all remaining modules, all commands, a picture, and tests/test_layers.py. Exit code 1 if one
fails.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# arguments: the deleted extras. A module may need a package that is not installed, and one of apps a deleted extra.
MODULES = """
import sys
from importlib import import_module
from pathlib import Path
import glsplat
from glsplat.optional import MissingPackageError, absent_extra

assert Path(glsplat.__file__).is_relative_to(Path.cwd()), glsplat.__file__
gone, imported, needy, faults = sys.argv[1:], 0, [], []
for path in sorted([*Path("glsplat").rglob("*.py"), *Path("apps").rglob("*.py")]):
    name = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
    try:
        import_module(name)
        imported += 1
    except MissingPackageError:
        pass
    except ModuleNotFoundError as error:
        extra = absent_extra(error)
        if name.startswith("apps") and extra is not None and extra.split(".")[-1] in gone:
            needy.append(name)
        elif (error.name or "").startswith(("glsplat", "apps")):
            faults.append(f"{name}: {error}")
print(f"{imported} modules imported, {len(needy)} of apps need a deleted extra")
sys.exit("\\n".join(faults) or 0)
"""

COMMANDS = """
import contextlib, io, sys
from apps.cli import COMMANDS, main

gone, absent, faults = sys.argv[1:], [], []
lines = {name: {f"glsplat {name} needs glsplat.extras.{extra}, which is not installed\\n" for extra in gone}
         for name in COMMANDS}
for words in ([], *([name] for name in COMMANDS)):
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(out):
            code = main([*words, "--help"])
    except SystemExit as end:
        code = end.code
    except Exception as error:
        code = repr(error)
    if words and code == 1 and out.getvalue() in lines[words[0]]:
        absent.append(words[0])
    elif code != 0:
        faults.append(f"glsplat {' '.join(words)} --help: {code} {out.getvalue()}")
print("commands that name a deleted extra:", ", ".join(absent) or "none")
if main(["render", "--motion", "walk", "--frame", "5", "--stereo", "--size", "64x64", "-o", "pair.png"]):
    faults.append("glsplat render failed")
sys.exit("\\n".join(faults) or 0)
"""


def main() -> int:
    """Check without each extra that the command line names."""
    required = requirements(ROOT)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="an extra, a folder of glsplat/extras")
    parser.add_argument("--all", action="store_true", help="each extra in turn")
    parser.add_argument("--core", action="store_true", help="without all extras at once")
    parser.add_argument("--tests", nargs="*", metavar="PATH", help="run the remaining tests, or those in PATH, too")
    args = parser.parse_args()
    names = sorted(required) if args.all or args.core else args.names
    if not names or set(names) - set(required):
        parser.error(f"name one of {', '.join(sorted(required))}, or --all or --core")
    tests = ["tests/test_layers.py"] if args.tests is None else args.tests or ["tests"]
    deleted = [names] if args.core else [with_dependents(name, required) for name in names]
    return int(not all([check(gone, tests) for gone in deleted]))  # a list, so that all run


def requirements(root: Path) -> dict[str, tuple[str, ...]]:
    """Return the extras that each extra requires, from REQUIRES of its ``__init__``, which is not imported."""
    return {
        file.parent.name: ast.literal_eval(node.value)
        for file in sorted(root.glob("glsplat/extras/*/__init__.py"))
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "REQUIRES"
    }


def with_dependents(name: str, required: dict[str, tuple[str, ...]]) -> list[str]:
    """Return ``name`` and the extras that require it, directly or not."""
    gone = {name}
    while more := {one for one, others in required.items() if gone & {*others}} - gone:
        gone |= more
    return [name, *sorted(gone - {name})]


def check(gone: list[str], tests: list[str]) -> bool:
    """Print failures without the extras ``gone``; return whether there are none. ``tests``: files or folders."""
    print(f"== without {', '.join(gone)}", flush=True)
    with tempfile.TemporaryDirectory(prefix="glsplat-without-") as folder:
        copy = Path(folder) / "repository"
        _copy(copy)
        print(f"{_delete(copy, gone)} files of other folders of tests import them and are deleted")
        marks = " and ".join(["not check", *(f"not extra(name='{name}')" for name in gone)])
        pytest = ["-m", "pytest", "-p", "xdist", "-p", "timeout", "-q", "-n", "2", "-m", marks, *tests]
        steps = [["-c", MODULES, *gone], ["-c", COMMANDS, *gone], pytest]
        good = [_run(copy, step) for step in steps]
    print(f"== without {gone[0]}: {'good' if all(good) else 'FAILED'}", flush=True)
    return all(good)


def _copy(to: Path) -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():  # the index may list deleted files
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, to / name)


def _delete(copy: Path, gone: list[str]) -> int:
    """Delete the extras, their lines in pyproject.toml and their tests; return the number of other test files."""
    for name in gone:
        shutil.rmtree(copy / "glsplat" / "extras" / name)
        shutil.rmtree(copy / "tests" / "extras" / name, ignore_errors=True)
    names = "|".join(gone)
    setup = copy / "pyproject.toml"
    setup.write_text(re.sub(rf'(?m)^ *"glsplat\.extras\.({names})[".].*\n', "", setup.read_text(encoding="utf-8")))
    absent, count = rf"(glsplat|tests)\.extras\.({names})", 0
    while files := [file for file in sorted((copy / "tests").rglob("*.py")) if _imports(file, absent)]:
        for file in files:
            file.unlink()
        count += len(files)  # next, delete tests that import one of them
        absent = "|".join(re.escape(".".join(file.relative_to(copy).with_suffix("").parts)) for file in files)
    return count


def _imports(file: Path, modules: str) -> bool:
    """Return whether a test file imports one of ``modules``, except within functions of a conftest.py."""
    indent = "" if file.name == "conftest.py" else " *"
    return re.search(rf"(?m)^{indent}(from|import) ({modules})\b", file.read_text(encoding="utf-8")) is not None


def _run(copy: Path, arguments: list[str]) -> bool:
    """Run Python with the copy and the installed packages, without the paths of an editable install."""
    paths = [str(copy), *(path for path in sys.path if path.endswith("site-packages"))]
    variables = os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",  # base installation's plugins
    }
    command = [os.path.realpath(sys.executable), *arguments]
    return subprocess.run(command, cwd=copy, env=variables).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
