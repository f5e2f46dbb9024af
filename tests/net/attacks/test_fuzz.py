"""The two fuzzers in short; tools/attacks/fuzz.py runs them for longer."""

from __future__ import annotations

import os

import pytest

from tests.net.attacks.fuzz_bytes import send
from tests.net.attacks.fuzz_messages import fuzz
from tests.net.attacks.light import light_avatar
from tests.net.attacks.victim import victim


def test_fuzzed_messages():
    number = 3000 if os.environ.get("HYPOTHESIS_PROFILE") == "check" else 500
    findings = fuzz(number, 1)
    assert findings.faults == [], findings.faults[0]
    assert sum(findings.outcomes.values()) == number
    # the mutations are neither so wild that all is refused at once nor so tame that nothing is
    assert min(findings.outcomes["accepted"], findings.outcomes["bad_field"]) > number / 10


@pytest.mark.check
@pytest.mark.gl
def test_fuzzed_byte_streams(tmp_path):
    with victim(str(light_avatar(tmp_path)), "--size", "64x64") as server:
        sent = send(server, 300, 3)
        assert server.alive() and not sent.dead
        assert "Traceback" not in server.log, server.log[-3000:]
        assert server.log_lines <= 60, server.log[-3000:]
    assert sent.streams == 300
    assert any("400" in answer for answer in sent.answers) and any("101" in answer for answer in sent.answers)
