"""Where a fault can be planted in a GLSL chunk: a scan of tokens, line by line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise

TOKEN = re.compile(
    r"(?P<number>0x[0-9a-fA-F]+u?|(\d+\.\d*|\.\d+|\d+)([eE][+-]?\d+)?[uf]?)|(?P<word>[A-Za-z_]\w*)"
    r"|(?P<mark>\+\+|--|<<|>>|[-+*/<>=!&|]=|&&|\|\||[^\s\w])"
)
# declarations and what the host counts on: another number there is another interface, which does not link
DECLARES = re.compile(
    r"\s*(#|layout|in |out |flat |uniform |shared |struct |precision |const \w+ \w+\[)|.*\w \w+\[\w+\];"
)
DEFINES = re.compile(r"\s*\w+ \w+\(.*\)? ?\{?$")  # a function's head
ANY_ORDER = {"dot", "distance", "equal", "max", "min", "notEqual"}
OTHER_BOUND = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
OTHER_SIGN = {"+": "-", "-": "+", "+=": "-=", "-=": "+="}
COUNTED = {"[", "+", "-", "<", "<=", ">", ">=", "==", "!="}

Site = tuple[str, int, int, int, str]


def _closing(line: str, opening: int) -> int:
    depth = 0
    for at in range(opening, len(line)):
        depth += (line[at] in "([") - (line[at] in ")]")
        if depth == 0:
            return at
    return -1


def _arguments(line: str, opening: int, closing: int) -> list[tuple[int, int]]:
    """First and last column of each, without blanks."""
    starts, depth = [opening + 1], 0
    for at in range(opening + 1, closing):
        depth += (line[at] in "([") - (line[at] in ")]")
        if line[at] == "," and depth == 0:
            starts.append(at + 1)
    ends = [start - 1 for start in starts[1:]] + [closing]
    result = []
    for start, end in zip(starts, ends, strict=True):
        text = line[start:end]
        lead = len(text) - len(text.lstrip())
        result.append((start + lead, start + len(text.rstrip())))
    return result


def _line_sites(line: str, number: int) -> Iterator[Site]:
    if checked := re.search(r"\bif (\()", line):
        closing = _closing(line, checked.start(1))
        if re.match(r"\) (return|discard|break|continue)\b", line[closing:]):
            yield "check", number, checked.end(1), closing, "false"
    if barrier := re.search(r"\bbarrier\(\)", line):
        yield "lock", number, *barrier.span(), ""
    before = ""  # the token before
    tokens = list(TOKEN.finditer(line))
    for token in tokens:
        text, (first, last) = token[0], token.span()
        operand = bool(re.match(r"[\w)\]]", before)) and before != "return"
        if text in OTHER_SIGN and operand:
            yield "sign", number, first, last, OTHER_SIGN[text]
        elif text == "-":
            yield "sign", number, first, last, ""
        elif text in OTHER_BOUND:
            yield "bound", number, first, last, OTHER_BOUND[text]
        elif re.fullmatch(r"\d+u?", text) and (before in COUNTED or (before == "=" and "for (" in line)):
            yield "off-by-one", number, first, last, f"{int(text.rstrip('u')) + 1}{'u' * text.endswith('u')}"
        elif text == "(" and re.match(r"[A-Za-z_]", before) and before not in ANY_ORDER | {"if", "for", "while"}:
            closing = _closing(line, first)
            spans = _arguments(line, first, closing) if closing > 0 else []
            for (a, b), (c, d) in pairwise(spans):
                if line[a:b] != line[c:d]:
                    yield "swap", number, a, d, line[c:d] + line[b:c] + line[a:b]
        before = text


def glsl_sites(lines: list[str]) -> list[Site]:
    """Columns count bytes; the chunks' code is ASCII up to a comment."""
    result: list[Site] = []
    for number, whole in enumerate(lines, start=1):
        line = whole.split("//")[0].rstrip()
        if line.isascii() and not DECLARES.match(line) and not (DEFINES.match(line) and line[:1].isalpha()):
            result.extend(_line_sites(line, number))
    return result
