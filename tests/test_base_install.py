"""The base install: the core's commands run without the packages of pip extras, and what needs one says so."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
import urllib.request
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
HIDDEN = ("scipy", "av", "tqdm", "cryptography", "segno", "backports")

HIDING = f"""
import importlib.abc, sys

class Refusing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {HIDDEN}:
            raise ModuleNotFoundError(f"hidden: {{name}}", name=name)

sys.meta_path.insert(0, Refusing())
"""
COMMAND = HIDING + "from apps.cli import main\nsys.exit(main(sys.argv[1:]))"

SERVER = "needs cryptography: pip install 'glsplat[server]'"


def command(*words: str, **options: str) -> subprocess.CompletedProcess[str]:
    """Run a command of glsplat with those packages hidden."""
    line = [sys.executable, "-c", COMMAND, *words]
    return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=200, **options)


def test_there_are_ten_dependencies_and_each_extra_is_installable() -> None:
    assert len(PROJECT["dependencies"]) <= 10
    extras = PROJECT["optional-dependencies"]
    named = [
        part for each in extras.values() for one in each if one.startswith("glsplat[") for part in one[8:-1].split(",")
    ]
    assert named and set(named) <= set(extras)


@pytest.mark.gl
@pytest.mark.parametrize("words", ["render --motion walk --frame 5 --size 64x64 -o {folder}/a.png", "inspect anna"])
def test_the_core_runs_without_them(words: str, tmp_path: Path) -> None:
    done = command(*words.format(folder=tmp_path).split())
    assert done.returncode == 0, done.stderr


@pytest.mark.gl
def test_the_demo_runs_without_them(tmp_path: Path) -> None:
    done = command("demo", "--seconds", "1", "--sizes", "64x64", "-o", str(tmp_path))
    assert done.returncode == 0, done.stderr


@pytest.mark.gl
def test_a_server_runs_without_them() -> None:
    line = [sys.executable, "-c", COMMAND, "serve", "--port", "0", "--json", "--size", "64"]
    with subprocess.Popen(line, cwd=ROOT, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            url = json.loads(server.stdout.readline())["page"].removesuffix("/vr")
            with urllib.request.urlopen(f"{url}/", timeout=60) as answer:
                assert answer.status == 200
        finally:
            server.terminate()
    assert server.returncode == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        *(
            pytest.param(
                words,
                "making avatars needs scipy: pip install 'glsplat[authoring]'",
                marks=pytest.mark.extra(name="authoring"),
            )
            for words in ("avatar photo me.jpg -o me.glb", "models list")
        ),
        ("study power --help", "the analysis of a study needs scipy: pip install 'glsplat[study]'"),
        pytest.param(
            "render --speech tests/extras/speech/data/balloon.wav -o {folder}/out.mp4",
            "sound in an .mp4 needs av: pip install 'glsplat[video]', or give a .webm, which stays silent",
            marks=pytest.mark.extra(name="speech"),
        ),
        ("serve --self-signed --port 0", f"--self-signed {SERVER}, or give tls-cert and tls-key"),
        ("avatar consent --new-key {folder}/key", f"a key that signs consent {SERVER}"),
    ],
)
def test_a_line_says_what_to_install(words: str, line: str, tmp_path: Path) -> None:
    done = command(*words.format(folder=tmp_path).split())
    assert (done.returncode, done.stderr) == (1, f"glsplat {words.split()[0]}: {line}\n")


SNIPPETS = """
from pathlib import Path
from glsplat.errors import GlsplatError
from glsplat.optional import MissingPackageError
from glsplat.extras.consent.keys import signed_by
from glsplat.extras.operations import qr
from glsplat.extras.formats.spz import _zstd

for call, text in (
    (lambda: __import__("glsplat.extras.authoring"), "making avatars needs scipy"),
    (lambda: __import__("glsplat.extras.statistics"), "a statistical test needs scipy"),
    (lambda: signed_by("0" * 64, "0" * 128, b""), "checking a signature of consent needs cryptography"),
    (lambda: qr.terminal("http://localhost"), "a QR code needs segno: pip install 'glsplat[server]'"),
    (lambda: sys.version_info >= (3, 14) or _zstd(), "SPZ version 4 needs backports.zstd: pip install 'glsplat[spz]'"),
):
    try:
        call()
    except GlsplatError as error:
        assert str(error).startswith(text), error
    else:
        assert sys.version_info >= (3, 14), text
"""


@pytest.mark.extra(name="authoring")
def test_an_extra_says_what_it_needs() -> None:
    done = subprocess.run([sys.executable, "-c", HIDING + SNIPPETS], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
