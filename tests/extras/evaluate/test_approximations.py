"""The picture of solver, JPEGs, splats and late pictures is drawn from the tables of docs/measured."""

import shutil
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
from tools.docs.approximations import others_plot
from tools.docs.measured import FOLDER


def test_the_pages_have_the_tables(tmp_path: Path) -> None:
    assert others_plot(FOLDER).startswith(b"\x89PNG")
    shutil.copytree(FOLDER, tmp_path / "measured")
    page = tmp_path / "measured" / "ladder.md"
    page.write_text(page.read_text().replace("## moments", "## other"))
    with pytest.raises(ValueError, match="expected a table below 'moments'"):
        others_plot(tmp_path / "measured")
