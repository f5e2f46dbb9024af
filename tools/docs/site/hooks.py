"""What MkDocs calls while it builds (mkdocs.yml, ``hooks``): pages that are not files of docs/, and links out of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from tools.docs.site.public import ROOT, api_pages

AT_ROOT = {"readme.md": "README.md", "changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
"""Files beside docs/ that are pages of the site, too."""
SHIM = "assets/javascripts/iframe-worker.js"
_LINK = re.compile(r"(\]\()([^)\s]+)(\))")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the root and of the API, and what search needs where a page is opened as a file."""
    for address, name in AT_ROOT.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, address, content=_LINK.sub(_from_root, text)))
    for address, text in api_pages().items():
        files.append(File.generated(config, address, content=text))
    shim = Path(__file__).with_name("iframe-worker.js").read_bytes()
    files.append(File.generated(config, SHIM, content=shim))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Have the links that lead out of docs/ lead to the page of the site that stands for it."""
    if "/" in page.file.src_uri or page.file.src_uri in AT_ROOT:
        return markdown
    return _LINK.sub(_from_docs, markdown)


def _from_root(link: re.Match[str]) -> str:
    target, mark, anchor = link[2].partition("#")
    pages = {name: address for address, name in AT_ROOT.items()}
    return f"{link[1]}{pages.get(target, target.removeprefix('docs/'))}{mark}{anchor}{link[3]}"


def _from_docs(link: re.Match[str]) -> str:
    target, mark, anchor = link[2].partition("#")
    pages = {f"../{name}": address for address, name in AT_ROOT.items()}
    if target == "examples":
        target = "gallery.md"
    return f"{link[1]}{pages.get(target, target)}{mark}{anchor}{link[3]}"
