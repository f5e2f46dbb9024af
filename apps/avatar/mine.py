"""``--mine``: sign the consent to an avatar of one's own photograph."""

from __future__ import annotations

import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

from glsplat.extras.consent.document import ANYBODY
from glsplat.extras.consent.file import sign_data
from glsplat.extras.consent.keys import kept_key
from glsplat.io.files import replace_file
from glsplat.net.guard.state_dir import state_folder

_VALIDITY = timedelta(days=365)
_SUBJECT, _GIVEN_BY = "the person of the photograph", "whoever made it on this computer"
_PURPOSE = "to be shown and driven as an avatar; whoever made it said: this is me, or this person agreed"


def sign_mine(path: Path) -> None:
    """Sign the avatar at ``path`` for a year, with the key of this user's servers (``consent-key``).

    The record does not allow handing out splats. Raises GlsplatError, which names the file.
    """
    key = kept_key(state_folder())
    today = datetime.now(UTC).date()
    signed = sign_data(
        path.read_bytes(),
        key,
        subject=_SUBJECT,
        given_by=_GIVEN_BY,
        purpose=_PURPOSE,
        start=today,
        until=today + _VALIDITY,
        drivers=[ANYBODY],
    )
    replace_file(path, [signed])
    print(f"{path}: signed as yours until {today + _VALIDITY}; show it: glsplat serve {path}", file=sys.stderr)
