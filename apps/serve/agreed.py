"""Consent to be shown by this server: the records of the files, and the options trust and without-consent."""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from glsplat.errors import GlsplatError
from glsplat.extras.consent.document import ANYBODY
from glsplat.extras.consent.file import OnFile, on_file, on_file_data, sign_data
from glsplat.extras.consent.keys import PrivateKey, kept_key, known_key, public_key
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.formats.scene_file import SceneFile
from glsplat.net.guard.access import is_loopback
from glsplat.net.guard.state_dir import state_folder
from glsplat.scene import is_rigged

from .options import ServeOptions, naming_option

if TYPE_CHECKING:
    from glsplat.extras.uploads.job import UploadConfig

_LASTS = timedelta(days=365)  # the consent to an avatar that a client has made
_SUBJECT, _SENDER = "the person of the photograph", "whoever sent the photograph"
_PURPOSE = "to be shown and driven as an avatar by this server; the sender said: this is me, or this person agreed"


def policy_of(args: ServeOptions, scene: SceneFile, name: str) -> ConsentPolicy:
    """Return the consent to ``scene``, called ``name``, and of --avatar. Raises GlsplatError where one is missing."""
    with naming_option(args, "trust"):
        trusted = [public_key(path) for path in args.trust] or None
    policy = ConsentPolicy(trusted=trusted, without=args.without_consent)
    own = None
    if trusted is None and args.users is None and is_loopback(args.host):
        with suppress(GlsplatError):  # without a state folder no key was made
            own = known_key(state_folder())  # which signs avatars of --mine and of the page
        if own is not None:
            policy.trust_own(own.public)
    if args.scene is None:
        policy.add(name, [OnFile(nobody=True)])
    else:
        files = dict.fromkeys(path for item, path in scene.sources if is_rigged(item.content))
        policy.add(name, [on_file(path) for path in files], driven=scene.avatar is not None)
    for path in args.avatar:
        policy.add(path.stem, [on_file(path)])
    for one in (name, *(path.stem for path in args.avatar)):
        policy.check(one, time.time())
        for line in policy.doubts(one, accounts=args.users is not None):
            logging.getLogger("glsplat.serve").warning(line)
    return policy


def signing(uploads: UploadConfig | None, policy: ConsentPolicy) -> UploadConfig | None:
    """Return ``uploads`` with a signature for new avatars, by a key that this server keeps and trusts."""
    if uploads is None:
        return None
    key = kept_key(state_folder())
    policy.trust_own(key.public)
    return replace(uploads, signed=_Signing(key, policy))


class _Signing:
    def __init__(self, key: PrivateKey, policy: ConsentPolicy) -> None:
        self._key, self._policy = key, policy

    def __call__(self, name: str, data: bytes, account: str) -> bytes:
        """Return the file with a consent record for ``account`` ("" without accounts). Called on any thread."""
        today = datetime.now(UTC).date()
        signed = sign_data(
            data,
            self._key,
            subject=_SUBJECT,
            given_by=account or _SENDER,
            purpose=_PURPOSE,
            start=today,
            until=today + _LASTS,
            drivers=[account or ANYBODY],
        )
        self._policy.add(name, [on_file_data(signed)])
        return signed
