"""Draws the floors of the house from its imports: docs/images/floors.svg, which docs/architecture.md shows.

    python -m tests.house
    python -m tests.house --alone    # lines of the modules that drawing, previewing and serving load, by room

A room is a folder or a module right in glsplat/, and the commands. It stands one floor above the highest room that it
imports anything from, also within functions; rooms that import each other stand on one floor, in one frame.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import Counter
from functools import cache
from html import escape
from pathlib import Path

from tests.test_alone import COMMAND, REFUSING, SERVER, VIEWER
from tests.test_layers import FILES, ROOT, imports_of

__all__ = ["PICTURE", "drawn", "floors"]

PICTURE = ROOT / "docs" / "images" / "floors.svg"
Circle = tuple[str, ...]  # rooms that import each other; nearly always one alone
WIDTH, ROW, BOX, GAP, LETTER = 900, 58, 34, 12, 8.4  # pixels


def _room(module: str) -> str:
    package, _, rest = module.partition(".")
    return rest.partition(".")[0] if package == "glsplat" and rest else package


def _imports() -> dict[str, set[str]]:
    """Each room's own imports: which other rooms it takes anything from."""
    out: dict[str, set[str]] = {}
    for module in FILES:
        room = _room(module)
        if room not in ("tests", "glsplat"):  # the root only hands on, on demand
            taken = {_room(other) for other in imports_of(module) if other in FILES}
            out.setdefault(room, set()).update(taken - {room, "tests", "glsplat"})
    return out


def floors() -> list[list[Circle]]:
    """The lowest floor first."""
    direct = _imports()

    @cache
    def under(room: str) -> frozenset[str]:
        found: set[str] = set()
        new = set(direct[room])
        while new:
            found |= new
            new = set().union(*(direct[other] for other in new)) - found
        return frozenset(found)

    @cache
    def circle(room: str) -> Circle:
        return tuple(sorted({room} | {other for other in under(room) if room in under(other)}))

    @cache
    def level(rooms: Circle) -> int:
        below = {circle(other) for room in rooms for other in direct[room]} - {rooms}
        return max((1 + level(other) for other in below), default=0)

    out: list[list[Circle]] = []
    for rooms in sorted({circle(room) for room in direct}):
        out += [[] for _ in range(level(rooms) + 1 - len(out))]
        out[level(rooms)].append(rooms)
    return out


def drawn() -> str:
    """The picture as SVG, the same text for the same imports."""
    rows = floors()[::-1]
    height = ROW * len(rows) + GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}"'
        ' font-family="monospace" font-size="14" text-anchor="middle">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for index, row in enumerate(rows):
        top = GAP + index * ROW
        wide = [[LETTER * len(room) + 20 for room in rooms] for rooms in row]
        x = (WIDTH - sum(map(sum, wide)) - GAP * (sum(map(len, wide)) - 1)) / 2
        parts.append(f'<path d="M{GAP} {top + BOX + GAP}H{WIDTH - GAP}" stroke="#ccc"/>')
        for rooms, widths in zip(row, wide, strict=True):
            if len(rooms) > 1:
                frame = sum(widths) + GAP * (len(widths) - 1) + 8
                parts.append(
                    f'<rect x="{x - 4:.0f}" y="{top - 4}" width="{frame:.0f}" height="{BOX + 8}" fill="none" '
                    'stroke="#b55" stroke-dasharray="4"/>'
                )
            for room, width in zip(rooms, widths, strict=True):
                fill = "#e7eefb" if (ROOT / "glsplat" / room).is_dir() or room == "apps" else "#f4f4f4"
                parts.append(
                    f'<rect x="{x:.0f}" y="{top}" width="{width:.0f}" height="{BOX}" rx="4" fill="{fill}" '
                    'stroke="#667"/>'
                )
                parts.append(f'<text x="{x + width / 2:.0f}" y="{top + 22}" fill="#111">{escape(room)}</text>')
                x += width + GAP
    return "\n".join([*parts, "</svg>", ""])


def alone() -> Counter[str]:
    """Lines of Python of the modules that the programs of test_alone.py load, by room; the commands aside."""
    loaded: set[str] = set()
    say = "\nprint('loaded', *(name for name in sys.modules if name.partition('.')[0] == 'glsplat'))"
    with tempfile.TemporaryDirectory() as folder:
        for program in (COMMAND, VIEWER, SERVER):
            command = [sys.executable, "-c", f"import sys\n{REFUSING}{program}{say}", f"{folder}/pair.png"]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
            loaded.update(done.stdout.rpartition("loaded ")[2].split())
    lines: Counter[str] = Counter()
    for module in loaded & set(FILES):
        lines[_room(module)] += len(FILES[module].read_text(encoding="utf-8").splitlines())
    return lines


if __name__ == "__main__":
    if sys.argv[1:] == ["--alone"]:
        lines = alone()
        print("\n".join(f"{count:6,} {room}" for room, count in lines.most_common()))
        print(f"{lines.total():6,} in all")
        raise SystemExit
    Path(PICTURE).write_text(drawn(), encoding="utf-8")
