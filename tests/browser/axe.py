"""axe-core, which finds faults of accessibility: fetched once by npm into pytest's cache, no part of the project."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.browser.npm import file_of

__all__ = ["axe_script", "violations"]


def axe_script(cache: Path) -> str:
    """The script."""
    return file_of("axe-core@4.10.3", "package/axe.min.js", cache)


def violations(page: Any, script: str) -> list[str]:
    """What axe finds on a page of Playwright, by all rules of WCAG 2.1 A and AA and best practice, a line each."""
    page.evaluate(script)
    found = page.evaluate("async () => (await axe.run(document)).violations")
    return [f"{one['id']}: {one['help']}: {[node['html'][:160] for node in one['nodes'][:4]]}" for one in found]
