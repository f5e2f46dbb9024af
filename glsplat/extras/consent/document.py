"""The record of a consent: its fields, the signed bytes and the check of its signature. No I/O.

::

    {"subject": "Ann", "given_by": "Ann", "purpose": "the study of May", "from": "2026-05-01", "until": "2026-05-31",
     "drivers": ["ann"], "hand_out": true, "splats_sha256": "...", "file_sha256": "...", "key": "...",
     "signature": "..."}
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Any, NotRequired, TypedDict

from glsplat.errors import FormatError
from glsplat.extras.consent.keys import PrivateKey, signature_of, signed_by
from glsplat.extras.consent.record import canonical

ANYBODY = "*"
"""Driver that stands for everybody, with or without an account."""

_TEXT = ("subject", "given_by", "purpose")
_HEX = {"splats_sha256": 64, "file_sha256": 64, "key": 64, "signature": 128}
_FILE, _HAND_OUT = "file_sha256", "hand_out"
_OPTIONAL = {_FILE, _HAND_OUT}
_KEYS = {*_TEXT, "from", "until", "drivers", _HAND_OUT, *_HEX}
MAX_TEXT = 1000  # characters of a field or a name
MAX_DRIVERS = 1000
_DATE = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}")
_DAY = timedelta(days=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Consent:
    """A record with a valid signature. ``begins`` and ``ends`` are seconds since 1970 (UTC); the last day counts."""

    subject: str
    given_by: str
    purpose: str
    begins: float
    ends: float
    drivers: frozenset[str]
    splats_sha256: str
    file_sha256: str | None
    key: str  # the public key, 64 hexadecimal digits (RFC 8032, 5.1.5)
    hand_out: bool = False  # viewers may receive the splats themselves

    def reason_invalid(self, now: float) -> str:
        """Return why the consent is not valid at ``now`` (seconds since 1970); "" while it is."""
        if now < self.begins:
            return f"its consent begins on {_day(self.begins)}"
        return f"its consent ended on {_day(self.ends - 1)}" if now >= self.ends else ""

    def lets(self, driver: str) -> bool:
        """Return whether an account may drive; "" is a user without one."""
        return ANYBODY in self.drivers or (bool(driver) and driver in self.drivers)


class Terms(TypedDict):
    """What a consent is given for; ``start`` and ``until`` are its first and last day."""

    subject: str
    given_by: str
    purpose: str
    start: date
    until: date
    drivers: list[str]
    hand_out: NotRequired[bool]


def signed_record(
    key: PrivateKey,
    *,
    splats_sha256: str,
    file_sha256: str | None,
    subject: str,
    given_by: str,
    purpose: str,
    start: date,
    until: date,
    drivers: list[str],
    hand_out: bool = False,
) -> dict[str, Any]:
    """Return a record with its signature (Ed25519, RFC 8032). Raises FormatError naming an invalid field.

    ``hand_out`` is written only if true, so that older versions read all other records.
    """
    record: dict[str, Any] = {
        "subject": subject,
        "given_by": given_by,
        "purpose": purpose,
        "from": start.isoformat(),
        "until": until.isoformat(),
        "drivers": drivers,
        "splats_sha256": splats_sha256,
        "key": key.public,
    }
    if file_sha256 is not None:
        record[_FILE] = file_sha256
    if hand_out:
        record[_HAND_OUT] = True
    record["signature"] = signature_of(key, canonical(record))
    read_record(record)
    return record


def read_record(record: Any) -> Consent:
    """Return the consent of a file's record. Raises FormatError if it is damaged, incomplete or not signed by its key.

    Unknown fields are refused, as they may restrict the consent.
    """
    if not isinstance(record, dict):
        raise FormatError("the consent is not a record, which is a JSON object")
    if strange := sorted(set(record) - _KEYS):
        raise FormatError(f"the consent has {strange[0][:40]!r}, which this version does not know")
    if missing := sorted(_KEYS - _OPTIONAL - set(record)):
        raise FormatError(f"the consent lacks {missing[0]!r}")
    for name in _TEXT:
        _checked_text(record[name], name)
    for name, digits in _HEX.items():
        if name in record and not (
            isinstance(record[name], str) and re.fullmatch(f"[0-9a-f]{{{digits}}}", record[name])
        ):
            raise FormatError(f"the consent's {name} needs {digits} digits of 0-9a-f")
    begins, last = _date(record["from"], "from"), _date(record["until"], "until")
    if last < begins:
        raise FormatError(f"the consent ends ({last}) before it begins ({begins})")
    drivers = record["drivers"]
    if not isinstance(drivers, list) or not 0 < len(drivers) <= MAX_DRIVERS:
        raise FormatError(f"the consent's drivers need a list of 1 to {MAX_DRIVERS} names, or of {ANYBODY!r} alone")
    for name in drivers:
        _checked_text(name, "drivers")
    if not isinstance(record.get(_HAND_OUT, False), bool):
        raise FormatError(f"the consent's {_HAND_OUT} needs true or false, not {record[_HAND_OUT]!r:.40}")
    unsigned = {name: value for name, value in record.items() if name != "signature"}
    if not signed_by(record["key"], record["signature"], canonical(unsigned)):
        raise FormatError("the consent's signature does not fit: the record was changed after it was signed")
    return Consent(
        **{name: record[name] for name in _TEXT},
        begins=_seconds(begins),
        ends=_seconds(last) + _DAY.total_seconds(),
        drivers=frozenset(drivers),
        splats_sha256=record["splats_sha256"],
        file_sha256=record.get(_FILE),
        key=record["key"],
        hand_out=record.get(_HAND_OUT, False),
    )


def _checked_text(value: Any, name: str) -> None:
    if not (isinstance(value, str) and 0 < len(value) <= MAX_TEXT and value.isprintable() and value.strip() == value):
        raise FormatError(f"the consent's {name} needs 1 to {MAX_TEXT} printable characters, not {value!r:.40}")


def _date(value: Any, name: str) -> date:
    try:
        if isinstance(value, str) and _DATE.fullmatch(value):
            return date.fromisoformat(value)
    except ValueError:  # the 30th of February
        pass
    raise FormatError(f"the consent's {name!r} needs a date like 2026-05-31, not {value!r:.40}")


def _seconds(day: date) -> float:
    return datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()


def _day(seconds: float) -> str:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)).date().isoformat()
