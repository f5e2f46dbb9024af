"""docs/extending.md is a program: a solver and a file format from outside the house, without a change within."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import glsplat
from glsplat.errors import FormatError
from glsplat.formats import all_formats

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"


def test_the_page_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what it adds does not get in the way of the formats that were there."""
    monkeypatch.chdir(tmp_path)
    before, names, results = dict(all_formats()), {}, 0
    try:
        for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S):
            exec(compile(block, str(PAGE), "exec"), names)
            for shown in re.finditer(r"(?m)^(\S.*?)  +# -> (.*)$", block):
                results += 1
                assert str(eval(shown[1], names)) == shown[2], shown[0]
        assert results == 2 and len(all_formats()) == len(before) + 1
        (tmp_path / "three.balls").write_text("balls\n" + "0 0 1 0.1 0 1 0\n" * 3)
        balls = glsplat.load("three.balls")
        assert len(balls) == 3 and balls.means[0].tolist() == [0, 0, 1]
        glsplat.save(balls, "three.ply")
        assert len(glsplat.load("three.ply")) == 3
        with pytest.raises(FormatError, match=r"balls.* is read, not written"):
            glsplat.save(balls, "again.balls")
    finally:
        all_formats().clear()
        all_formats().update(before)
    with pytest.raises(FormatError):
        glsplat.load("three.balls")
