"""A real server under attack, in short: what a well-behaved client keeps while somebody else does not behave.

The campaign (``python -m tests.net.attacks.campaign``) runs all attacks for longer and prints a table.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from dataclasses import replace

import pytest

from tests.net.attacks.attack import ATTACKS, EVERYTHING, attackers
from tests.net.attacks.campaign import Outcome, measure
from tests.net.attacks.light import light_avatar
from tests.net.attacks.victim import victim

pytestmark = [pytest.mark.gl, pytest.mark.timeout(240)]

MEASURED = [
    "pings",
    "63 kB with an old frame_id",
    "tracking",
    "collapsed body, 40 image sizes",
    "64^2 to 1536^2",
    "specks of 1 x 1",
    "does not read",
    "clients that end at once",
]
ROUNDS = 5
LEAST, MOST = 0.5, 3.0
"""What the median of all rounds may not miss where no round of 1.5 s was as promised (0.7 of the rate, twice the age).

Before there were limits, attacks left 0 to 0.1 of the rate at 6 to 25 times the age. Whether the promise itself holds,
the campaign tells: its phases are long enough for a machine that has other work.
"""
REST = [name for name in ATTACKS if name not in MEASURED]
addresses = itertools.count(10)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """``glsplat serve`` with default options and a light scene, and its attackers."""
    with victim(str(light_avatar(tmp_path_factory.mktemp("attacks")))) as running, attackers(running.port) as raiders:
        yield running, raiders


def attacked(server, name, connections=4, seconds=1.5):
    """An outcome that is as promised; else the median of all rounds, as a machine with other work has bad seconds.

    The attackers come from an address that no attack came from before.
    """
    rounds: list[Outcome] = []
    for _ in range(ROUNDS):
        asked = {"connections": connections, "seconds": seconds, "quiet": 0.8, "hertz": 6.0, "size": 64}
        rounds.append(asyncio.run(measure(*server, name, sources=[f"127.0.1.{next(addresses)}"], warm=0.5, **asked)))
        if rounds[0].held:
            return rounds[0]
    return merged(rounds)


def merged(rounds):
    """Several outcomes of one attack as one of several rounds."""
    calm = [outcome.quiet[0] for outcome in rounds] + [rounds[-1].quiet[-1]]
    return replace(
        rounds[-1],
        quiet=calm,
        attacked=[outcome.attacked[0] for outcome in rounds],
        alive=all(outcome.alive for outcome in rounds),
        log_lines=max(outcome.log_lines for outcome in rounds),
    )


@pytest.mark.parametrize("name", MEASURED)
def test_a_good_client_keeps_its_pictures(server, name):
    """At least 70 % of the undisturbed rate at no more than twice the median age, or not far from it in every round."""
    outcome = attacked(server, name)
    rate, age = outcome.ratios
    assert outcome.alive, server[0].log[-2000:]
    assert outcome.held or (rate >= LEAST and age <= MOST), f"{outcome}\n{server[0].log[-1000:]}"
    assert outcome.log_lines <= 60, server[0].log[-3000:]


def test_all_at_once_from_sixteen_connections(server):
    outcome = attacked(server, EVERYTHING, connections=16, seconds=4.0)
    rate, age = outcome.ratios
    assert outcome.alive, server[0].log[-2000:]
    assert outcome.held or (rate >= LEAST and age <= MOST), f"{outcome}\n{server[0].log[-1000:]}"


def test_the_other_attacks_leave_the_server_well(server):
    """A third of a second of each: it stays healthy and its log short; what they cost is the campaign's to measure."""
    running, raiders = server
    before = running.log_lines
    for name in REST:
        raiders.begin(name, f"127.0.2.{next(addresses)}", 4)
        time.sleep(0.3)
        raiders.end()
        assert running.process.poll() is None, f"{name} ended the server: {running.log[-2000:]}"
    assert running.alive()
    assert "Traceback" not in running.log
    assert running.log_lines - before <= 20 * len(REST), running.log[-3000:]


def test_without_descriptors(tmp_path):
    """100 idle connections on a server that may have 48 files: no flood of log lines, and it serves on."""
    with victim(str(light_avatar(tmp_path)), files=48) as running, attackers(running.port) as raiders:
        outcome = attacked((running, raiders), "idle connections", connections=1)
        rate, age = outcome.ratios
        assert outcome.alive and "Traceback" not in running.log
        assert outcome.held or (rate >= LEAST and age <= MOST), f"{outcome}\n{running.log[-1000:]}"
        assert running.log_lines <= 10, running.log[-3000:]
