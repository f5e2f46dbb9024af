"""Budgets of clients and addresses, with a clock made of numbers."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from glsplat.net.guard import gate
from glsplat.net.guard.addresses import Addresses
from glsplat.net.guard.limits import Bucket, ClientQuota, Limits, Strikes, address_key
from glsplat.net.guard.meter import FrameMeter
from glsplat.net.options import ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.wire import frame, full_hands

LIMITS = Limits()
PING, TEXT = frame(0x9, b""), 0x1


def meter(limits=LIMITS):
    return FrameMeter(ClientQuota(limits, 0.0), limits)


@pytest.mark.parametrize(
    ("host", "key"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2:ffff::1", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::1", "::/64"),
    ],
)
def test_what_counts_as_one_address(host, key):
    assert address_key(host) == key


def test_a_client_at_120_hz_with_full_hands_meets_no_limit():
    """Also with an acknowledgement a picture, a ping a second, and all that 20 s of a dead network held back."""
    client, now = meter(), 0.0
    text = frame(TEXT, full_hands(1).encode())
    assert 8_000 < len(text) < 12_000
    ack = frame(TEXT, b'{"v": 1, "ack": 7}')
    second = [text, ack] * 120 + [PING]
    for _ in range(2):
        held = b"".join(second * 20)  # arrives at once, in the pieces a socket gives
        for at in range(0, len(held), 65536):
            assert client.feed(held[at : at + 65536], now)[1] is None
        for i in range(60 * len(second)):
            now += 1 / len(second)
            assert client.feed(second[i % len(second)], now)[1] is None


@pytest.mark.parametrize("kind", ["control", "frames", "bytes"])
def test_a_flood_is_noticed_at_the_limit(kind):
    limits = Limits(frames=100, frames_burst=50, control=10, control_burst=20, bytes=1e6, bytes_burst=1e5)
    one = {"control": PING, "frames": frame(0x1, b"{}"), "bytes": frame(0x1, b"x" * 60_000)}[kind]
    client = meter(limits)
    allowed, breach = client.feed(one * 20, 0.0) if kind != "bytes" else client.feed(one, 0.0)
    assert breach is None and allowed == (20 if kind != "bytes" else 1) * len(one)
    if kind == "frames":
        assert client.feed(one * 30, 0.0) == (30 * len(one), None)
    allowed, breach = client.feed(one * 1000, 0.1)  # a tenth of a second brought some back
    assert breach.code == 1008 and "a second" in breach.reason
    assert allowed == {"control": 1, "frames": 10, "bytes": 0}[kind] * len(one)


def test_the_meter_counts_the_same_however_the_bytes_arrive():
    """Random frames of all kinds and lengths, cut at random: the frames that RFC 6455's layout says, and no others."""
    rng = random.Random(1)
    for _ in range(60):
        kinds = [rng.choice((0x0, 0x1, 0x2, 0x8, 0x9, 0xA)) for _ in range(40)]
        sizes = [rng.choice((0, 1, 5, 125)) if k & 8 else rng.choice((0, 7, 126, 300, 65536)) for k in kinds]
        data = b"".join(frame(k, bytes(rng.randbytes(n))) for k, n in zip(kinds, sizes, strict=True))
        limits = Limits(frames=0, control=0)
        client = meter(limits)
        at = 0
        while at < len(data):
            step = rng.choice((1, 1, 2, 3, 7, 100, 70_000))
            assert client.feed(data[at : at + step], 0.0) == (len(data[at : at + step]), None)
            at += step
        control = sum(k >= 8 for k in kinds)
        quota = client._quota
        assert quota.control.level == limits.control_burst - control
        assert quota.frames.level == limits.frames_burst - (len(kinds) - control)


def test_frames_without_a_mask_are_refused_at_once():
    for bare in (b"\x81\x02{}", b"\x89\x00", b"\x81\x7e\x01\x00" + b"x" * 256):
        for cut in (1, 2, len(bare)):
            client = meter()
            assert client.feed(frame(0x1, b"{}"), 0.0)[1] is None
            found = [client.feed(bare[:cut], 0.0)[1], client.feed(bare[cut:], 0.0)[1] if cut < 2 else None]
            assert [f.code for f in found if f is not None] == [1002]


