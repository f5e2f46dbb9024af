"""Where a fault can be planted in Python source, and which of the places are drawn."""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from tests.faults.glsl import glsl_sites

PACKAGES = ("shaders", "renderer", "skinning", "tracking", "net", "formats")
LEFT_OUT = ("glsplat/extras/training/",)

# the order of their arguments says nothing, or they only name things
ANY_ORDER = {"add", "allclose", "array_equal", "hypot", "isclose", "max", "maximum", "min", "minimum", "multiply"}
NAMING = {"NewType", "TypeVar", "cast", "getattr", "hasattr", "isinstance", "issubclass", "namedtuple", "print", "warn"}
LOGS = re.compile(r"(^|[._])(log|logger|logging|warnings)$", re.IGNORECASE)
LOCK = re.compile(r"\block_of\b|_?lock\b|\.turn\b|mutex|semaphore", re.IGNORECASE)
TEXT = (ast.JoinedStr, ast.List, ast.ListComp, ast.Tuple, ast.Dict)


@dataclass(frozen=True)
class Fault:
    """One line changed; found again by its text in a tree where lines moved."""

    package: str
    kind: str
    file: str  # from the root of the tree
    before: str  # the line without the blanks around it
    after: str
    occurrence: int  # among the lines of the file that read the same
    line: int  # where it was drawn


Site = tuple[str, int, int, int, str]  # kind, line, first and last column in bytes, what stands there instead


def _annotations(node: ast.AST) -> list[ast.AST]:
    fields = (getattr(node, name, None) for name in ("annotation", "returns"))
    return [f for f in fields if isinstance(f, ast.AST)] + getattr(node, "decorator_list", [])


def _skipped(node: ast.AST) -> bool:
    match node:
        case ast.Raise() | ast.JoinedStr() | ast.pattern():
            return True
        case ast.FunctionDef(name=name):
            return name in ("__repr__", "__str__")
        case ast.Assign(targets=[ast.Name(id="__all__")]):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Call(func=ast.Name(id=name)):
            return name in NAMING
        case ast.Call(func=ast.Attribute(value=value)):
            return bool(LOGS.search(ast.unparse(value)))
    return False


