"""Keys that stand twice in a JSON object: found before anything is read."""

from __future__ import annotations

import json
import random

import pytest

from glsplat.net.messages import Decoder, has_duplicates
from glsplat.net.session import Session
from tests.net.wire import full_hands, native


def plain(text):
    """The same question answered by Python's own decoder alone."""
    found = []

    def pairs(items):
        found.append(len(items) != len(dict(items)))

    json.loads(text, object_pairs_hook=pairs)
    return any(found)


@pytest.mark.parametrize(
    "text",
    [
        '{"a": 1, "a": 1}',
        '{"a": 1, "\\u0061": 2}',
        '{"v": 1, "x": [1, {"b": 1, "b": 2}]}',
        '{"x": "a:b", "y": {"z": ":", "z": ":"}}',
        '{"x": [[[{"a": {}, "a": {}}]]]}',
    ],
)
def test_duplicate_keys_are_found_wherever_they_are(text):
    assert plain(text) and has_duplicates(text) and has_duplicates(text.encode())


@pytest.mark.parametrize(
    "text",
    [
        '{"a": {"a": {"a": ":::"}}}',
        '[{"a": 1}, {"a": 1}, [{"a": ":"}]]',
        '{"n": ":", "m": ' + "9" * 300 + "}",
        '":"',
        full_hands(3),
    ],
)
def test_equal_keys_of_different_objects_are_none(text):
    assert not has_duplicates(text)


def test_duplicate_keys_in_random_texts():
    rng = random.Random(2)

    def value(depth):
        kind = rng.random()
        if depth and kind < 0.35:
            keys = [rng.choice(("a", "b", "\\u0061", "c:", "d")) for _ in range(rng.randrange(4))]
            return "{" + ", ".join(f'"{key}": {value(depth - 1)}' for key in keys) + "}"
        if depth and kind < 0.6:
            return "[" + ", ".join(value(depth - 1) for _ in range(rng.randrange(4))) + "]"
        return rng.choice(("1", "-2.5e3", "null", '"x"', '":"', '"{\\"a\\": 1}"', "true"))

    texts = [value(4) for _ in range(4000)]
    answers = [plain(text) for text in texts]
    assert 200 < sum(answers) < 3800
    assert [has_duplicates(text) for text in texts] == answers


def test_a_session_refuses_duplicates():
    session = Session(Decoder())
    for text in (native(1)[:-1] + ', "frame_id": 2}', native(1).replace('"K"', '"K": [1, 1, 1, 1], "K"')):
        assert "gives a key twice" in session.receive(text, 0.0).text
    assert session.receive(native(1), 0.0).frame_id == 1 and session.counts.accepted == 1
