"""The examples of docstrings and docs/python.md run, and a strict program is clean."""

from __future__ import annotations

import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import glsplat

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


@pytest.mark.gl
@pytest.mark.parametrize("name", glsplat.__all__)
def test_the_docstring_ends_with_an_example_that_holds(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = inspect.cleandoc(getattr(glsplat, name).__doc__ or "")
    assert ">>> " in text.split("\n\n")[-1], f"{name} has no example at its end"
    test = doctest.DocTestParser().get_doctest(text, {"glsplat": glsplat, "np": np}, name, None, None)
    said: list[str] = []
    result = doctest.DocTestRunner(verbose=False).run(test, out=said.append)
    assert result.failed == 0, "".join(said)


@pytest.mark.extra(name="consent")  # its section on servers hands out splats by consent
@pytest.mark.gl
def test_the_page_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its blocks are one program; a line that ends in `# -> ...` says what it shows."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    results = 0
    for block in BLOCKS:
        exec(compile(block, str(PAGE), "exec"), names)
        for line in block.splitlines():
            shown = re.fullmatch(r"(\S.*?)  +# -> (.*)", line)
            if shown:
                results += 1
                assert str(eval(shown[1], names)) == shown[2], line
    assert results == PAGE.read_text(encoding="utf-8").count("# -> ") >= 10
