"""``--mine``: who makes an avatar of their own photograph says so once, and nothing else has to be signed."""

from __future__ import annotations

import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

from glsplat.extras.consent.document import ANYBODY
from glsplat.extras.consent.file import sign_data
from glsplat.extras.consent.state import kept_key
from glsplat.io.files import replace_file
from glsplat.net.guard.state_dir import state_folder

__all__ = ["sign_mine"]

_LASTS = timedelta(days=365)
_SUBJECT, _SAID = "the person of the photograph", "whoever made it on this computer"
_PURPOSE = "to be shown and driven as an avatar; whoever made it said: this is me, or this person agreed"


def sign_mine(path: Path) -> None:
    """Sign the avatar at ``path`` with the key that servers of this user sign with (``consent-key``), for a year.

    The splats are not handed out by it. Raises GlsplatError naming the file.
    """
    key = kept_key(state_folder())
    today = datetime.now(UTC).date()
    signed = sign_data(
        path.read_bytes(),
        key,
        subject=_SUBJECT,
        given_by=_SAID,
        purpose=_PURPOSE,
        start=today,
        until=today + _LASTS,
        drivers=[ANYBODY],
    )
    replace_file(path, [signed])
    print(f"{path}: signed as yours until {today + _LASTS}; show it: glsplat serve {path}", file=sys.stderr)
