"""A progress line on stderr, if that is a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")
_REDRAW_PERIOD_S = 0.1
_CLEAR = "\r\x1b[K"


class Progress:
    """Shows a label, the percentage of ``total`` and the time left; the end of ``with`` clears the line."""

    def __init__(self, total: float, label: str = "", *, quiet: bool = False) -> None:
        self.total, self.done, self.label = total, 0.0, label
        self.shown: bool = not quiet and sys.stderr.isatty()
        self._started, self._drawn = time.monotonic(), 0.0

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.shown:
            sys.stderr.write(_CLEAR)
            sys.stderr.flush()

    def update(self, steps: float = 1) -> None:
        """Add ``steps`` to the work done."""
        self.show(self.done + steps)

    def show(self, done: float, label: str | None = None) -> None:
        """Set the work done, and the label."""
        now, self.done = time.monotonic(), done
        new_label = label is not None and label != self.label
        self.label = self.label if label is None else label
        if not self.shown or (now - self._drawn < _REDRAW_PERIOD_S and not new_label):
            return
        self._drawn = now
        share = min(1.0, done / self.total) if self.total else 0.0
        left = f", about {_clock((now - self._started) * (1 / share - 1))} to go" if share > 0 else ""
        head = f"{self.label}: " if self.label else ""
        sys.stderr.write(f"{_CLEAR}{head}{share:.0%}, {_clock(now - self._started)} passed{left}")
        sys.stderr.flush()

    def write(self, text: str) -> None:
        """Print a line of text above the progress line."""
        print(f"{_CLEAR}{text}" if self.shown else text, file=sys.stderr, flush=True)


def each(items: Iterable[T], label: str = "", *, total: int | None = None, quiet: bool = False) -> Iterator[T]:
    """Yield the ``items`` and show the progress; ``total`` is their number, by default their length."""
    if total is None:
        items = items if isinstance(items, Collection) else list(items)
        total = len(items)
    with Progress(total, label, quiet=quiet) as progress:
        for item in items:
            yield item
            progress.update()


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02}"
