"""Accounts in a JSON file: names, hashes of tokens, and the avatars and rooms that each may use.

A token is NAME.SECRET, so one hash is computed per check; unknown names are hashed too, so timing reveals nothing. The
file holds hashes (scrypt, RFC 7914) and is read again when it changes.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import logging
import os
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from glsplat.errors import FormatError, GlsplatError
from glsplat.io.files import naming, open_regular, replace_file
from glsplat.io.secret_files import warn_if_exposed

ANY = "*"
"""Stands for all avatars or rooms."""

_VERSION = 1
_N, _R, _P = 2**14, 8, 1  # scrypt: 16 MiB and about 50 ms, equal for all accounts
_SALT_BYTES, _HASH_BYTES = 16, 32
_SECRET_BYTES = 18  # of randomness in a token, 144 bits
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_~-]{0,31}")
MAX_NAME = 64  # characters of an avatar's or a room's name
MAX_FILE_BYTES = 1 << 20
MAX_CACHED = 1024  # verified tokens
CHECK_S = 1.0  # between checks of the file without logins, and between attempts to read it
_CLOCK_STEP_S = 2.0  # two changes of a file within it may have the same time stamp

_Stamp = tuple[int, int, int, int]
"""Identifies a version of a file: st_mtime_ns, st_ctime_ns, st_size, st_ino."""

log: logging.Logger = logging.getLogger("glsplat.net")


@dataclass(frozen=True, slots=True)
class User:
    """One account; ``avatars`` and ``rooms`` are names, or ``ANY``."""

    name: str
    avatars: tuple[str, ...] = (ANY,)
    rooms: tuple[str, ...] = (ANY,)
    salt: bytes = field(default=b"", repr=False)
    hash: bytes = field(default=b"", repr=False)  # scrypt of the whole token

    def may_drive(self, avatar: str) -> bool:
        """Return whether the account may see and drive the avatar."""
        return ANY in self.avatars or avatar in self.avatars

    def may_enter(self, room: str) -> bool:
        """Return whether the account may enter the room; names that look like paths are refused."""
        return _is_name(room) and (ANY in self.rooms or room in self.rooms)


class _Entry(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    salt: str
    scrypt: str
    avatars: list[str]
    rooms: list[str]


class _File(msgspec.Struct, forbid_unknown_fields=True):
    version: int
    users: list[_Entry]


def new_user(name: str, avatars: Iterable[str] = (ANY,), rooms: Iterable[str] = (ANY,)) -> tuple[User, str]:
    """Return an account and its token, which is stored nowhere. Raises GlsplatError for invalid names."""
    token = f"{name}.{secrets.token_urlsafe(_SECRET_BYTES)}"
    salt = secrets.token_bytes(_SALT_BYTES)
    user = User(name, tuple(dict.fromkeys(avatars)), tuple(dict.fromkeys(rooms)), salt, _hash_token(token, salt))
    _check(user)
    return user, token


def read_users(path: Path) -> dict[str, User]:
    """Return the accounts in a file, by name. Raises FormatError naming the file, without any hash."""
    return _parsed(path, _read(path)[0])


def _read(path: Path) -> tuple[bytes, _Stamp]:
    """Return the file's bytes, and its stamp from before reading, so that a later change has another stamp."""
    with naming(path), open_regular(path) as (file, size):
        if size > MAX_FILE_BYTES:
            raise FormatError(f"a file of accounts has at most {MAX_FILE_BYTES} bytes, this one {size}")
        stamp = _stamp(os.fstat(file.fileno()))
        return file.read(MAX_FILE_BYTES + 1), stamp


def _parsed(path: Path, data: bytes) -> dict[str, User]:
    with naming(path):
        try:
            held = msgspec.json.decode(data, type=_File)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise FormatError(f"no file of accounts of 'glsplat users': {str(error)[:120]}") from None
        if held.version != _VERSION:
            raise FormatError(f"expected accounts of version {_VERSION}, found {held.version}")
        users: dict[str, User] = {}
        for entry in held.users:
            salt, hashed = _bytes(entry.salt, _SALT_BYTES), _bytes(entry.scrypt, _HASH_BYTES)
            if salt is None or hashed is None:
                raise FormatError("an account's salt or hash is damaged; remove it and add it again")
            user = User(entry.name, tuple(entry.avatars), tuple(entry.rooms), salt, hashed)
            _check(user)
            if user.name in users:
                raise FormatError(f"there are two accounts {user.name!r}; remove one")
            users[user.name] = user
        return users


def write_users(path: Path, users: Mapping[str, User]) -> None:
    """Write a file of accounts, private to its owner, atomically. Raises FormatError."""
    entries = [
        _Entry(u.name, base64.b64encode(u.salt).decode(), base64.b64encode(u.hash).decode(), [*u.avatars], [*u.rooms])
        for u in users.values()
    ]
    text = msgspec.json.format(msgspec.json.encode(_File(_VERSION, entries)), indent=1) + b"\n"
    if len(text) > MAX_FILE_BYTES:
        found = f"{len(text)}; remove some"
        raise FormatError(f"{path}: a file of accounts has at most {MAX_FILE_BYTES} bytes, not {found}")
    replace_file(path, [text], private=True)


