"""Measure the time from navigation to the first picture of the avatar, and the bytes loaded by then.

    python -m tools.net.first_picture                 # six launches of Chromium against `glsplat serve`
    python -m tools.net.first_picture --launches 12 -- --avatar ben

The server runs on localhost, with its default settings and those after `--`. Each launch has a new browser. The page's
own clock runs from navigation to the first frame that starts after a picture was drawn.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

from tools.docs.chromium import launched, serving

SEEN = """
(() => {
  const look = () => {
    if (window.glsplat?.stats().shown > 0) window.seen = performance.now();
    else requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""
BYTES = "performance.getEntries().filter(e => e.startTime < seen).reduce((sum, e) => sum + (e.transferSize ?? 0), 0)"
LOADED = "performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd"


def one(play: Any, address: str) -> tuple[float, float, float]:
    """Return ms until the page is loaded and until its first picture, and the bytes loaded by then."""
    browser = launched(play)
    try:
        page = browser.new_context(bypass_csp=True, viewport={"width": 1280, "height": 720}).new_page()
        page.add_init_script(SEEN)
        page.goto(address, wait_until="commit")
        page.wait_for_function("window.seen", polling=100, timeout=60_000)
        return page.evaluate(LOADED), page.evaluate("seen"), page.evaluate(BYTES)
    finally:
        browser.close()


def main() -> None:
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--launches", type=int, default=6)
    parser.add_argument("--settle", type=float, default=4.0, help="seconds between the server's start and the first")
    parser.add_argument("options", nargs="*", help="of glsplat serve, after --")
    args = parser.parse_args()
    with serving(args.options) as address, sync_playwright() as play:
        time.sleep(args.settle)
        found = [one(play, address) for _ in range(args.launches)]
    for loaded, seen, size in found:
        print(f"loaded {loaded:5.0f} ms, first picture {seen:5.0f} ms, {size / 1e3:.0f} kB before it")
    middle = statistics.median(seen for _, seen, _ in found)
    print(f"first picture: median {middle:.0f} ms, at most {max(seen for _, seen, _ in found):.0f}")


if __name__ == "__main__":
    main()
