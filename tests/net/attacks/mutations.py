"""Seeded mutations: of JSON as a structure, of text, of bytes."""

from __future__ import annotations

import copy
import json
from random import Random
from typing import Any

__all__ = ["damaged", "mutated", "written"]

NUMBERS: list[Any] = [
    *(0, -0.0, 1, -1, 2, 8, 9, 100, 101, 2048, 2049, 2**31, 2**32 - 1, 2**32, 2**53, 2**63, 2**64, -(2**63), 10**40),
    *(0.5, 1e-320, 1e-30, 1e6, 1e7, 1e17, 1e300, 1.7976931348623157e308, 3.4e38, 1e39, 0.1 + 0.2, -1e-9),
]
VALUES: list[Any] = [
    *(None, True, False, "", "x", "\0", "\ud800", "left", "right", "root_pose", "1", "NaN", "é" * 40, "a" * 2000),
    *([], [[]], [[[]]], {}, {"": {}}, [0] * 3, [0.0] * 7, [1] * 16, [0] * 63, [[0, 0, 0]] * 21, [[0, 0, 0]] * 300),
    *([None] * 3, ["1"] * 3, [1e300] * 16, {"x": 1, "y": 2, "z": 3}, [[1, [2, 3]]], [True] * 4),
]
TOKENS = ["NaN", "-Infinity", "1e999", "-1e999", "1E400", "0x10", "01", "+1", ".5", "5.", "1e", "--1", "'", '"', "\\"]
TOKENS += ["[" * 500, "]" * 40, "{" * 500, '{"":' * 300, ",", ",,", ":", "null", "/**/", "\\u0000", "\\ud800", "\x00"]
TOKENS += ["\ufeff", "\u2028", "1" * 400, "0." + "0" * 400 + "1", "1e-" + "9" * 30, " " * 1000, "\x7f", "\U0010ffff"]


def place(node: Any, chance: Random) -> tuple[Any, Any] | None:
    """A (container, key) somewhere in a JSON value; None where it holds nothing."""
    found = None
    while isinstance(node, dict | list) and node and (found is None or chance.random() < 0.6):
        key = chance.choice(list(node)) if isinstance(node, dict) else chance.randrange(len(node))
        found = node, key
        node = node[key]
    return found


def mutated(message: dict[str, Any], other: dict[str, Any], chance: Random) -> dict[str, Any]:
    """One to four changes in place; ``other`` gives parts to put where they do not belong."""
    for _ in range(chance.choice((1, 1, 1, 2, 3, 4))):
        spot, donor = place(message, chance), place(other, chance)
        if spot is None:
            message["v"] = chance.choice(NUMBERS)
            continue
        node, key = spot
        old = node[key]
        match chance.randrange(9):
            case 0:
                node[key] = copy.deepcopy(chance.choice(VALUES))
            case 1:
                node[key] = chance.choice(NUMBERS)
            case 2:
                node[key] = -old if type(old) in (int, float) else None
            case 3 if type(old) in (int, float):
                node[key] = old + chance.gauss(0, 10.0 ** chance.randint(-6, 6))
            case 4:
                del node[key]
            case 5 if isinstance(old, list):
                old *= chance.randint(0, 3)
            case 6 if isinstance(old, list) and old:
                old.insert(chance.randint(0, len(old)), copy.deepcopy(chance.choice(old)))
            case 7 if donor is not None:
                node[key] = copy.deepcopy(donor[0][donor[1]])
            case _ if isinstance(node, dict):
                node[chance.choice(("v", "ack", "t", "head", "eye", "K", "", "x" * 50, f"{key} "))] = copy.deepcopy(old)
    return message


def written(message: dict[str, Any], chance: Random) -> str:
    """As JSON text: mostly as it should be, at times with doubled keys, other spacing or escapes."""
    text = json.dumps(
        message, ensure_ascii=chance.random() < 0.9, separators=(",", ":") if chance.random() < 0.5 else None
    )
    if chance.random() < 0.05 and message:
        key = chance.choice(list(message))
        text = text[:-1] + f",{json.dumps(key)}:{json.dumps(chance.choice(NUMBERS))}}}"
    return text


def damaged(text: str, other: str, chance: Random) -> str:
    """One to three changes of the text itself."""
    for _ in range(chance.randint(1, 3)):
        at, to = sorted((chance.randint(0, len(text)), chance.randint(0, len(text))))
        match chance.randrange(6):
            case 0:
                text = text[:at]
            case 1:
                text = text[:at] + chance.choice(TOKENS) + text[at:]
            case 2:
                text = text[:at] + text[to:]
            case 3:
                text = text[:at] + other[chance.randint(0, len(other)) :]
            case 4:
                text = text[:at] + text[at : at + 200] * chance.randint(1, 30) + text[at:]
            case _:
                text = (
                    text[:at]
                    + chr(chance.choice((0, 9, 34, 44, 58, 91, 93, 123, 125, 0x7F, 0xE9, 0xFFFF)))
                    + text[at + 1 :]
                )
    return text[:70_000]
