"""selftest.html: a self-contained page of a self-test's result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..page import document, escaped, table_of
from ..replay import latency

Rows = Sequence[Mapping[str, Any]]


def page(result: Mapping[str, Any]) -> str:
    """Return the document."""
    parts = [f"<h1>glsplat selftest: {'all promises hold' if result['holds'] else 'a promise is broken'}</h1>"]
    if result["smallest"]:
        parts.append(f"<p>Smallest failing case: {escaped(result['smallest'])}</p>")
    for name, part in result["parts"].items():
        parts.append(f"<h2>{escaped(name)} ({part['seconds']:g} s)</h2>")
        judged = [row for row in part["rows"] if "verdict" in row]
        measured = [row for row in part["rows"] if "verdict" not in row]
        if not part["rows"]:
            parts.append("<p>Not possible in this installation.</p>")
        parts += [_judged(judged)] if judged else []
        parts += [_TABLES[name](measured)] if measured else []
    return document("glsplat selftest", "".join(parts))


def _judged(rows: Rows) -> str:
    names = ("case", "behaviour", "input", "seen", "error", "unit", "verdict")
    table = [["" if row[name] is None else row[name] for name in names] for row in rows]
    classes = ["" if row["verdict"] == "holds" else "failed" for row in rows]
    return table_of(("case", "promise", "input", "seen", "largest error", "", "verdict"), table, classes)


def _facts(rows: Rows) -> str:
    return table_of(("fact", "value"), [[name, str(value)] for name, value in rows[0].items()])


def _speed(rows: Rows) -> str:
    names = ["pixels an eye", "batched (ms)", "not batched (ms)", "eye by eye (ms)", "gain"]
    paper = ["paper, batched (ms)", "paper, not batched (ms)", "paper, gain"]
    keys = ("pair_ms", "two_ms", "in_turn_ms", "gain")
    done = [row for row in rows if "left_out" not in row]
    times = [[f"{row['size']}²", *(row[key] for key in keys), *row["paper"].values()] for row in done]
    left = [f"<p>{row['size']}²: left out, {escaped(row['left_out'])}</p>" for row in rows if "left_out" in row]
    return "".join([table_of(names + paper, times), *left])


def _stream(rows: Rows) -> str:
    head, *table = latency.rows(dict(rows[0]))
    rates = [f"2 x {run['size'][0]}²: {run['pictures_a_second']:.1f} pictures a second" for run in rows[0]["runs"]]
    return table_of(head, table) + f"<p>{'; '.join(rates)}</p>"


def _largest(rows: Rows) -> str:
    (found,) = rows
    words = f"{found['splats']:,} splats keep {found['hertz']:g} Hz at 2 x {found['size']}² (0: not even the fewest)"
    return f"<p>{words}</p>" + table_of(("splats", "ms, median"), found["tried"])


_TABLES = {"driver": _facts, "speed": _speed, "stream": _stream, "largest": _largest}
