"""Text over the preview: its current lines, and their picture in premultiplied RGBA."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby

import cv2
import numpy as np
from numpy.typing import NDArray

from .player import Player

Line = tuple[str, ...]
"""Cells of one line. Consecutive lines with equally many cells have aligned columns."""

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_BOX_OPACITY = 0.6
_INK = 235  # grey of the text
_MAX_CELL_CHARS = 110
_MESSAGE_S = 4.0
_NUMBERS_PERIOD_S = 0.25  # numbers that change with every picture are unreadable

_HELP_LINES: tuple[Line, ...] = (
    ("1  2  3", "mono, side by side, anaglyph (red left, cyan right)"),
    ("left drag, wheel", "orbit, nearer and farther"),
    ("right drag", "look around"),
    ("middle drag", "shift the picture (also shift + left drag)"),
    ("W A S D  Q E", "fly; shift: faster"),
    ("space", "play or pause"),
    (",  .", "a frame back or on"),
    ("M", "next motion"),
    ("[  ]", "select a joint"),
    ("arrows, page up/down", "turn it by 5 degrees; shift: by 1"),
    ("backspace", "undo its turns"),
    ("R", "reset the view"),
    ("P", "screenshot (PNG)"),
    ("O", "stage times and splat counts"),
    ("H", "this help"),
    ("Esc", "quit"),
    ("drop a file", "scene, pose or motion"),
)


class Overlay:
    """Numbers, help, a temporary message and a permanent notice, as lines of text."""

    def __init__(self, numbers: bool = False) -> None:
        self.numbers = numbers
        self.help = False
        self.left = 0.0  # seconds until the message disappears
        self.notice = ""  # shown until it is cleared
        self._message = ""
        self._numbers: list[Line] = []
        self._due = 0.0

    def say(self, message: str) -> None:
        """Show a message for _MESSAGE_S seconds."""
        self._message, self.left = message, _MESSAGE_S

    def advance(self, seconds: float) -> bool:
        """Advance the clock; return whether the message disappeared."""
        if self.left <= 0:
            return False
        self.left -= seconds
        return self.left <= 0

    def renew(self) -> None:
        """Make the numbers due now."""
        self._due = 0.0

    def lines(self, numbers: Callable[[], list[Line]], live: bool = True) -> tuple[Line, ...]:
        """Return the current lines; ``numbers`` is called if the numbers are shown and due.

        With ``live`` False, for screenshots, there is no message, and the numbers are those of the window.
        """
        out: list[Line] = []
        if self.numbers:
            now = time.monotonic()
            if not self._numbers or (live and now >= self._due):
                self._numbers, self._due = numbers(), now + _NUMBERS_PERIOD_S
            out += self._numbers
        if self.help:
            out += [("",), *_HELP_LINES] if out else _HELP_LINES
        if live and self.left > 0:
            out.append((self._message,))
        if live and self.notice:
            out.append((self.notice,))
        return tuple(out)


def number_lines(
    facts: Sequence[Line], player: Player | None, stages: Mapping[str, float], rate: float | None
) -> list[Line]:
    """Return facts, motion, joint and stage times (ms) of the last frame as lines; ``rate`` in pictures per second."""
    lines = list(facts)
    if player is not None and player.motion is not None:
        state = "playing" if player.playing else "paused"
        lines.append((f"{player.motion.label or 'motion'} frame {player.frame} of {len(player.motion)}, {state}",))
    if player is not None and player.joint is not None:
        lines.append((f"{player.joint_name} turned {player.turned:.0f} degrees",))
    lines += [(name, f"{ms:.2f} ms") for name, ms in stages.items()]
    lines.append(("together", f"{sum(stages.values()):.2f} ms"))
    lines.append(("pictures", f"{rate:.1f} a second" if rate else "when something changes"))
    return lines


def text_image(lines: Sequence[Line], scale: float = 1.0) -> NDArray[np.uint8] | None:
    """Return premultiplied RGBA [h, w, 4] of light text on a dark box; None without lines. Non-ASCII becomes "?"."""
    if not lines:
        return None
    size = 0.48 * scale
    height, margin, gap = round(19 * scale), round(8 * scale), round(14 * scale)
    rows = [tuple(_plain(cell) for cell in line) for line in lines]
    # lines with equally many cells form a block with common columns and box
    blocks = [(block, _columns(block, size, gap)) for block in (list(run) for _, run in groupby(rows, len))]
    ink = np.zeros((height * len(rows) + 2 * margin, max(edges[-1] for _, edges in blocks) + 2 * margin), np.uint8)
    shade = np.zeros(ink.shape, np.float32)
    top = margin
    for block, edges in blocks:
        bottom = top + height * len(block)
        shade[top - margin * (top == margin) : bottom, : edges[-1] + 2 * margin] = _BOX_OPACITY
        for line in block:
            for cell, x in zip(line, edges[:-1], strict=True):
                at = (margin + x, top + round(14 * scale))
                cv2.putText(ink, cell, at, _FONT, size, 255, max(1, round(scale)), cv2.LINE_AA)
            top += height
    shade[top:] = shade[top - 1]
    cover = ink.astype(np.float32) / 255
    out = np.empty((*ink.shape, 4), np.uint8)
    out[..., :3] = np.rint(cover * _INK)[..., None]
    out[..., 3] = np.rint((cover + (1 - cover) * shade) * 255)
    return out


def _columns(block: Sequence[Line], size: float, gap: int) -> list[int]:
    """Return the left edge of each column, then the right end of the widest line."""
    edges = [0]
    for column in zip(*block, strict=True):
        edges.append(edges[-1] + max(cv2.getTextSize(cell, _FONT, size, 1)[0][0] for cell in column) + gap)
    return [*edges[:-1], edges[-1] - gap]


def _plain(text: str) -> str:
    # OpenCV's stroke fonts have only ASCII
    text = text.encode("ascii", "replace").decode()
    return text if len(text) <= _MAX_CELL_CHARS else text[: _MAX_CELL_CHARS - 3] + "..."
