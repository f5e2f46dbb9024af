"""Accounts: who may come in by name, which avatars each may drive, and which rooms enter. Kept in a JSON file.

A token is NAME.SECRET, so that one account is looked up and one hash is taken; of a name that is not there as well, so
that the time an answer takes tells nothing. The file holds hashes (scrypt, RFC 7914) and is read again when it changes.
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

__all__ = ["ANY", "Accounts", "User", "new_user", "read_users", "write_users"]

ANY = "*"
"""In a list of avatars or rooms: all of them."""

_VERSION = 1
_N, _R, _P, _SALT, _HASH = 2**14, 8, 1, 16, 32  # of scrypt: 16 MiB, some 50 ms; all accounts alike, so that all take it
_SECRET = 18  # bytes of chance in a token, 144 bits
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_~-]{0,31}")
_LONGEST = 64  # characters of an avatar's or a room's name
_LARGEST = 1 << 20  # bytes of the file, read and written
_MOST_KNOWN = 1024  # tokens that were verified and are remembered
_LOOK = 1.0  # seconds between two looks at the file while nobody comes in, and between two tries to read it
_CLOCK_STEP = 2.0  # seconds in which two changes of a file may bear the same time

_Stamp = tuple[int, int, int, int]
"""Of a file: when its bytes and when anything of it changed (ns), its bytes, its inode."""

log: logging.Logger = logging.getLogger("glsplat.net")


@dataclass(frozen=True, slots=True)
class User:
    """One account. ``avatars`` and ``rooms`` are names, or ``ANY``."""

    name: str
    avatars: tuple[str, ...] = (ANY,)
    rooms: tuple[str, ...] = (ANY,)
    salt: bytes = field(default=b"", repr=False)
    hash: bytes = field(default=b"", repr=False)  # scrypt of the whole token

    def may_drive(self, avatar: str) -> bool:
        """Whether the account may be shown, and drive, the avatar of that name."""
        return ANY in self.avatars or avatar in self.avatars

    def may_enter(self, room: str) -> bool:
        """Whether the account may enter the room of that name; a name that looks like a path is none."""
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
    """An account and its token, which is nowhere else. Raises GlsplatError for names that cannot be."""
    token = f"{name}.{secrets.token_urlsafe(_SECRET)}"
    salt = secrets.token_bytes(_SALT)
    user = User(name, tuple(dict.fromkeys(avatars)), tuple(dict.fromkeys(rooms)), salt, _hashed(token, salt))
    _check(user)
    return user, token


def read_users(path: Path) -> dict[str, User]:
    """The accounts in a file, by name. Raises FormatError naming it, in a line that says nothing of any hash."""
    return _parsed(path, _read(path)[0])


def _read(path: Path) -> tuple[bytes, _Stamp]:
    """The bytes of the file, and its stamp from before they were read: a later change has another one."""
    with naming(path), open_regular(path) as (file, size):
        if size > _LARGEST:
            raise FormatError(f"a file of accounts has at most {_LARGEST} bytes, this one {size}")
        stamp = _stamp(os.fstat(file.fileno()))
        return file.read(_LARGEST + 1), stamp


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
            salt, hashed = _bytes(entry.salt, _SALT), _bytes(entry.scrypt, _HASH)
            if salt is None or hashed is None:
                raise FormatError("an account's salt or hash is damaged; remove it and add it again")
            user = User(entry.name, tuple(entry.avatars), tuple(entry.rooms), salt, hashed)
            _check(user)
            if user.name in users:
                raise FormatError(f"there are two accounts {user.name!r}; remove one")
            users[user.name] = user
        return users


def write_users(path: Path, users: Mapping[str, User]) -> None:
    """Write a file of accounts that nobody else can read. Raises FormatError; then it is as it was."""
    entries = [
        _Entry(u.name, base64.b64encode(u.salt).decode(), base64.b64encode(u.hash).decode(), [*u.avatars], [*u.rooms])
        for u in users.values()
    ]
    text = msgspec.json.format(msgspec.json.encode(_File(_VERSION, entries)), indent=1) + b"\n"
    if len(text) > _LARGEST:
        raise FormatError(f"{path}: a file of accounts has at most {_LARGEST} bytes, not {len(text)}; remove some")
    replace_file(path, [text], private=True)


class Accounts:
    """The accounts of a running server. Belongs to one event loop. Raises GlsplatError where the file is broken."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._users: dict[str, User] = {}
        self._data: bytes | None = None  # of the file, as it was read last ...
        self._seen: _Stamp | None = None  # ... with this stamp ...
        self._read_at = 0.0  # ... at this time of day, which stamps are in
        self._looked = self._tried = time.monotonic()
        self._failed: tuple[_Stamp | None, str] | None = None  # stamp and error of the last try, if that failed
        self._secret = secrets.token_bytes(32)  # of this process: what is remembered of tokens is no use elsewhere
        self._known: OrderedDict[bytes, str] = OrderedDict()
        self._nobody = User("", (), (), secrets.token_bytes(_SALT), secrets.token_bytes(_HASH))
        self._load()

    def __repr__(self) -> str:
        return f"Accounts({len(self._users)} of {self._path})"

    def known(self, token: str) -> User | None:
        """Whose token it is, if it was verified before and the file is the same since."""
        self._refresh()
        name = self._known.get(self._mark(token))
        return None if name is None else self._users.get(name)

    async def verified(self, token: str) -> User | None:
        """Whose token it is, by its hash, taken on a thread; None: nobody's."""
        name = token.partition(".")[0]
        asked = self._users.get(name, self._nobody)
        hashed = await asyncio.to_thread(_hashed, token, asked.salt)
        right = hmac.compare_digest(hashed, asked.hash)
        user = self._users.get(name)
        if not right or user is None or user.hash != asked.hash:  # the file may have changed meanwhile
            return None
        self._known[self._mark(token)] = name
        if len(self._known) > _MOST_KNOWN:
            self._known.popitem(last=False)
        return user

    def holds(self, user: User) -> bool:
        """False once the account was removed, or its token or rights are others. Looks at the file now and then."""
        if time.monotonic() - self._looked > _LOOK:
            self._refresh()
        return self._users.get(user.name) == user

    def _refresh(self) -> None:
        """Read the file again if it may have changed. What cannot be read is tried again: it may remove somebody."""
        self._looked = time.monotonic()
        try:
            stamp = _stamp(os.stat(self._path))
        except OSError:
            stamp = None
        if stamp is not None and stamp == self._seen and abs(self._read_at - max(stamp[:2]) / 1e9) > _CLOCK_STEP:
            self._failed = None  # it was away, and is back as it was
            return
        if self._failed is not None and self._failed[0] == stamp and self._looked - self._tried < _LOOK:
            return
        self._tried = self._looked
        try:
            self._load()
        except GlsplatError as error:
            if self._failed is None or self._failed[1] != str(error):
                log.error("%s; the accounts that were read before stay until it can be read", error)
            self._failed = stamp, str(error)
            return
        if self._failed is not None:
            log.warning("%s: is read again", self._path)
        self._failed = None

    def _load(self) -> None:
        """Raises GlsplatError; then everything is as it was."""
        now = time.time()
        data, stamp = _read(self._path)
        if data != self._data:
            self._users = _parsed(self._path, data)
            self._known.clear()
        if stamp != self._seen:
            warn_if_exposed(self._path)
        self._data, self._seen, self._read_at = data, stamp, now

    def _mark(self, token: str) -> bytes:
        return hmac.digest(self._secret, token.encode(errors="replace"), "sha256")


def _hashed(token: str, salt: bytes) -> bytes:
    return hashlib.scrypt(token.encode(errors="replace"), salt=salt, n=_N, r=_R, p=_P, dklen=_HASH)


def _check(user: User) -> None:
    if not _NAME.fullmatch(user.name):
        raise FormatError(f"an account's name is 1 to 32 letters, digits or -_~, no sign first, not {user.name!r:.50}")
    for what, names in (("avatar", user.avatars), ("room", user.rooms)):
        for name in names:
            if name != ANY and not _is_name(name):
                raise FormatError(f"{user.name}: no name of {what}s: {name!r:.50}; give names, or {ANY} for all")


def _is_name(name: str) -> bool:
    """Names as servers give them to avatars and rooms: printable, and never a path."""
    whole = 0 < len(name) <= _LONGEST and name.isprintable() and name.strip() == name
    return whole and not name.startswith(".") and "/" not in name and "\\" not in name


def _bytes(text: str, count: int) -> bytes | None:
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        return None
    return data if len(data) == count else None


def _stamp(info: os.stat_result) -> _Stamp:
    return info.st_mtime_ns, info.st_ctime_ns, info.st_size, info.st_ino
