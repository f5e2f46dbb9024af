"""Tables of docs/measured: whole, named, and the same where other pages show them."""

import re

import pytest

from tools.docs import evaluation_results, measured

PAGES = sorted(measured.FOLDER.glob("*.md"))


def test_each_page_is_of_a_measurement() -> None:
    assert {path.stem for path in PAGES} == {*measured.PAGES, *measured.BY_OTHERS}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_page_says_what_it_was_measured_on(page) -> None:
    text = page.read_text()
    assert re.search(r"^Commit [0-9a-f]{7,}, 20\d\d-\d\d-\d\d\. .*Mesa|NVIDIA", text, re.M)
    assert measured.tables(page.stem)


def test_the_evaluation_s_page_has_its_tables(tmp_path, monkeypatch) -> None:
    """Of a made-up run of two methods that one person took part in."""
    names = ("l1", "lpips", "psnr", "ssim")
    of = {name: {"mean": 0.5, "sd": None} for name in (*names, "overlap")}
    rows = [of | {"method": m, "control": c, "n": 1} for m in ("photo", "scan") for c in ("tracking", "pose")]
    made = [{"method": m, "product": {"seconds": 3.0, "bytes": 2e6}} for m in ("photo", "scan")]
    found = {
        **{"table1": rows, "views": [row | {"view": "front"} for row in rows], "statistics": [], "timing": None},
        **{"parts": [row | {"part": "face"} for row in rows], "methods": ["photo", "scan"], "participants": made},
        **{"made_by": "0123456", "date": "2026-01-02", "drivers": "Mesa", "machine": "two cores", "failures": 0},
    }
    (tmp_path / "evaluation.md").write_bytes(evaluation_results.page(found))
    monkeypatch.setattr(measured, "FOLDER", tmp_path)
    tables = measured.tables("evaluation")
    assert list(tables) == ["methods", "pose", "sides", "parts", "pairs", "made"]
    assert "| `scan` | the true pose | 0.500 |" in tables["methods"] and "| `photo` | 3 | 2.0 |" in tables["made"]


def test_copies_are_the_tables() -> None:
    pages = list(measured.pages_with_copies())
    assert pages
    for path in pages:
        text = path.read_text()
        assert measured.with_copies(text) == text, f"{path.name}: run `python -m tools.docs.measured --copies`"


def test_a_copy_that_differs_is_found_and_written_anew(tmp_path, monkeypatch) -> None:
    (tmp_path / "frame.md").write_text("<!-- table: one -->\n\n| a |\n|---|\n| 1 |\n\n<!-- end -->\n")
    monkeypatch.setattr(measured, "FOLDER", tmp_path)
    old = "x\n<!-- measured: frame/one -->\n\n| a |\n|---|\n| 0 |\n\n<!-- end -->\ny"
    assert measured.with_copies(old) == old.replace("| 0 |", "| 1 |")
    with pytest.raises(KeyError):
        measured.with_copies(old.replace("frame/one", "frame/two"))
