"""The site of docs/ (`make docs`): every page is in it, strict, whole without a network, with the API's names."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import pytest

import glsplat
from tests.test_layers import FILES
from tests.test_public_names import public_of
from tools.docs.site.public import api_pages, homes, public_modules

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]
CONFIG = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
NAV = re.findall(r"(?m)^ +- .+: ([\w/.-]+\.md)$", CONFIG.partition("\nnav:")[2])


def build(config: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """MkDocs as `make docs` calls it, with these settings, into ``folder``/site."""
    for old, new in (("hooks: [tools", f"hooks: [{ROOT}/tools"), ("paths: [.]", f"paths: [{ROOT}]")):
        config = config.replace(old, new)
    (folder / "mkdocs.yml").write_text(config, encoding="utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder / "site")]
    variables = os.environ | {"PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=280)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole site, built once without a word."""
    folder = tmp_path_factory.mktemp("site")
    done = build(CONFIG.replace("docs_dir: docs", f"docs_dir: {ROOT / 'docs'}"), folder)
    assert done.returncode == 0 and "WARNING" not in done.stdout + done.stderr, done.stderr
    return folder / "site"


class Addresses(HTMLParser):
    """``loaded`` is what a page fetches by itself, ``ids`` where a link may lead."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.ids: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = dict(attrs)
        self.ids.append(of.get("id") or "")
        if tag in ("script", "img", "iframe", "source") and of.get("src"):
            self.loaded.append(of["src"] or "")
        if tag == "link" and of.get("href"):
            self.loaded.append(of["href"] or "")


def test_every_page_of_docs_is_in_the_nav() -> None:
    there = {path.name for path in (ROOT / "docs").glob("*.md")}
    assert len(NAV) == len(set(NAV)) > 25
    assert not there - set(NAV), "pages without a line in nav of mkdocs.yml"
    assert not {page for page in NAV if "/" not in page} - there - {"readme.md", "changelog.md", "contributing.md"}
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert not {page for page in there - {"index.md"} if f"({page})" not in index}, "pages that index.md lacks"


def test_the_api_has_every_public_name() -> None:
    """What is read from the source is what Python has."""
    modules = dict(public_modules())
    candidates = [n for n, path in FILES.items() if n.split(".")[0] == "glsplat" and may_be_public(n, path)]
    assert set(modules) == {name for name in candidates if public_of(name)} and len(modules) > 20
    for name, path in modules.items():
        found = homes(name, path)
        assert set(found) == set(public_of(name)), name
        for one, home in found.items():
            assert home in FILES or home.rpartition(".")[2] in defined(home.rpartition(".")[0]), f"{one}: {home}"
    index = api_pages()["api/index.md"]
    assert all(f"`{name}`" in index for name in modules)


@cache
def defined(module: str) -> set[str]:
    """What a module's own lines define."""
    names: set[str] = set()
    for node in ast.parse(FILES[module].read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            names |= {target.id} if isinstance(target, ast.Name) else set()
    return names


def may_be_public(name: str, path: Path) -> bool:
    """A package, or a module right in glsplat/."""
    return path.name == "__init__.py" or name.count(".") == 1


def test_the_site_is_whole(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 55 and {f"{Path(page).with_suffix('.html')}" for page in NAV} <= {
        page.relative_to(site).as_posix() for page in pages
    }
    for page in pages:
        for address in Addresses(page).loaded:
            assert not re.match(r"(https?:)?//", address), f"{page.name} fetches {address}"
            if not address.startswith(("data:", "/")):  # 404.html has addresses of a server's root
                assert (page.parent / re.split("[?#]", address)[0]).exists(), f"{page.name}: no {address}"
    for style in site.rglob("*.css"):
        assert not re.search(r"url\([\"']?(https?:)?//|@import", style.read_text(encoding="utf-8")), style.name
    ids = Addresses(site / "api" / "glsplat.html").ids
    assert all(any(name.endswith(f".{public}") for name in ids) for public in glsplat.__all__)
    text = (site / "api" / "glsplat.html").read_text(encoding="utf-8")
    assert "&gt;&gt;&gt;" in text
    for page in (site / "api").glob("*.html"):  # examples are code, not quotations
        assert "<blockquote>" not in page.read_text(encoding="utf-8"), page.name
    assert "premultiplied" in (site / "search" / "search_index.js").read_text(encoding="utf-8")


def test_docstrings_become_markdown() -> None:
    from tools.docs.site.docstrings import markdown_of  # it needs griffe, which the other tests here do without

    said = markdown_of("One line::\n\n    code\n\n>>> 1 + 1\n2\n\nAn end of ``a::b``.")
    assert said == "One line:\n\n    code\n\n\n```pycon\n>>> 1 + 1\n2\n```\n\nAn end of ``a::b``."
    table = "=====  ====\nname   what\n=====  ====\na      b\n=====  ===="
    assert markdown_of(f"A.\n\n{table}") == f"A.\n\n```text\n{table}\n```"
    assert markdown_of("::\n\n    code") == "    code" and markdown_of("no example") == "no example"


def test_lists_and_tables_have_a_line_before_them() -> None:
    """Else the site, unlike GitHub, takes them for the paragraph's next line."""
    begins = re.compile(r"- |\d+\. |\|")
    goes_on = re.compile(r"- |\d+\. |  |\||\*\*|#|<!--")
    for page in sorted((ROOT / "docs").glob("*.md")):
        fence, before = False, ""
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            fence ^= line.startswith("```")
            bad = not fence and begins.match(line) and before.strip() and not goes_on.match(before)
            assert not bad, f"{page.name}:{number}: a blank line is needed before {line[:40]!r}"
            before = line


def test_what_is_wrong_ends_the_build(tmp_path: Path) -> None:
    """A page that nav lacks, a link and an anchor that lead nowhere: each is a line, and there is no site."""
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# One\n\n[a](none.md) [b](index.md#two) [c](index.md#one)\n")
    (docs / "alone.md").write_text("# Alone\n")
    nav = "\nnav:\n  - Start:\n      - One: index.md\n"
    done = build(re.sub(r"(?s)\nnav:.*", nav, CONFIG).replace("hooks: [tools/docs/site/hooks.py]", ""), tmp_path)
    assert done.returncode == 1
    for words in ("alone.md", "'none.md'", "#two"):
        assert words in done.stderr, done.stderr
    assert "index.md#one" not in done.stderr and done.stderr.count("WARNING") == 3
