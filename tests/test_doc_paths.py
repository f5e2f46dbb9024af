"""What docs, README and docstrings name exists: files, modules, sections of other pages, chunks of GLSL."""

from __future__ import annotations

import ast
import importlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from glsplat import reference

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]
# the changelog names what is gone, too
PAGES = sorted(
    [
        *ROOT.glob("[!C]*.md"),
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "glsplat/data").glob("*.md"),
    ]
)
SOURCES = sorted(
    p for folder in ("glsplat", "apps") for p in (ROOT / folder).rglob("*") if p.suffix in (".py", ".glsl")
)

PATH = re.compile(r"(?<![\w./-])((?:[\w.-]+/)*[\w.-]*\w\.(?:py|glsl|md|toml|yml|vert|frag|comp|geom))(?![\w-])")
MODULE = re.compile(r"(?<!window\.)\b((?:glsplat|apps|tests|tools)(?:\.[a-z_]\w*)+)")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)(?:#([\w-]+))?\)")

MEMBER = re.compile(r"(?<![\w./-])((?:[a-z_]+/)+[a-z_]+)\.([a-z_]\w*)\b")  # authoring/cones.hidden
ORACLE = re.compile(r"\breference\.(?!py\b)([a-z_]\w*)")

# patterns of names, files of others, a group of entry points
FOREIGN = {
    *("server.toml", "study.toml", "mine.toml", "noun.glsl", "name.stage.glsl", "LICENSE.md", "results.md"),
    *("glsplat.methods", "glsplat.reconstructors"),
}


def files() -> list[str]:
    skipped, found = {".git", ".venv", "out", "build", "dist", "__pycache__"}, []
    for folder, below, names in os.walk(ROOT):
        below[:] = [name for name in below if name not in skipped]
        found += [(Path(folder) / name).relative_to(ROOT).as_posix() for name in names]
    return found


ALL = files()


def texts() -> Iterator[tuple[Path, str]]:
    """Every page, and every docstring and comment of the sources."""
    for page in PAGES:
        yield page, page.read_text(encoding="utf-8")
    for source in SOURCES:
        text = source.read_text(encoding="utf-8")
        if source.suffix == ".glsl":
            yield source, "\n".join(re.findall(r"//.*", text))
            continue
        said = re.findall(r"(?m)(?:^|\s)#\s.*$", text)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
                said.append(ast.get_docstring(node) or "")
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                said.append(str(node.value.value))
        yield source, "\n".join(said)


TEXTS = list(texts())


def resolves(name: str) -> bool:
    """Whether module, or attribute of a module, ``name`` is there."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            thing: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def known(path: str) -> bool:
    """A path from the root or from any folder of ours (`passes/arena.py`), as sentences shorten them."""
    return any(file == path or file.endswith(f"/{path}") for file in ALL)


def lost_in(text: str) -> list[str]:
    """What a text names that is not there."""
    lost = []
    for path in PATH.findall(text):
        if path in FOREIGN or path.startswith("."):
            continue
        if not known(path):
            lost.append(path)
    for module in set(MODULE.findall(text)) - FOREIGN:
        if module.split(".")[-1] in ("service", "v1", "md", "org", "css", "js", "json") or module.endswith(".py"):
            continue
        if not resolves(module):
            lost.append(module)
    for folder, name in MEMBER.findall(text):
        if known(f"{folder}.py") and not known(f"{folder}.{name}"):
            home = next(file for file in ALL if file == f"{folder}.py" or file.endswith(f"/{folder}.py"))
            if not resolves(f"{home.removesuffix('.py').replace('/', '.')}.{name}"):
                lost.append(f"{folder}.{name}")
        elif any(file.startswith(f"glsplat/{folder.split('/')[0]}/") for file in ALL) and not known(f"{folder}.{name}"):
            lost.append(f"{folder}.{name}")
    lost += [f"reference.{name}" for name in ORACLE.findall(text) if not hasattr(reference, name)]
    return lost


def test_what_is_named_exists() -> None:
    found = {place.relative_to(ROOT).as_posix(): lost for place, text in TEXTS if (lost := lost_in(text))}
    assert not found, f"named, and not there: {found}"


def dead_links(page: Path) -> list[str]:
    """The links of a page that lead nowhere."""
    lost = []
    for target, anchor in LINK.findall(page.read_text(encoding="utf-8")):
        file = (page.parent / target).resolve()
        if not file.exists():
            lost.append(target)
        elif anchor:
            heads = re.findall(r"(?m)^#+ (.*)$", file.read_text(encoding="utf-8"))
            anchors = {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}
            if anchor not in anchors:
                lost.append(f"{target}#{anchor}")
    return lost


def test_links_lead_somewhere(tmp_path: Path) -> None:
    assert PAGES and not {page.name: lost for page in PAGES if (lost := dead_links(page))}
    (tmp_path / "a.md").write_text("# One head\n[a](a.md#one-head) [b](b.md) [c](a.md#two)")
    assert dead_links(tmp_path / "a.md") == ["b.md", "a.md#two"]


def test_sections_that_are_quoted_exist() -> None:
    """`conventions.md, "Avatar file"` and the like: the quoted words are a heading or a bold start of that page."""
    quoted = re.compile(r'\(?((?:docs/)?[a-z]+\.md)\)?,\s+"([^"\n]+)"')
    found = [(place, page, title) for place, text in TEXTS for page, title in quoted.findall(" ".join(text.split()))]
    assert len(found) > 2
    for place, page, title in found:
        body = (ROOT / "docs" / Path(page).name).read_text(encoding="utf-8").lower()
        heads = re.findall(r"(?m)^(?:#+ |\*\*)(.*)$", body)
        assert any(title.lower().rstrip(".") in head for head in heads), f"{place.name}: no {title!r} in {page}"
    for place, text in TEXTS:
        assert not re.search(r"conventions\.md\)? (?:section|sections|§) ?\d", text), f"{place.name}: it has no numbers"


def test_the_rules_can_fail() -> None:
    assert not known("glsplat/nothing.py") and known("passes/arena.py") and known("glsplat/scene.py")
    assert not resolves("glsplat.skinning.cones") and resolves("glsplat.authoring.cones.hidden")
    assert lost_in("glsplat/nothing.py, glsplat.camera.nothing, authoring/cones.nothing, glsplat/scene.py") == [
        "glsplat/nothing.py",
        "glsplat.camera.nothing",
        "authoring/cones.nothing",
    ]
    assert PATH.findall("see `glsplat/shaders/skin.glsl` and docs/frame.md.") == [
        "glsplat/shaders/skin.glsl",
        "docs/frame.md",
    ]
