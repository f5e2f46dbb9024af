"""Which client a trusted proxy speaks for: the words of proxies and of clients that make up their own."""

from __future__ import annotations

import random
import time
from typing import Any

import pytest
from multidict import CIMultiDict, CIMultiDictProxy

from glsplat.errors import GlsplatError
from glsplat.net.guard.forwarded import MAX_CHARACTERS, TrustedProxies, proxy_network

PROXIES = TrustedProxies([proxy_network(text) for text in ("127.0.0.1", "10.0.0.0/8", "2001:db8:1::/48")])


def client(*lines: tuple[str, str]) -> str | None:
    return PROXIES.client(CIMultiDictProxy(CIMultiDict(lines)))


def listed(*lines: str) -> str | None:
    return client(*(("x-forwarded-for", line) for line in lines))


def forwarded(*lines: str) -> str | None:
    return client(*(("forwarded", line) for line in lines))


Cases = dict[str | None, list[tuple[str, ...]]]
X_FORWARDED_FOR: Cases = {
    "192.0.2.7": [
        ("192.0.2.7",),
        ("6.6.6.6, 192.0.2.7",),  # what the client wrote itself is left of what its proxy added
        ("127.0.0.1, 192.0.2.7",),
        ("6.6.6.6", "192.0.2.7"),  # the lines of a header are one list (RFC 9110, section 5.3)
        ("6.6.6.6, 192.0.2.7, 10.1.2.3, 127.0.0.1",),  # two proxies in a row before this one
        ("6.6.6.6, 192.0.2.7", "10.1.2.3"),
        ("192.0.2.7:4711",),
        ("::ffff:192.0.2.7",),
        ("192.0.2.7, ::ffff:10.0.0.1",),
        (" \t192.0.2.7 , ,",),
        ("<script>, 192.0.2.7",),
    ],
    "2001:db8::7": [("2001:db8::7",), ("[2001:db8::7]",), ("[2001:db8::7]:443, 2001:db8:1::1",)],
    "10.0.0.2": [("10.0.0.2, 10.0.0.3",)],  # a client in a proxy's network
    None: [
        *(("unknown",), ("",), (",",), ("٣.0.2.7",), ("192.0.2.7, _hidden, 10.0.0.1",)),
        *(
            (f"192.0.2.7, {last}",)
            for last in ("unknown", "192.0.2.08", "999.0.2.7", "[::1", "fe80::1%eth0", "localhost")
        ),
    ],
}
FORWARDED: Cases = {
    "192.0.2.43": [("for=192.0.2.43",)],
    "2001:db8:cafe::17": [('For="[2001:db8:cafe::17]:4711"',)],
    "192.0.2.60": [("for=192.0.2.60;proto=http;by=203.0.113.43",), ("proto=https; FOR=192.0.2.60 ;by=_proxy",)],
    "198.51.100.17": [
        ("for=192.0.2.43, for=198.51.100.17",),
        ("for=192.0.2.43", "for=198.51.100.17"),
        ("for=198.51.100.17, for=10.0.0.1",),
    ],
    "192.0.2.1": [
        ('for="192.0.2.1:_port"',),
        ('for="192.0.2\\.1"',),
        ('for=6.6.6.6;host="a,b;for=7.7.7.7", for=192.0.2.1',),
        ("for=192.0.2.1;",),
        ("for=192.0.2.1, ,",),
        ('for="', "for=192.0.2.1"),  # a line of its own is read by itself
    ],
    None: [
        *((f"for=192.0.2.43, {last}",) for last in ("for=unknown", "for=_gazonk", 'for="_SEVKISEK:80"', "proto=https")),
        *(('for=", for=192.0.2.1',), ('x=", for="[2001:db8::1]"',)),  # nobody can tell where the quotation ends
        *(("for=1.1.1.1;for=2.2.2.2",), ("for=6.6.6.6, 192.0.2.1",), ("for",), ("for=",), ("",)),
    ],
}


