"""Every block of README and docs runs, or says above it why it does not: ``<!-- not run: REASON -->``.

Commands of a page run in its order in one folder, which has the files that pages speak of; Python likewise. A mark
``<!-- not run (serve, page): REASON -->`` is about the lines with one of these words. What is not run is read all the
same: the options of a ``glsplat`` line exist, Python compiles and what it imports is there, JSON and TOML parse, and a
test that a reason names is there, too.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import io
import json
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import glsplat
from apps import cli
from glsplat.data import person
from glsplat.extras.speech.sound import Sound
from tests.apps.cli import run as run_command
from tests.extras.speech.sounds import wav_bytes

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROGRAMS = {
    *(
        "glsplat",
        "python",
        "python3",
        "make",
        "pip",
        "docker",
        "sudo",
        "adb",
        "curl",
        "xvfb-run",
        "export",
        "for",
        "echo",
    ),
    *("ray", "monado-service", ".venv/bin/pytest", "su", "git", "echo"),
}
"""A block whose lines begin with none of these, and that is not fenced as a language, is a figure or a quotation."""
WHOLE = {"python.md": "tests/api/test_examples.py", "extending.md": "tests/formats/test_own_format.py"}
"""Pages whose Python is one program, and the test that runs it."""

MARK = re.compile(r"<!-- not run(?: \(([^)]*)\))?: (.+?) -->")


class Block(NamedTuple):
    """``kind``: what its fence says, "shell", or "text"; ``marks``: words of lines (none: all), and the reason."""

    page: Path
    line: int
    kind: str
    text: str
    marks: tuple[tuple[tuple[str, ...], str], ...]

    def why_not(self, command: str = "") -> str | None:
        """The reason why it, or this line of it, is not run."""
        for words, reason in self.marks:
            if not words or any(re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", command) for word in words):
                return reason
        return None


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page, fenced or indented."""
    lines, found, marks, at = page.read_text(encoding="utf-8").splitlines(), [], [], 0
    while at < len(lines):
        line, begin = lines[at], at
        if mark := MARK.fullmatch(line):
            words = tuple(word.strip() for word in mark[1].split(",")) if mark[1] else ()
            marks.append((words, mark[2]))
        elif fence := re.fullmatch(r"( *)```(\w*)", line):
            at = next(i for i in range(at + 1, len(lines)) if lines[i].strip() == "```")
            text = "\n".join(row.removeprefix(fence[1]) for row in lines[begin + 1 : at])
            found.append(Block(page, begin + 1, fence[2] or kind_of(text), text, tuple(marks)))
            marks = []
        elif line.startswith("    ") and not lines[at - 1].strip():
            while at + 1 < len(lines) and (lines[at + 1].startswith("    ") or not lines[at + 1].strip()):
                at += 1
            text = "\n".join(row[4:] for row in lines[begin : at + 1]).rstrip()
            found.append(Block(page, begin + 1, kind_of(text), text, tuple(marks)))
            marks = []
        elif line.strip():
            assert not marks, f"{page.name}:{begin + 1}: a mark belongs right above its block"
        at += 1
    return found


def kind_of(text: str) -> str:
    """ "shell" where a line begins with a program."""
    first = (line.removeprefix("$ ").partition(" ")[0].split("/bin/")[-1] for line in text.splitlines())
    return "shell" if any(word in PROGRAMS for word in first) else "text"


def commands_of(text: str) -> list[str]:
    """Its lines, those that a backslash continues as one, without comments."""
    joined = re.sub(r"\\\n\s*", " ", text)
    return [line for line in joined.splitlines() if line.strip() and not line.lstrip().startswith("#")]


BLOCKS = {page: found for page in PAGES if (found := blocks_of(page))}


