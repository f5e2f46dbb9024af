"""Hooks of MkDocs (mkdocs.yml, ``hooks``): pages that are not files of docs/, and links out of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from tools.docs.site.public import ROOT, api_pages

AT_ROOT = {"readme.md": "README.md", "changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
"""Files outside docs/ that are pages of the site."""
SHIM = "assets/javascripts/iframe-worker.js"
_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")


def on_config(config: Any) -> Any:
    """Add the generated pages of the API to the navigation, below their index."""
    first, *others = api_pages()
    for part in config.nav:
        for entries in part.values():
            for number, entry in enumerate(entries):
                if list(entry.values()) == [first]:
                    pages = [{Path(page).stem: page} for page in others]
                    entries[number] = {next(iter(entry)): [{"All modules": first}, *pages]}
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the root and of the API, and a script that search needs for pages opened as files."""
    for address, name in AT_ROOT.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, address, content=_LINK.sub(_from_root, text)))
    for address, text in api_pages().items():
        files.append(File.generated(config, address, content=text))
    shim = Path(__file__).with_name("iframe-worker.js").read_bytes()
    files.append(File.generated(config, SHIM, content=shim))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Replace links out of docs/ by the site's own page, or by the path in the repository."""
    if page.file.src_uri in AT_ROOT or page.file.src_uri.startswith("api/"):
        return markdown
    up = "../" * page.file.src_uri.count("/")
    return _LINK.sub(lambda link: _from_docs(link, up), markdown)


def _from_root(link: re.Match[str]) -> str:
    target, mark, anchor = link[2].partition("#")
    pages = {name: address for address, name in AT_ROOT.items()}
    return f"[{link[1]}]({pages.get(target, target.removeprefix('docs/'))}{mark}{anchor})"


def _from_docs(link: re.Match[str], up: str) -> str:
    """Return the replacement of a link; ``up`` leads from the page's folder to docs/."""
    target, mark, anchor = link[2].partition("#")
    if not target.startswith(f"{up}../"):
        return link[0]
    for address, name in AT_ROOT.items():
        if target == f"{up}../{name}":
            return f"[{link[1]}]({up}{address}{mark}{anchor})"
    return f"{link[1]} (`{target.removeprefix(f'{up}../')}` in the repository)"