def test_connecting_again_brings_no_fresh_budget():
    limits = Limits(frames=10, frames_burst=100, visits_burst=1e9)
    addresses, now, passed = Addresses(limits, per_address=2), 0.0, 0
    for _ in range(1000):  # a flooder that comes back as soon as it is thrown out, for 10 s
        quota = addresses.enter("a", now)
        allowed, breach = FrameMeter(quota, limits).feed(frame(0x1, b"") * 500, now)
        assert breach is not None
        passed += allowed // len(frame(0x1, b""))
        addresses.leave("a", quota, now)
        now += 0.01
    assert passed <= 2 * (limits.frames_burst + limits.frames * 10) + 2


def test_a_quiet_client_spends_from_its_own_purse():
    addresses = Addresses(Limits(), per_address=3)
    quiet = addresses.enter("a", 0.0)
    for _ in range(50):
        loud = addresses.enter("a", 0.0)
        while loud.frames.take(0.0):
            pass
        addresses.leave("a", loud, 0.0)
    assert quiet.fullness(0.0) == 1
    second = addresses.enter("a", 0.0)
    assert addresses.enter("a", 0.0) is not None and addresses.enter("a", 0.0) is None
    assert addresses.enter("b", 0.0) is not None
    addresses.leave("a", second, 0.0)
    assert addresses.enter("a", 0.0) is not None


def test_hold_offs_double_and_are_forgotten():
    strikes = Strikes(free=2, first=1.0, most=60.0, forget=600.0)
    waits = []
    for i in range(12):
        strikes.strike(i * 100.0)
        waits.append(strikes.wait(i * 100.0))
    assert waits == [0, 0, 1, 2, 4, 8, 16, 32, 60, 60, 60, 60]
    assert not strikes.forgotten(1700.0) and strikes.forgotten(1161.0 + 600.0)
    strikes.strike(5000.0)
    assert strikes.count == 1 and strikes.wait(5000.0) == 0


def test_the_table_of_addresses_is_bounded_and_keeps_those_that_matter():
    limits = Limits(addresses=100, guesses=0)
    addresses = Addresses(limits, per_address=4)
    quota = addresses.enter("client", 0.0)
    addresses.breach("bad", 0.0)
    for i in range(1_000):
        addresses.visit(f"stranger {i}", 1.0)
    assert len(addresses) == 100
    assert addresses.held_off("bad", 1.0) == 9.0 and addresses.held_off("stranger 3", 1.0) == 0
    for i in range(1_000):  # even if all of them are bad
        addresses.guess(f"guesser {i}", 2.0)
    assert len(addresses) == 100
    addresses.leave("client", quota, 3.0)


def test_a_bucket_takes_no_time_backwards():
    bucket = Bucket.full(10.0, 5.0, 100.0)
    assert all(bucket.take(100.0) for _ in range(5)) and not bucket.take(100.0)
    assert not bucket.take(90.0) and bucket.take(100.11)


PAGE = (Path(__file__).parents[3] / "docs" / "security.md").read_text(encoding="utf-8")
SERVER, SESSION = ServerConfig(), SessionConfig()
ROWS = {
    "clients (`max-clients`)": (f"{SERVER.max_clients}", ""),
    "clients of one address (`max-per-address`)": ("half of them; on loopback without `trusted-proxy` all", ""),
    "connections that are no clients (`max-waiting`)": (f"{LIMITS.waiting}", ""),
    "connections and HTTP requests of an address": (f"{LIMITS.visits:g} a second", f"{LIMITS.visits_burst:g}"),
    "files of the viewer (`/vr/…`)": ("a tenth of a request each", ""),
    "bytes before or between requests": (
        f"{LIMITS.head / 1024:g} KiB; {LIMITS.body / 1024:g} KiB with `--allow-upload`",
        "",
    ),
    "seconds for a whole request, or a TLS handshake": (f"{SESSION.handshake:g}", ""),
    "tokens of accounts whose hash is waited for": (f"{gate._MAX_LOGINS}", ""),
    "wrong tokens of an address": (f"{LIMITS.guesses + 1}, then one after 1, 2, 4 ... {LIMITS.hold_off_most:g} s", ""),
    "block of an address": (f"{LIMITS.hold_off:g} s, doubling up to {LIMITS.hold_off_most:g} s", ""),
    "addresses remembered": (f"{LIMITS.addresses}", ""),
}


def table() -> dict[str, tuple[str, str]]:
    section = PAGE[PAGE.index("\n## Limits\n") :]
    rows = re.findall(r"^\| ([^|]+?) \| ([^|]*?) ?\| ([^|]*?) ?\| [^|]+ \|$", section[: section.index("\n- ")], re.M)
    return {what: (limit, at_once) for what, limit, at_once in rows if what != "what"}


def test_every_row_says_what_the_code_does() -> None:
    assert table() == ROWS