def read(block: Block) -> None:
    """What can be held against the code without running it."""
    if block.kind == "python":
        for node in ast.walk(ast.parse(block.text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "glsplat":
                module = importlib.import_module(node.module or "")
                assert all(hasattr(module, alias.name) for alias in node.names), block
    if block.kind == "toml":
        tomllib.loads(block.text)
    for _, reason in block.marks:
        for test in re.findall(r"tests/[\w/]+\.py", reason):
            assert (ROOT / test).exists(), f"{block.page.name}:{block.line}: no {test}"


def read_command(command: str, block: Block) -> None:
    """A line of ``glsplat`` says nothing that the command does not know."""
    words = shlex.split(command.removeprefix("$ ").partition(" && ")[0], comments=True)
    if words and words[0].split("/")[-1] == "glsplat":
        end = next((i for i, word in enumerate(words) if word in (">", "&", "|")), None)
        try:
            cli.parsed(words[1], words[2:end])
        except (SystemExit, glsplat.GlsplatError) as error:
            if not isinstance(error, SystemExit) or error.code:
                pytest.fail(f"{block.page.name}:{block.line}: {command}: {error}")


def is_written(command: str) -> bool:
    """Write the file of a line such as ``echo 'TEXT' > FILE`` into the current folder; False for other lines."""
    found = re.fullmatch(r"echo '(.*)' >>? ([a-z.]+)(?: +#.*)?", command)
    if found is not None:
        Path(found[2]).write_text(found[1])
    return found is not None


@pytest.mark.gl
@pytest.mark.parametrize("page", BLOCKS, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_blocks_of_a_page(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    samples(tmp_path)
    names: dict[str, object] = {"__name__": "page", **given()}
    for block in BLOCKS[page]:
        read(block)
        if block.kind == "shell":
            for command in commands_of(block.text):
                if is_written(command):
                    continue
                read_command(command, block)
                if block.why_not(command) is None:
                    run(command, block)
        elif block.why_not() is not None or block.kind == "text" or page.name in WHOLE:
            continue
        elif block.kind == "python":
            run_python(block, names)
        elif block.kind == "json":
            json.loads(block.text)
        else:
            assert block.kind == "toml", f"{page.name}:{block.line}: nothing runs {block.kind!r}: mark it"


def run(command: str, block: Block) -> None:
    """A line of ``glsplat``, in this process; nothing else is run from here."""
    words = shlex.split(command, comments=True)
    where = f"{block.page.name}:{block.line}: {command}"
    assert words[0] == "glsplat", f"{where}: nothing runs this: mark it"
    out = io.StringIO()
    words, target = (words[:-2], words[-1]) if words[-2] == ">" else (words, None)
    with contextlib.redirect_stdout(out):
        assert run_command(*words[1:]) == 0, where
    if target:
        Path(target).write_text(out.getvalue(), encoding="utf-8")


def run_python(block: Block, names: dict[str, object]) -> None:
    """A block, after those before it on its page; a line that ends in ``# -> ...`` says what it shows."""
    exec(compile(block.text, f"{block.page.name}:{block.line}", "exec"), names)
    for line in block.text.splitlines():
        if shown := re.fullmatch(r"(\S.*?)  +# -> (.*)", line):
            assert str(eval(shown[1], names)) == shown[2], line


@cache
def small() -> glsplat.Avatar:
    """Every twentieth splat of anna, who opens quickly."""
    anna = person("anna")
    assert anna.shapes
    few = np.arange(0, len(anna.splats), 20)
    shapes = anna.shapes.take(few)
    return glsplat.Avatar(anna.splats.take(few), anna.skeleton, anna.skin.take(few), shapes=shapes)


def samples(folder: Path) -> None:
    """The files that pages speak of."""
    for name in ("me.glb", "small.glb"):
        glsplat.save(small(), folder / name)
    places = np.random.default_rng(1).normal(size=(300, 3))
    turns, sizes, grey = np.tile([1, 0, 0, 0], (300, 1)), np.full((300, 3), 0.1), np.full((300, 3), 0.5)
    room = glsplat.Splats.create(places, turns, sizes, np.full(300, 0.9), rgb=grey)
    for name in ("room.ply", "room.glb", "scan.spz", "scan.ply"):
        glsplat.save(room, folder / name)
    rate = 16000
    tone = 0.3 * np.sin(2 * np.pi * 150 * np.arange(rate // 4) / rate)
    (folder / "hello.wav").write_bytes(wav_bytes(Sound(tone.astype(np.float32), rate)))
    rows = ["participant,type,method,score"]
    cells = [("self", "ours"), ("self", "video"), ("other", "ours"), ("other", "video")]
    for who in range(6):
        rows += [f"{who},{kind},{method},{1 + (who * 7 + i) % 5}" for i, (kind, method) in enumerate(cells)]
    (folder / "ratings.csv").write_text("\n".join(rows) + "\n")


def given() -> dict[str, object]:
    """Names that blocks of Python take for granted: the page says in words what they are."""
    head = np.eye(4)
    head[:3, 3] = 0, 1.4, 2.0
    camera = glsplat.Camera(glsplat.look_at((0, 1.2, 2.4), (0, 1, 0)), glsplat.pinhole(512, 512), 512, 512)
    return {"glsplat": glsplat, "np": np, "camera": camera, "head_pose": head, "pose": glsplat.Pose.zero(55)}
