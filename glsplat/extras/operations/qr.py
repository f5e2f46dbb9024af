"""QR codes of addresses: as SVG for the status page, as half blocks for the terminal. ``segno`` is loaded when used."""

from __future__ import annotations

import asyncio

from glsplat.optional import has_package, require_package

__all__ = ["QrCodes", "svg", "terminal"]

_BORDER = 4  # modules of quiet zone, as ISO/IEC 18004 asks
_BLOCKS = {(True, True): " ", (False, True): "▀", (True, False): "▄", (False, False): "█"}  # of upper and lower: dark?
# white on black of the palette that no theme changes: light modules light, on every terminal's background
_COLOURS, _END = "\x1b[38;5;231;48;5;16m", "\x1b[0m"


_LONGEST = 1000  # characters of an address; a code holds 2,900 at most


class QrCodes:
    """SVG codes of the few addresses that a page is requested by; "" for more of them, and where segno is absent.

    Drawing one takes 10 ms, and strangers may request any address: without a bound they would occupy a core.
    """

    def __init__(self, most: int = 16) -> None:
        self._most = most if has_package("segno") else 0
        self._drawn: dict[str, str] = {}
        self._once = asyncio.Semaphore(1)

    async def svg(self, text: str) -> str:
        """The code, drawn at the first call in another thread; "" meanwhile, for whoever else asks."""
        if text not in self._drawn and len(self._drawn) < self._most:
            self._drawn[text] = ""
            self._drawn[text] = await asyncio.to_thread(svg, text)
        return self._drawn.get(text, "")

    async def secret(self, text: str) -> str:
        """The code of an address that holds a token that was checked: drawn each time, one at a time, never kept."""
        if len(text) > _LONGEST or not self._most:
            return ""
        async with self._once:
            return await asyncio.to_thread(svg, text)


def svg(text: str) -> str:
    """An <svg> element to stand in HTML, black on white, four pixels a module; ``text`` is its title."""
    require_package("a QR code", "segno", "server")
    import segno

    code = segno.make(text, micro=False)
    drawn: str = code.svg_inline(scale=4, border=_BORDER, light="#fff", svgclass=None, lineclass=None, title=text)
    width, height = code.symbol_size(scale=4, border=_BORDER)
    head = f'<svg viewBox="0 0 {width} {height}" role="img" '  # or a page that makes it smaller cuts it off
    return drawn.replace("<svg ", head, 1)


def terminal(text: str) -> tuple[list[str], int]:
    """Lines for a terminal, two rows of modules each, with escape codes for their colours; and their columns."""
    require_package("a QR code", "segno", "server")
    import segno

    rows = [[bool(module) for module in row] for row in segno.make(text, micro=False).matrix_iter(border=_BORDER)]
    rows.append([False] * len(rows[0]))  # their number is odd: half a line more of quiet zone
    pairs = zip(rows[::2], rows[1::2], strict=True)
    lines = [_COLOURS + "".join(map(_BLOCKS.__getitem__, zip(*pair, strict=True))) + _END for pair in pairs]
    return lines, len(rows[0])
