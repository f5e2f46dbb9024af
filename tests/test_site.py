"""The site of docs/ (`make docs`): every page is in it, strict, whole without a network, with the API's names."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import glsplat
from tests.test_layers import FILES
from tests.test_public_names import public_of
from tools.docs.site.public import homes, public_modules

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]
CONFIG = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
NAV = re.findall(r"(?m)^ +- .+: ([\w/.-]+\.md)$", CONFIG.partition("\nnav:")[2])


class Addresses(HTMLParser):
    """``loaded`` holds what a page fetches by itself, ``ids`` where a link may lead."""

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


def test_every_page_of_docs_can_be_found() -> None:
    there = {path.name for path in (ROOT / "docs").glob("*.md")}
    assert not there - set(NAV), "pages without a line in nav of mkdocs.yml"
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert not {page for page in there - {"index.md"} if f"({page})" not in index}, "pages that index.md lacks"


def test_the_api_has_every_public_name() -> None:
    """What is read from the source is what Python has."""
    modules = dict(public_modules())
    public = [n for n, path in FILES.items() if path.name == "__init__.py" or n.count(".") == 1]
    assert set(modules) == {name for name in public if name.split(".")[0] == "glsplat" and public_of(name)}
    for name, path in modules.items():
        assert set(homes(name, path)) == set(public_of(name)), name


def test_the_site_is_whole_without_a_network(tmp_path: Path) -> None:
    config = CONFIG
    for old, new in (("hooks: [tools", f"hooks: [{ROOT}/tools"), ("paths: [.]", f"paths: [{ROOT}]")):
        config = config.replace(old, new)
    (tmp_path / "mkdocs.yml").write_text(config.replace("docs_dir: docs", f"docs_dir: {ROOT / 'docs'}"))
    site = tmp_path / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(site)]
    variables = os.environ | {"PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and "WARNING" not in done.stdout + done.stderr, done.stderr
    pages = sorted(site.rglob("*.html"))
    assert {f"{Path(page).with_suffix('.html')}".replace("README", "index") for page in NAV} <= {
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


def test_docstrings_become_markdown() -> None:
    from tools.docs.site.docstrings import markdown_of  # needs griffe

    said = markdown_of("One line::\n\n    code\n\n>>> 1 + 1\n2\n\nAn end of ``a::b``.")
    assert said == "One line:\n\n    code\n\n\n```pycon\n>>> 1 + 1\n2\n```\n\nAn end of ``a::b``."
    table = "=====  ====\nname   what\n=====  ====\na      b\n=====  ===="
    assert markdown_of(f"A.\n\n{table}") == f"A.\n\n```text\n{table}\n```"
