"""Parts of self-contained HTML pages: a document, tables, pictures."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from typing import Any

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 1200px; padding: 0 1em; color: #222; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; }
th, td { border-bottom: 1px solid #ddd; padding: 3px 10px; text-align: left; vertical-align: top; }
td.n { text-align: right; font-variant-numeric: tabular-nums; }
tr.front { background: #fff4e0; } tr.failed { background: #ffd9d6; font-weight: bold; }
img { max-width: 100%; } code { background: #f2f2f2; padding: 0 3px; }
"""


def document(title: str, body: str) -> str:
    """Return an HTML document."""
    head = f'<html lang="en"><head><meta charset="utf-8"><title>{escaped(title)}</title><style>{_STYLE}</style></head>'
    return f"<!doctype html>{head}<body>{body}</body></html>\n"


def table_of(names: Sequence[str], rows: Sequence[Sequence[Any]], classes: Sequence[str] = ()) -> str:
    """Return an HTML table; numbers are right-aligned, ``classes`` are those of rows."""
    lines = ["<table><tr>", *(f"<th>{escaped(name)}</th>" for name in names), "</tr>"]
    for index, row in enumerate(rows):
        kind = classes[index] if classes else ""
        lines.append(f'<tr class="{kind}">' if kind else "<tr>")
        for value in row:
            number = isinstance(value, (int, float))
            lines.append(f'<td class="n">{number_of(value)}</td>' if number else f"<td>{escaped(str(value))}</td>")
        lines.append("</tr>")
    return "".join([*lines, "</table>"])


def number_of(value: float | None) -> str:
    """Return a number with five digits and thousands separators."""
    if value is None:
        return "not finite"
    if isinstance(value, int):
        return f"{value:,}"
    small = value != 0 and abs(value) < 1e-3
    return f"{value:.1e}" if small else f"{value:.5g}"


def image_of(pictures: Mapping[str, bytes], name: str) -> str:
    """Return an <img> with the PNG or JPEG embedded."""
    kind = "jpeg" if name.endswith(".jpg") else "png"
    data = base64.b64encode(pictures[name]).decode("ascii")
    return f'<p><img alt="{escaped(name)}" src="data:image/{kind};base64,{data}"></p>'


def escaped(value: str) -> str:
    """Return text with HTML's special characters escaped."""
    return html.escape(value)
