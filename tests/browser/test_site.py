"""The docs' site opened from a disk, without a network: it shows, searches, and asks for nothing of others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.test_site import CONFIG, ROOT, build


def test_it_searches_as_a_file(chromium: Any, tmp_path: Path) -> None:
    assert build(CONFIG.replace("docs_dir: docs", f"docs_dir: {ROOT / 'docs'}"), tmp_path).returncode == 0
    context = chromium.new_context(offline=True)
    page, asked = context.new_page(), []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"file://{tmp_path}/site/index.html")
    page.get_by_placeholder("Search").fill("premultiplied")
    found = page.locator(".md-search-result__item a")
    found.first.wait_for(timeout=60_000)
    hits = [link.get_attribute("href") for link in found.all()]
    assert any("python.html" in (hit or "") for hit in hits)
    page.goto(f"file://{tmp_path}/site/gallery.html")
    broken = "[...document.images].filter(image => !image.complete || !image.naturalWidth).map(image => image.src)"
    page.wait_for_load_state("load")
    assert page.evaluate("document.images.length") >= 10 and page.evaluate(broken) == []
    assert asked and not [url for url in asked if not url.startswith(("file:", "data:", "about:"))]
    context.close()
