"""Certificate, token, accounts and watermark key of a server: files that the user names, or that are made and kept."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from glsplat.errors import GlsplatError
from glsplat.net.guard.access import is_loopback, read_token, server_tls
from glsplat.net.guard.host_info import machine_names, reachable_at
from glsplat.net.guard.state_dir import TOKEN, kept_token, state_folder
from glsplat.net.rights import Accounts
from glsplat.optional import has_extra, missing, require_package

from ..usage import UsageError
from .options import ServeOptions, naming_option

if TYPE_CHECKING:
    from glsplat.net.session import WatermarkKey


@dataclass(frozen=True, slots=True)
class Keys:
    """TLS and token of one server, each None where it has none."""

    tls: tuple[Path, Path] | None = None  # certificate and key, PEM
    token: str | None = field(default=None, repr=False)
    token_file: Path | None = None
    fingerprint: str | None = None  # of a certificate made here
    accounts: Accounts | None = None


def keys_of(args: ServeOptions) -> Keys:
    """Return the keys that the options name; some are made here. Raises UsageError, GlsplatError naming the file."""
    if args.self_signed and (args.tls_cert or args.tls_key):
        raise UsageError("--self-signed makes a certificate of its own; leave it out, or tls-cert and tls-key")
    if (args.tls_cert is None) != (args.tls_key is None):
        raise UsageError("TLS needs both tls-cert and tls-key")
    if args.users and args.token_file:
        raise UsageError("a server has one token (token-file) or accounts (--users), not both; leave one out")
    accounts = None
    if args.users is not None:
        from glsplat.extras.accounts.users import Accounts  # here: few servers have accounts

        with naming_option(args, "users"):
            accounts = Accounts(args.users)
    token_file: Path | None = args.token_file
    with naming_option(args, "token-file"):
        token = None if token_file is None else read_token(token_file)
    if not args.self_signed:
        tls = None if args.tls_cert is None or args.tls_key is None else (args.tls_cert, args.tls_key)
        if tls is not None:
            with naming_option(args, "tls-cert"):
                server_tls(*tls)  # the server reads it once it starts
        return Keys(tls, token, token_file, accounts=accounts)

    require_package("--self-signed", "cryptography", "server", "give tls-cert and tls-key")
    from glsplat.extras.operations.certificate import holds, kept_certificate  # here: it loads what others do not need

    folder = state_folder()
    names = (*args.allow_host, *filter(holds, machine_names()), *reachable_at(args.host))
    kept = kept_certificate(folder, names)
    if kept.remade:
        log = logging.getLogger("glsplat.serve")
        log.warning("made a new certificate (%s): browsers will ask to accept it", kept.remade)
    if token is None and accounts is None and not is_loopback(args.host) and not args.insecure:
        token, token_file = kept_token(folder), folder / TOKEN
    return Keys((kept.path, kept.path), token, token_file, kept.fingerprint, accounts)


def watermark_of(args: ServeOptions) -> WatermarkKey | None:
    """Return the key that marks pictures: read, or made and kept; None with a warning where that fails.

    Raises GlsplatError naming the file, for watermark = "on" too.
    """
    if args.watermark == "off":
        return None
    log = logging.getLogger("glsplat.serve")
    if args.watermark is None and not has_extra("watermark"):
        log.warning("pictures are not marked: %s", missing("watermark", "a watermark"))
        return None
    from glsplat.extras.watermark.keys import kept_watermark, read_watermark

    if args.watermark not in (None, "on"):
        with naming_option(args, "watermark"):
            return read_watermark(Path(args.watermark))
    try:
        return kept_watermark(state_folder())
    except GlsplatError as error:
        if args.watermark == "on":
            raise
        log.warning("pictures are not marked: %s, or set watermark to off", error)
        return None