@pytest.mark.parametrize(
    ("read", "expected", "lines"),
    [
        (read, expected, lines)
        for read, table in ((listed, X_FORWARDED_FOR), (forwarded, FORWARDED))
        for expected, cases in table.items()
        for lines in cases
    ],
)
def test_the_client_that_a_header_names(read: Any, expected: str | None, lines: tuple[str, ...]) -> None:
    assert read(*lines) == expected


def test_two_headers_have_to_agree() -> None:
    """A proxy sets one of them and passes the other on, which its client may have made up."""
    same, other = ("Forwarded", "for=192.0.2.1"), ("Forwarded", "for=6.6.6.6")
    ours = "X-Forwarded-For", "192.0.2.1"
    assert client(ours, same) == "192.0.2.1"
    assert client(ours, other) is client(ours, ("Forwarded", "nonsense")) is client() is None


@pytest.mark.parametrize("name", ["X-Forwarded-For", "Forwarded"])
def test_headers_without_end_are_not_read(name: str) -> None:
    hop = "192.0.2.1" if name == "X-Forwarded-For" else "for=192.0.2.1"
    for count, expected in ((1, hop.removeprefix("for=")), (MAX_CHARACTERS, None)):
        assert client((name, "," * (MAX_CHARACTERS - len(hop) - 2 + count) + hop)) == expected
        assert client(*[(name, ",")] * (MAX_CHARACTERS - len(hop) - 2 + count), (name, hop)) == expected


def test_no_header_takes_long() -> None:
    """A client sends them: blanks that a pattern tries one by one took 0.2 s each."""
    room = MAX_CHARACTERS - 30
    began = time.thread_time()
    for line in (
        " " * room + "=",
        "for=1.1.1.1," + " " * room + "=",
        "a=" * (room // 2),
        'for="' + "\\a" * (room // 2),
    ):
        for _ in range(20):
            assert forwarded(line) is listed(line) is None
    assert time.thread_time() - began < 2.0  # else 16


def test_a_client_cannot_be_somebody_else() -> None:
    """Whatever it sends, behind a proxy that appends it is who it is, or at worst nobody: never whom it names."""
    rng = random.Random(5)
    parts = ["6.6.6.6", "for=6.6.6.6", "10.0.0.1", "for=10.0.0.1", "127.0.0.1", "::1", "for=", "x=", 'host="']
    parts += [*'"\\,;= []\té', "unknown", "_a"]
    for _ in range(1_000):
        made_up = "".join(rng.choice(parts) for _ in range(rng.randrange(12)))
        added = rng.choice(("192.0.2.1", "192.0.2.1, 10.0.0.9"))
        assert listed(made_up + ", " + added) == listed(made_up, added) == "192.0.2.1", made_up
        for node in ("for=192.0.2.1", 'for="192.0.2.1:80";proto=https;host="a"', 'for="192.0.2.1", for=10.0.0.9'):
            assert forwarded(made_up + ", " + node) in ("192.0.2.1", None), made_up
            assert forwarded(made_up, node) == "192.0.2.1", made_up


def test_which_peers_are_trusted() -> None:
    for host in ("127.0.0.1", "::ffff:127.0.0.1", "10.255.0.1", "2001:db8:1:2::3", "2001:db8:1::3%eth0"):
        assert PROXIES.trusts(host), host
    for host in ("127.0.0.2", "11.0.0.1", "2001:db8:2::3", "", "unix:", "::"):
        assert not PROXIES.trusts(host), host
    assert not TrustedProxies(()).trusts("127.0.0.1")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("10.0.0.5/8", "expected an address or a network such as 10.0.0.0/8, found '10.0.0.5/8': .* host bits"),
        ("localhost", "expected an address"),
        ("", "expected an address"),
        ("10.0.0.0/33", "expected an address"),
        ("0.0.0.0/0", "trusts every client"),
        ("::/0", "trusts every client"),
        ("::ffff:10.0.0.0/104", "write IPv4 networks as IPv4"),
    ],
)
def test_networks_that_cannot_be_meant(text: str, words: str) -> None:
    with pytest.raises(GlsplatError, match=words):
        proxy_network(text)