def _joins_text(node: ast.expr) -> bool:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _joins_text(node.left) or _joins_text(node.right)
    if isinstance(node, ast.IfExp):
        return _joins_text(node.body)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return node.func.attr in ("join", "tobytes", "encode", "read")
    return isinstance(node, TEXT) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _called(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


class _Finder:
    def __init__(self, text: str) -> None:
        self.lines = [line.encode() for line in text.splitlines()]
        self.sites: list[Site] = []
        self._visit(ast.parse(text), None)

    def _add(self, kind: str, node: ast.expr | ast.stmt, new: str, upto: ast.expr | None = None) -> None:
        last = upto or node
        if node.lineno == last.end_lineno:
            self.sites.append((kind, node.lineno, node.col_offset, last.end_col_offset or 0, new))

    def _text(self, node: ast.expr) -> str:
        return self.lines[node.lineno - 1][node.col_offset : node.end_col_offset].decode()

    def _operator(self, kind: str, left: ast.expr, right: ast.expr, old: str, new: str) -> None:
        """The operator between two operands on one line."""
        if left.end_lineno == right.lineno:
            start = left.end_col_offset or 0
            at = self.lines[right.lineno - 1][start : right.col_offset].find(old.encode())
            if at >= 0:
                place = start + at
                self.sites.append((kind, right.lineno, place, place + len(old), new))

    def _visit(self, node: ast.AST, parent: ast.AST | None) -> None:
        if _skipped(node):
            return
        self._sites_at(node, parent)
        left_out = _annotations(node)
        for child in ast.iter_child_nodes(node):
            if not any(child is other for other in left_out):
                self._visit(child, node)

    def _sites_at(self, node: ast.AST, parent: ast.AST | None) -> None:
        match node:
            case ast.BinOp(op=ast.Add()) if not _joins_text(node):
                self._operator("sign", node.left, node.right, "+", "-")
            case ast.BinOp(op=ast.Sub()):
                self._operator("sign", node.left, node.right, "-", "+")
            case ast.AugAssign(op=ast.Add()) if not _joins_text(node.value):
                self._operator("sign", node.target, node.value, "+=", "-=")
            case ast.AugAssign(op=ast.Sub()):
                self._operator("sign", node.target, node.value, "-=", "+=")
            case ast.UnaryOp(op=ast.USub()):
                at = node.col_offset
                self.sites.append(("sign", node.lineno, at, at + 1, ""))
            case ast.Compare():
                self._bounds(node)
            case ast.Constant(value=int() as value) if not isinstance(value, bool) and self._counts(node, parent):
                text = self._text(node)
                self._add("off-by-one", node, str(value + 1) if text == str(value) else f"({text} + 1)")
            case ast.Call():
                self._call(node)
            case ast.With(items=[item]) | ast.AsyncWith(items=[item]):
                if item.optional_vars is None and LOCK.search(ast.unparse(item.context_expr)):
                    self._add("lock", node, "if True", item.context_expr)
            case ast.If(test=test, body=[ast.Raise(), *_]):
                if not any(isinstance(inner, ast.NamedExpr) for inner in ast.walk(test)):
                    self._add("check", test, "False")

    def _bounds(self, node: ast.Compare) -> None:
        left = node.left
        for op, right in zip(node.ops, node.comparators, strict=True):
            match op:
                case ast.Lt():
                    self._operator("bound", left, right, "<", "<=")
                case ast.LtE():
                    self._operator("bound", left, right, "<=", "<")
                case ast.Gt():
                    self._operator("bound", left, right, ">", ">=")
                case ast.GtE():
                    self._operator("bound", left, right, ">=", ">")
            left = right

    def _counts(self, node: ast.Constant, parent: ast.AST | None) -> bool:
        """Whether an integer is an index, a bound or what is added: not a name for something."""
        match parent:
            case ast.Subscript() | ast.Slice() | ast.Compare() | ast.BinOp(op=ast.Add() | ast.Sub()):
                return True
            case ast.Call():
                return _called(parent) == "range"
        return False

    def _call(self, node: ast.Call) -> None:
        name = _called(node)
        if name == "range" and not isinstance(node.args[-1], ast.Constant):
            stop = node.args[min(1, len(node.args) - 1)]
            self._add("off-by-one", stop, f"{self._text(stop)} - 1")
        for first, second in pairwise(node.args):
            if isinstance(first, ast.Starred) or isinstance(second, ast.Starred) or name in ANY_ORDER:
                continue
            if first.lineno == second.end_lineno:
                one, other = self._text(first), self._text(second)
                between = self.lines[first.lineno - 1][first.end_col_offset : second.col_offset].decode()
                if one != other:
                    self._add("swap", first, f"{other}{between}{one}", second)


def _faults_of(root: Path, file: str, package: str) -> Iterator[Fault]:
    text = (root / file).read_text()
    lines = text.splitlines()
    found = _Finder(text).sites if file.endswith(".py") else glsl_sites(lines)
    for kind, number, first, last, new in sorted(found):
        line = lines[number - 1].encode()
        before, after = line.decode().strip(), (line[:first] + new.encode() + line[last:]).decode().strip()
        earlier = sum(other.strip() == before for other in lines[: number - 1])
        yield Fault(package, kind, file, before, after, earlier, number)


def all_faults(root: Path, package: str) -> list[Fault]:
    files = sorted(p.relative_to(root).as_posix() for p in (root / "glsplat" / package).rglob("*"))
    kept = [f for f in files if f.endswith((".py", ".glsl")) and not f.startswith(LEFT_OUT)]
    return [fault for file in kept for fault in _faults_of(root, file, package)]


def drawn(root: Path, package: str, seed: int, count: int) -> list[Fault]:
    """In turn by kind, and from files that have none yet as long as there are such."""
    rng = random.Random(f"{seed} {package}")
    left = all_faults(root, package)
    kinds = sorted({fault.kind for fault in left})
    rng.shuffle(kinds)
    result: list[Fault] = []
    while len(result) < count and left:
        kind = kinds[len(result) % len(kinds)]
        of_kind = [f for f in left if f.kind == kind] or left
        used = {f.file for f in result}
        fault = rng.choice([f for f in of_kind if f.file not in used] or of_kind)
        result.append(fault)
        left = [f for f in left if (f.file, f.before, f.occurrence) != (fault.file, fault.before, fault.occurrence)]
    return result
