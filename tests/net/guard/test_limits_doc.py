"""The limits that docs/deploying.md promises are those of the code, row by row."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from glsplat.net.datagrams import udp
from glsplat.net.datagrams.offers import _KNOCKS, LASTS
from glsplat.net.datagrams.way import LONG
from glsplat.net.guard import gate, listener
from glsplat.net.guard.forwarded import MAX_CHARACTERS
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import MAX_BYTES
from glsplat.net.options import ServerConfig
from glsplat.net.session import SessionConfig
from glsplat.net.uploads.job import UploadConfig

PAGE = (Path(__file__).parents[3] / "docs" / "deploying.md").read_text(encoding="utf-8")
PROSE = " ".join(PAGE.split())
LIMITS, SERVER, SESSION = Limits(), ServerConfig(), SessionConfig()
UPLOADS = UploadConfig(folder=Path(), make=lambda order, progress: None)
assert LIMITS.file == 0.1 and LIMITS.uploads_unfinished == 0.25 and LIMITS.per_address is None
ROWS = {
    "clients (`--max-clients`)": (f"{SERVER.max_clients}", ""),
    "clients of one address (`--max-per-address`)": ("half of them; on loopback without `--trusted-proxy` all", ""),
    "connections that are no clients (`--max-waiting`)": (f"{LIMITS.waiting}", ""),
    "connections and HTTP requests of an address": (f"{LIMITS.visits:g} a second", f"{LIMITS.visits_burst:g}"),
    "files of the viewer (`/vr/…`)": ("a tenth of a request each", ""),
    "bytes before or between requests": (f"{LIMITS.head / 1024:g} KiB", ""),
    "the same with `--allow-upload`": (f"{LIMITS.body / 1024:g} KiB", ""),
    "requests to make an avatar, of an address": (f"{LIMITS.uploads:g} a second", f"{LIMITS.uploads_burst:g}"),
    "seconds in which an address sends pictures that are never complete": (
        "count as a quarter of such a request each",
        "",
    ),
    "senders of pictures of one address": (f"{UPLOADS.senders}", ""),
    "bytes of pictures a second, of a sender": (f"{UPLOADS.rate:g} at least", f"{UPLOADS.stall:g} s behind"),
    "seconds for the pictures of an avatar": (f"{UPLOADS.receive:g}", ""),
    "seconds for a whole request, or a TLS handshake": (f"{SESSION.handshake:g}", ""),
    "tokens of accounts whose hash is waited for": (f"{gate._MOST_LOGINS}", ""),
    "wrong tokens of an address": (f"{LIMITS.guesses + 1}, then one after 1, 2, 4 ... {LIMITS.hold_off_most:g} s", ""),
    "text and binary frames of a client": (f"{LIMITS.frames:g} a second", f"{LIMITS.frames_burst:g}"),
    "pings, pongs and closes of a client": (f"{LIMITS.control:g} a second", f"{LIMITS.control_burst:g}"),
    "bytes of a client": (f"{LIMITS.bytes / 2**20:g} MiB a second", f"{LIMITS.bytes_burst / 2**20:g} MiB"),
    "messages of a client": (f"{SESSION.rate:g} a second", f"{SESSION.burst}"),
    "bytes of a message": (f"{MAX_BYTES:,}".replace(",", " "), ""),
    "reading the messages and solving the tracking of all clients": (
        *(f"{LIMITS.work:g} s a second", f"{LIMITS.work:g} s"),
    ),
    "tracking samples of a client": (f"{LIMITS.samples:g} a second", f"{LIMITS.samples_burst:g}"),
    "block of an address": (f"{LIMITS.hold_off:g} s, doubling up to {LIMITS.hold_off_most:g} s", ""),
    "addresses remembered": (f"{LIMITS.addresses}", ""),
}
SENTENCES = [
    f"dropped with `rate`; {SESSION.flood} more: 1008",
    f"forgotten after {LIMITS.forget:g} s in order",
    f"clients who want poses) {LIMITS.work_alone:g} s",
    f"(`ulimit -n`): {listener._RESERVE} are kept for the server itself",
    f"connections that are no clients, {listener._FEWEST} at least",
    f"File descriptors: {listener._RESERVE}, one a client, and the {LIMITS.waiting} of `--max-waiting`",
    f"`max-clients` is {SERVER.max_clients};",
    f"an address connects {LIMITS.visits:g} times a second at most",
    f"more than {MAX_CHARACTERS} characters",
    f"More than {udp._STRAYS:g} packets a second that are for nobody ({udp._AT_ONCE:g} at once)",
    f"shut the port for {udp._SHUT:g} s;",
    f"for one use within {LASTS:g} s",
    f"For each secret {_KNOCKS} packets of its address",
    f"whose way there and back takes {LONG * 1e3:g} ms or more",
]


def table() -> dict[str, tuple[str, str]]:
    section = PAGE[PAGE.index("\n## Limits\n") :]
    rows = re.findall(r"^\| ([^|]+?) \| ([^|]*?) ?\| ([^|]*?) ?\| [^|]+ \|$", section[: section.index("\n- ")], re.M)
    return {what: (limit, at_once) for what, limit, at_once in rows if what != "what"}


def test_every_row_says_what_the_code_does() -> None:
    assert table() == ROWS


@pytest.mark.parametrize("words", SENTENCES)
def test_numbers_in_the_text(words: str) -> None:
    assert words in PROSE


def test_how_long_an_invited_handshake_has() -> None:
    pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")
    from glsplat.net.datagrams import path

    assert f"by way of a Retry (RFC 9000, section 8.1), which has {path._HANDSHAKE:g} s" in PROSE
