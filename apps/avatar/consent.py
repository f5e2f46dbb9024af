"""``glsplat avatar consent``: sign a consent record into an avatar's file; also ``--mine`` and ``inspect``."""

from __future__ import annotations

import argparse
import re
import sys
import time
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

from glsplat.extras.consent.document import ANYBODY
from glsplat.extras.consent.file import OnFile, sign_data, sign_file
from glsplat.extras.consent.keys import kept_key, new_key, private_key, public_path
from glsplat.io.files import replace_file

from ..usage import UsageError

_PURPOSE = "to be shown and driven as an avatar"
_MINE_VALIDITY = timedelta(days=365)
_MINE_SUBJECT, _MINE_GIVEN_BY = "the person of the photograph", "whoever made it on this computer"
_MINE_PURPOSE = "to be shown and driven as an avatar; whoever made it said: this is me, or this person agreed"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="avatar (.glb) to write the record into")
    parser.add_argument("--sign", type=Path, metavar="KEY", help="private key that signs (of --new-key)")
    parser.add_argument("--subject", help="who is shown")
    parser.add_argument("--given-by", metavar="NAME", help="who agreed (default: the subject)")
    parser.add_argument("--purpose", default=_PURPOSE, help="what it is for (default: %(default)s)")
    parser.add_argument("--from", type=_day, dest="start", metavar="DATE", help="first day, UTC (default: today)")
    parser.add_argument("--until", type=_day, metavar="DATE", help="last day, UTC, such as 2026-12-31")
    parser.add_argument(
        "--drivers", metavar="A,B", help=f"accounts that may drive (glsplat users), or {ANYBODY} for everybody"
    )
    parser.add_argument(
        "--hand-out",
        action="store_true",
        help="the splats themselves may be given to those who are shown them, so that their browsers draw",
    )
    parser.add_argument("-o", "--out", type=Path, help="file to write instead of FILE")
    parser.add_argument("--new-key", type=Path, metavar="KEY", help="make a key: KEY is for you alone, KEY.pub for all")


def run(args: argparse.Namespace) -> int:
    """Make a key, sign a file, or both; 0 on success."""
    if args.new_key is None and args.file is None:
        raise UsageError("give an avatar to sign, or --new-key KEY to make a key")
    options = ("sign", "subject", "given_by", "start", "until", "drivers", "hand_out", "out")
    given = [name for name in options if getattr(args, name)]
    if args.file is None and given:
        raise UsageError(f"--{given[0].replace('start', 'from').replace('_', '-')} needs an avatar to sign")
    fields: dict[str, Any] = {} if args.file is None else _fields(args)
    if args.new_key is not None:
        made = new_key(args.new_key)
        print(f"{args.new_key}: private, keep it to you; {public_path(args.new_key)}: public key {made.public}")
    if args.file is None:
        return 0
    key = private_key(args.sign)
    out = args.out or args.file
    sign_file(args.file, out, key, **fields)
    drivers = "everybody" if ANYBODY in fields["drivers"] else ", ".join(fields["drivers"])
    days = f"from {fields['start']} until {fields['until']}"
    print(f"{out}: {fields['subject']}, {days}, may be driven by {drivers}{_handing_out(fields)}")
    return 0


def _fields(args: argparse.Namespace) -> dict[str, Any]:
    for name in ("subject", "until", "drivers", "sign"):
        if not getattr(args, name):
            raise UsageError(f"a consent needs --{name}")
    start = args.start or datetime.now(UTC).date()
    if args.until < start:
        raise UsageError(f"--until {args.until} is before {'--from' if args.start else 'today'}, {start}")
    return {
        "subject": args.subject,
        "given_by": args.given_by or args.subject,
        "purpose": args.purpose,
        "start": start,
        "until": args.until,
        "drivers": list(dict.fromkeys(name.strip() for name in args.drivers.split(","))),
        "hand_out": args.hand_out,
    }


def _handing_out(record: dict[str, Any]) -> str:
    return ", splats may be handed out" if record["hand_out"] else ""


def _day(text: str) -> date:
    """Parse a date (argparse type)."""
    try:
        if re.fullmatch(r"\d{4}-\d{2}-\d{2}", text):
            return date.fromisoformat(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"a date is like 2026-12-31, not {text!r}")


def report(found: OnFile, now: float | None = None) -> dict[str, Any]:
    """Return the consent record of a file as JSON values, ``valid`` at ``now`` (seconds since 1970), of any signer."""
    consent = found.consent
    if consent is None:
        return {"valid": found.nobody, "nobody": found.nobody, "fault": found.fault}
    late = consent.reason_invalid(time.time() if now is None else now)
    first, last = (datetime.fromtimestamp(seconds, UTC).date() for seconds in (consent.begins, consent.ends - 1))
    return {
        "valid": not late,
        "nobody": False,
        "fault": late,
        "subject": consent.subject,
        "given_by": consent.given_by,
        "purpose": consent.purpose,
        "from": first.isoformat(),
        "until": last.isoformat(),
        "drivers": sorted(consent.drivers),
        "hand_out": consent.hand_out,
        "key": consent.key,
    }


def short_text(record: dict[str, Any]) -> str:
    """Return the validity in a few words, of a record of ``report``."""
    return "shows nobody" if record["nobody"] else str(record["fault"]) or "consent valid"


def full_text(record: dict[str, Any]) -> str:
    """Return all fields as text, of a record of ``report``."""
    if record["nobody"]:
        return "not needed: it comes with glsplat and shows nobody"
    if "subject" not in record:
        return str(record["fault"])
    drivers = "everybody" if ANYBODY in record["drivers"] else ", ".join(record["drivers"])
    by = "" if record["given_by"] == record["subject"] else f", given by {record['given_by']}"
    days = f"from {record['from']} until {record['until']}"
    return (
        f"{record['fault'] or 'valid'}: {record['subject']}{by}, purpose: {record['purpose']}, {days}, "
        f"may be driven by {drivers}{_handing_out(record)}; the signature by {record['key']} fits"
    )


def sign_mine(path: Path) -> None:
    """Sign the avatar at ``path`` for a year, with the key of this user's servers (``consent-key``).

    The record does not allow handing out splats. Raises GlsplatError, which names the file.
    """
    from glsplat.net.guard.state_dir import state_folder

    key = kept_key(state_folder())
    today = datetime.now(UTC).date()
    signed = sign_data(
        path.read_bytes(),
        key,
        subject=_MINE_SUBJECT,
        given_by=_MINE_GIVEN_BY,
        purpose=_MINE_PURPOSE,
        start=today,
        until=today + _MINE_VALIDITY,
        drivers=[ANYBODY],
    )
    replace_file(path, [signed])
    print(f"{path}: signed as yours until {today + _MINE_VALIDITY}; show it: glsplat serve {path}", file=sys.stderr)
