"""Tidy tables: what is read from them, what is within and missing, and one clear line for each mistake."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from glsplat.errors import FormatError
from glsplat.extras.study.analysis.table import make_table, read_table

GOOD = "participant,view,group,measure,value,note\nP2,a,x,m,1,\nP2,b,x,m,2,\nP10,a,y,m,3,\nP10,b,y,m,4.5,\n"


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "scores.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_table(tmp_path: Path) -> None:
    """Byte order mark, CRLF, blanks around cells and columns that are not asked for do no harm."""
    text = "\ufeff" + GOOD.replace("\n", "\r\n").replace("P2,a", " P2 , a")
    table = read_table(written(tmp_path, text), ["view", "group"], measure="m")
    assert table.names == ("P2", "P10") and table.response == "m"
    assert [(f.name, f.levels, f.within) for f in table.factors] == [
        ("view", ("a", "b"), True),
        ("group", ("x", "y"), False),
    ]
    assert table.values.tolist() == [1, 2, 3, 4.5] and table.cell.tolist() == [0, 2, 1, 3]
    assert table.balanced and table.incomplete == () and table.group.tolist() == [0, 1]
    turned = read_table(written(tmp_path, text), {"view": ("b", "a")}, measure="m")
    assert turned.factors[0].levels == ("b", "a") and turned.codes[:, 0].tolist() == [1, 0, 1, 0]


def test_missing_answers(tmp_path: Path) -> None:
    for cell in ("", "NA", "nan", " n/a "):
        text = GOOD.replace("4.5", cell) + "P3,a,x,m,5,\nP3,b,x,m,5,\nP4,a,y,m,5,\nP4,b,y,m,5,\n"
        table = read_table(written(tmp_path, text), ["view", "group"])
        assert table.incomplete == ("P10",) and not table.balanced and table.unanswered == 1 and len(table.values) == 7
        assert table.of(["P2", "P3", "P4"]).incomplete == ()


def test_a_table_of_any_size(tmp_path: Path) -> None:
    """Rows of other measures, with the longest answers in words, do not stay in memory."""
    path = written(tmp_path, GOOD)
    words = f"P2,a,x,words,{'word ' * 800},\n"
    with open(path, "a", encoding="utf-8") as file:
        while file.tell() < 65 << 20:
            file.write(words * 100)
    tracemalloc.start()
    table = read_table(path, ["view", "group"], measure="m")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert table.values.tolist() == [1, 2, 3, 4.5] and peak < 2 << 20


MISTAKES = [
    (GOOD.replace("view", "sight"), "no column 'view'"),
    (GOOD.replace("4.5", "four"), "line 5: column 'value' needs a number, not 'four'"),
    (GOOD.replace("4.5", "inf"), "needs a number"),
    (GOOD.replace("P10,b,y", "P10,,y"), "line 5: column 'view' is empty"),
    (GOOD.replace("P10,b,y,m,4.5,", "P10,b,y"), "line 5: 3 columns, but the header has 6"),
    (GOOD.replace(",m,3", ",k,3"), "found several; choose one of k, m"),
    (GOOD.replace("P10", "P2"), "at least two participants, found 1"),
    (GOOD.replace(",b,", ",a,"), "'view' needs two levels or more"),
    (GOOD.replace("P10,b,y,m,4.5,", ""), "nobody answered in view = b, group = y"),
    ("", "header"),
    (b"participant,view,group,value\n\xff,a,x,1\n", "UTF-8"),
    (GOOD.replace("a,x", "a\0,x"), ""),
]


def test_mistakes_are_said_in_one_line(tmp_path: Path) -> None:
    for text, said in MISTAKES:
        path = written(tmp_path, text)
        with pytest.raises(FormatError) as caught:
            read_table(path, ["view", "group"])
        assert said in str(caught.value) and "\n" not in str(caught.value) and str(path) in str(caught.value)
    with pytest.raises(FormatError, match="cannot be read"):
        read_table(tmp_path / "none.csv", ["view"])
    with pytest.raises(FormatError, match="no row has the measure 'z'"):
        read_table(written(tmp_path, GOOD), ["view"], measure="z")
    with pytest.raises(FormatError, match="different columns"):
        read_table(written(tmp_path, GOOD), ["view", "view"])


def test_what_is_no_design() -> None:
    with pytest.raises(FormatError, match="at least one factor"):
        make_table("y", {}, [("a", (), 1.0), ("b", (), 2.0)])
    with pytest.raises(FormatError, match="knows x, y, not 'z'"):
        make_table("y", {"f": ("x", "y")}, [("a", ("x",), 1.0), ("b", ("z",), 2.0)])
    many = {f"f{i}": () for i in range(9)}
    rows = [(name, tuple(str(i >> k & 1) for k in range(9)), 0.0) for name in "ab" for i in range(512)]
    with pytest.raises(FormatError, match="at most 256 conditions"):
        make_table("y", many, rows)
