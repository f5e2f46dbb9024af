"""Puts probes at faults' places in Python source: calls that record which test executes the place."""

from __future__ import annotations

import ast
from collections.abc import Sequence

Position = tuple[int, int]  # line from 1, column in bytes


def with_probes(text: str, marks: Sequence[tuple[int, int, str, str]]) -> str:
    """Return ``text`` with a probe for each of ``marks``: number, line from 1, that line stripped before and after."""
    tree = ast.parse(text)
    lines = [line.encode() for line in text.splitlines(keepends=True)]
    inserts: list[tuple[Position, str]] = []
    for number, at, before, after in marks:
        indent = len(lines[at - 1]) - len(lines[at - 1].lstrip())
        first, last = ((at, indent + column) for column in _changed(before.encode(), after.encode()))
        start, end = _span(_expression(tree, first, last))
        inserts += [(start, f"(fault_probe({number}) or ("), (end, "))")]
    for (line, column), new in sorted(inserts, reverse=True):
        lines[line - 1] = lines[line - 1][:column] + new.encode() + lines[line - 1][column:]
    return b"".join(lines).decode()


def _changed(before: bytes, after: bytes) -> tuple[int, int]:
    """First and last column of what differs."""
    first, last = 0, len(before)
    while before[: first + 1] == after[: first + 1]:
        first += 1
    while last > first and before[last - 1 :] == after[len(after) - len(before) + last - 1 :]:
        last -= 1
    return first, last


def _span(node: ast.expr | ast.stmt) -> tuple[Position, Position]:
    return (node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0)


def _expression(tree: ast.Module, first: Position, last: Position) -> ast.expr:
    """Innermost value around the place; where a statement itself is changed, the first value in it."""
    around = [node for node in ast.walk(tree) if isinstance(node, ast.expr | ast.stmt)]
    around = [node for node in around if _span(node)[0] <= first and last <= _span(node)[1]]
    around.sort(key=lambda node: (_span(node)[0], [-x for x in _span(node)[1]]))
    statement = max(i for i, node in enumerate(around) if isinstance(node, ast.stmt))
    inner = [node for node in around[statement + 1 :] if _is_value(node)]
    return (inner or [node for node in ast.walk(around[statement]) if _is_value(node)][::-1])[-1]  # type: ignore[return-value]


def _is_value(node: ast.AST) -> bool:
    is_loaded = isinstance(getattr(node, "ctx", ast.Load()), ast.Load)
    return isinstance(node, ast.expr) and not isinstance(node, ast.Slice | ast.Starred) and is_loaded
