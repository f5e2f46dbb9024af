"""What README and docs name exists: files, modules, links, and quoted sections of other pages."""

from __future__ import annotations

import importlib
import os
import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]
# the changelog names removed things, too
PAGES = [*ROOT.glob("[!C]*.md"), ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
PATH = re.compile(r"(?<![\w./-])((?:[\w.-]+/)*[\w.-]*\w\.(?:py|glsl|md|toml|yml|vert|frag|comp|geom))(?![\w-])")
MODULE = re.compile(r"(?<!window\.)\b((?:glsplat|apps|tests|tools)(?:\.[a-z_]\w*)+)")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)(?:#([\w-]+))?\)")
# patterns of names, files of users, groups of entry points
FOREIGN = {
    *(
        "server.toml",
        "study.toml",
        "lab/study.toml",
        "mine.toml",
        "noun.glsl",
        "name.stage.glsl",
        "LICENSE.md",
        "results.md",
    ),
    *("glsplat.methods", "glsplat.reconstructors", "glsplat.consent"),
}
NO_MODULE = ("service", "v1", "md", "org", "css", "js", "json", "py")  # endings of names that only look like one


def files() -> list[str]:
    skipped, found = {".git", ".venv", "out", "build", "dist", "__pycache__"}, []
    for folder, below, names in os.walk(ROOT):
        below[:] = [name for name in below if name not in skipped]
        found += [f"/{(Path(folder) / name).relative_to(ROOT).as_posix()}" for name in names]
    return found


def resolves(name: str) -> bool:
    """Return whether a module, or an attribute of a module, exists."""
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


def test_named_files_and_modules_exist() -> None:
    there, lost = files(), []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for path in set(PATH.findall(text)) - FOREIGN:
            if not path.startswith(".") and not any(file.endswith(f"/{path}") for file in there):
                lost.append(f"{page.name}: {path}")
        for name in set(MODULE.findall(text)) - FOREIGN:
            if name.split(".")[-1] not in NO_MODULE and not resolves(name):
                lost.append(f"{page.name}: {name}")
    assert not lost


def test_links_lead_somewhere() -> None:
    lost = []
    for page in PAGES:
        for target, anchor in LINK.findall(page.read_text(encoding="utf-8")):
            file = (page.parent / target).resolve()
            if not file.exists():
                lost.append(f"{page.name}: {target}")
            elif anchor:
                heads = re.findall(r"(?m)^#+ (.*)$", file.read_text(encoding="utf-8"))
                if anchor not in {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}:
                    lost.append(f"{page.name}: {target}#{anchor}")
    assert not lost


def test_quoted_sections_exist() -> None:
    """``conventions.md, "Avatar file"``: the quoted words are in a heading or a bold start of that page."""
    quoted = re.compile(r'\(?((?:docs/)?[a-z]+\.md)\)?,\s+"([^"\n]+)"')
    for place in PAGES:
        for page, title in quoted.findall(" ".join(place.read_text(encoding="utf-8").split())):
            body = (ROOT / "docs" / Path(page).name).read_text(encoding="utf-8").lower()
            heads = re.findall(r"(?m)^(?:#+ |\*\*)(.*)$", body)
            assert any(title.lower().rstrip(".") in head for head in heads), f"{place.name}: no {title!r} in {page}"
