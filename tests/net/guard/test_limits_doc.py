"""The limits that docs/deploying.md promises are those of the code, row by row."""

from __future__ import annotations

import re
from pathlib import Path

from glsplat.net.guard import gate
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import MAX_BYTES
from glsplat.net.options import ServerConfig
from glsplat.net.session import SessionConfig
from glsplat.net.uploads.job import UploadConfig

PAGE = (Path(__file__).parents[3] / "docs" / "deploying.md").read_text(encoding="utf-8")
LIMITS, SERVER, SESSION = Limits(), ServerConfig(), SessionConfig()
UPLOADS = UploadConfig(folder=Path(), make=lambda order, progress: None)
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


def table() -> dict[str, tuple[str, str]]:
    section = PAGE[PAGE.index("\n## Limits\n") :]
    rows = re.findall(r"^\| ([^|]+?) \| ([^|]*?) ?\| ([^|]*?) ?\| [^|]+ \|$", section[: section.index("\n- ")], re.M)
    return {what: (limit, at_once) for what, limit, at_once in rows if what != "what"}


def test_every_row_says_what_the_code_does() -> None:
    assert table() == ROWS
