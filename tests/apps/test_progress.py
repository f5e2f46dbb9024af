"""The line that shows how far a command is."""

from __future__ import annotations

import pytest

from apps import progress
from apps.progress import Progress, each


def test_a_terminal_is_shown_share_and_label(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr(progress, "_REDRAW_PERIOD_S", 0.0)
    with Progress(4, "frames") as line:
        line.update()
        line.write("a remark")
        line.show(2, "sorting")
    shown = capsys.readouterr().err
    assert "frames: 25%, 0:00 passed, about 0:00 to go" in shown and "sorting: 50%" in shown
    assert "a remark\n" in shown and shown.endswith("\r\x1b[K")


def test_without_a_terminal_or_quiet_nothing_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    assert list(each(iter("abc"), "letters")) == ["a", "b", "c"]
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert list(each("abc", quiet=True)) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""
