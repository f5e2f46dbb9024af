"""QR codes of URLs: SVG for the status page, half blocks for the terminal. ``segno`` is loaded on first use."""

from __future__ import annotations

import asyncio

from glsplat.optional import has_package, require_package

_BORDER = 4  # modules of quiet zone (ISO/IEC 18004)
_BLOCKS = {(True, True): " ", (False, True): "▀", (True, False): "▄", (False, False): "█"}  # (upper, lower) is dark
# palette entries that themes do not change: light modules are light on every terminal's background
_COLOURS, _END = "\x1b[38;5;231;48;5;16m", "\x1b[0m"


MAX_URL = 1000  # characters; a code holds at most 2,900


class QrCodes:
    """Cache of SVG codes; "" beyond ``most`` URLs, and without segno.

    A code takes 10 ms and anybody may request any URL: without the limit this would occupy a core.
    """

    def __init__(self, most: int = 16) -> None:
        self._most = most if has_package("segno") else 0
        self._drawn: dict[str, str] = {}
        self._once = asyncio.Semaphore(1)

    async def svg(self, text: str) -> str:
        """Return the code, drawn at the first call on a thread; "" for others meanwhile."""
        if text not in self._drawn and len(self._drawn) < self._most:
            self._drawn[text] = ""
            self._drawn[text] = await asyncio.to_thread(svg, text)
        return self._drawn.get(text, "")

    async def secret(self, text: str) -> str:
        """Return the code of a URL with a verified token: drawn each time, one at a time, never cached."""
        if len(text) > MAX_URL or not self._most:
            return ""
        async with self._once:
            return await asyncio.to_thread(svg, text)


def svg(text: str) -> str:
    """Return an <svg> element for HTML, black on white, four pixels per module; ``text`` is its title."""
    require_package("a QR code", "segno", "server")
    import segno

    code = segno.make(text, micro=False)
    drawn: str = code.svg_inline(scale=4, border=_BORDER, light="#fff", svgclass=None, lineclass=None, title=text)
    width, height = code.symbol_size(scale=4, border=_BORDER)
    head = f'<svg viewBox="0 0 {width} {height}" role="img" '  # viewBox: scaled instead of cropped
    return drawn.replace("<svg ", head, 1)


def terminal(text: str) -> tuple[list[str], int]:
    """Return lines for a terminal, two rows of modules each with escape codes, and their width in columns."""
    require_package("a QR code", "segno", "server")
    import segno

    rows = [[bool(module) for module in row] for row in segno.make(text, micro=False).matrix_iter(border=_BORDER)]
    rows.append([False] * len(rows[0]))  # the number of rows is odd
    pairs = zip(rows[::2], rows[1::2], strict=True)
    lines = [_COLOURS + "".join(map(_BLOCKS.__getitem__, zip(*pair, strict=True))) + _END for pair in pairs]
    return lines, len(rows[0])
