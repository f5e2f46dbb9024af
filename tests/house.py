"""Draw the floors of the packages from their imports: docs/images/floors.svg, which docs/architecture.md shows.

    python -m tests.house

A room is a folder or a module right in glsplat/, and the commands. It stands one floor above the highest room that it
imports anything from, also within functions.
"""

from __future__ import annotations

from functools import cache
from html import escape

from tests.test_layers import FILES, ROOT, imports_of, room_of

WIDTH, ROW, BOX, GAP, LETTER = 900, 58, 34, 12, 8.4  # pixels


def floors() -> list[list[str]]:
    """Return the rooms of each floor, the lowest first."""
    below: dict[str, set[str]] = {}
    for module in FILES:
        if module != "glsplat":
            rooms = {room_of(other) for other in imports_of(module) if other in FILES and other != "glsplat"}
            above = {"extras"} if room_of(module) != "apps" else set()
            below.setdefault(room_of(module), set()).update(rooms - above - {room_of(module)})

    @cache
    def level(room: str) -> int:
        return max((1 + level(other) for other in below[room]), default=0)

    out: list[list[str]] = [[] for _ in range(1 + max(map(level, below)))]
    for room in sorted(below):
        out[level(room)].append(room)
    return out


def drawn() -> str:
    """Return the picture as SVG."""
    rows = floors()[::-1]
    height = ROW * len(rows) + GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}"'
        ' font-family="monospace" font-size="14" text-anchor="middle">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for index, row in enumerate(rows):
        top = GAP + index * ROW
        widths = [LETTER * len(room) + 20 for room in row]
        x = (WIDTH - sum(widths) - GAP * (len(row) - 1)) / 2
        parts.append(f'<path d="M{GAP} {top + BOX + GAP}H{WIDTH - GAP}" stroke="#ccc"/>')
        for room, width in zip(row, widths, strict=True):
            fill = "#e7eefb" if (ROOT / "glsplat" / room).is_dir() or room == "apps" else "#f4f4f4"
            parts.append(
                f'<rect x="{x:.0f}" y="{top}" width="{width:.0f}" height="{BOX}" rx="4" fill="{fill}" stroke="#667"/>'
            )
            parts.append(f'<text x="{x + width / 2:.0f}" y="{top + 22}" fill="#111">{escape(room)}</text>')
            x += width + GAP
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    (ROOT / "docs" / "images" / "floors.svg").write_text(drawn(), encoding="utf-8")
