"""Smaller seeds of the two fuzzers; by hand they ran over 1,000,000 messages and 100,000 byte streams."""

from __future__ import annotations

import json

import pytest

from glsplat.data import default_avatar
from glsplat.net.messages import PARTS, Decoder
from tests.net.attacks.fuzz_bytes import send
from tests.net.attacks.fuzz_messages import fuzz, valid
from tests.net.attacks.light import light_avatar
from tests.net.attacks.victim import victim

pytestmark = pytest.mark.check


@pytest.mark.parametrize("seed", [1, 2])
def test_fuzzed_messages(seed):
    findings = fuzz(3000, seed)
    assert findings.faults == [], findings.faults[0]
    assert sum(findings.outcomes.values()) == 3000
    # the mutations are neither so wild that all is refused at once nor so tame that nothing is
    assert findings.outcomes["accepted"] > 300 and findings.outcomes["bad_field"] > 300
    assert findings.slowest[0] < 10_000 * findings.usual, findings  # of this thread's own time


def test_what_is_mutated_is_valid_before():
    decoder = Decoder(skeleton=default_avatar().skeleton, parts=frozenset(PARTS))
    for form in valid(1):
        decoder.decode(json.dumps(form))


@pytest.mark.gl
def test_fuzzed_byte_streams(tmp_path):
    with victim(str(light_avatar(tmp_path)), "--size", "64x64") as server:
        sent = send(server, 400, 3, threads=4)
        assert server.alive() and not sent.dead
        assert "Traceback" not in server.log, server.log[-3000:]
        assert server.log_lines <= 60, server.log[-3000:]
    assert sent.streams == 400
    assert any("400" in answer for answer in sent.answers) and any("101" in answer for answer in sent.answers)