class Accounts:
    """The accounts of a running server. Used on one event loop. Raises GlsplatError for a broken file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._users: dict[str, User] = {}
        self._data: bytes | None = None  # of the file at the last successful reading ...
        self._stamp: _Stamp | None = None  # ... its stamp ...
        self._read_at = 0.0  # ... and the time of day, as in stamps
        self._checked_at = self._tried_at = time.monotonic()
        self._failed: tuple[_Stamp | None, str] | None = None  # stamp and error of the last attempt, if it failed
        self._secret = secrets.token_bytes(32)  # random per process, so that cached marks are useless elsewhere
        self._verified: OrderedDict[bytes, str] = OrderedDict()
        self._nobody = User("", (), (), secrets.token_bytes(_SALT_BYTES), secrets.token_bytes(_HASH_BYTES))
        self._load()

    def __repr__(self) -> str:
        return f"Accounts({len(self._users)} of {self._path})"

    def known(self, token: str) -> User | None:
        """Return the user of a token that was verified before, if the file is unchanged."""
        self._refresh()
        name = self._verified.get(self._cache_key(token))
        return None if name is None else self._users.get(name)

    async def verified(self, token: str) -> User | None:
        """Return the user of a token by its hash, computed on a thread; None for an invalid token."""
        name = token.partition(".")[0]
        asked = self._users.get(name, self._nobody)
        hashed = await asyncio.to_thread(_hash_token, token, asked.salt)
        right = hmac.compare_digest(hashed, asked.hash)
        user = self._users.get(name)
        if not right or user is None or user.hash != asked.hash:  # the file may have changed meanwhile
            return None
        self._verified[self._cache_key(token)] = name
        if len(self._verified) > MAX_CACHED:
            self._verified.popitem(last=False)
        return user

    def holds(self, user: User) -> bool:
        """Return False once the account was removed or changed. Checks the file at intervals."""
        if time.monotonic() - self._checked_at > CHECK_S:
            self._refresh()
        return self._users.get(user.name) == user

    def _refresh(self) -> None:
        """Read the file again if it may have changed. Failures are retried, as the change may remove an account."""
        self._checked_at = time.monotonic()
        try:
            stamp = _stamp(os.stat(self._path))
        except OSError:
            stamp = None
        if stamp is not None and stamp == self._stamp and abs(self._read_at - max(stamp[:2]) / 1e9) > _CLOCK_STEP_S:
            self._failed = None  # the file was missing and is back unchanged
            return
        if self._failed is not None and self._failed[0] == stamp and self._checked_at - self._tried_at < CHECK_S:
            return
        self._tried_at = self._checked_at
        try:
            self._load()
        except GlsplatError as error:
            if self._failed is None or self._failed[1] != str(error):
                log.error("%s; the accounts read before stay valid until it can be read", error)
            self._failed = stamp, str(error)
            return
        if self._failed is not None:
            log.warning("%s: can be read again", self._path)
        self._failed = None

    def _load(self) -> None:
        """Read the file. On GlsplatError nothing is changed."""
        now = time.time()
        data, stamp = _read(self._path)
        if data != self._data:
            self._users = _parsed(self._path, data)
            self._verified.clear()
        if stamp != self._stamp:
            warn_if_exposed(self._path)
        self._data, self._stamp, self._read_at = data, stamp, now

    def _cache_key(self, token: str) -> bytes:
        return hmac.digest(self._secret, token.encode(errors="replace"), "sha256")


def _hash_token(token: str, salt: bytes) -> bytes:
    return hashlib.scrypt(token.encode(errors="replace"), salt=salt, n=_N, r=_R, p=_P, dklen=_HASH_BYTES)


def _check(user: User) -> None:
    if not _NAME.fullmatch(user.name):
        raise FormatError(f"an account's name is 1 to 32 letters, digits or -_~, no sign first, not {user.name!r:.50}")
    for what, names in (("avatar", user.avatars), ("room", user.rooms)):
        for name in names:
            if name != ANY and not _is_name(name):
                raise FormatError(f"{user.name}: no name of {what}s: {name!r:.50}; give names, or {ANY} for all")


def _is_name(name: str) -> bool:
    """Return whether a name is valid for an avatar or a room: printable, and never a path."""
    whole = 0 < len(name) <= MAX_NAME and name.isprintable() and name.strip() == name
    return whole and not name.startswith(".") and "/" not in name and "\\" not in name


def _bytes(text: str, count: int) -> bytes | None:
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        return None
    return data if len(data) == count else None


def _stamp(info: os.stat_result) -> _Stamp:
    return info.st_mtime_ns, info.st_ctime_ns, info.st_size, info.st_ino
