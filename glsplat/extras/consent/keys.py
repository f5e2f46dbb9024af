"""Ed25519 keys (RFC 8032) in PEM files. ``cryptography`` is imported on first use, as it is slow to load."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from glsplat.errors import FormatError
from glsplat.io.files import naming, open_regular, replace_file
from glsplat.io.secret_files import warn_if_exposed
from glsplat.optional import require_package

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

MAX_KEY_FILE_BYTES = 1 << 14
_HEX = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class PrivateKey:
    """A private key; ``public`` checks its signatures (64 hexadecimal digits)."""

    public: str
    secret: Ed25519PrivateKey = field(repr=False)


def short(key: str) -> str:
    """Return the beginning of a public key, for messages."""
    return f"{key[:16]}..."


def public_path(path: Path) -> Path:
    """Return the path of the public key, beside its private key."""
    return path.with_name(f"{path.name}.pub")


def new_key(path: Path) -> PrivateKey:
    """Make a key: the private one (PEM, PKCS #8) readable by its owner only, the public one (PEM) beside it.

    Raises FormatError if one of the files exists or cannot be written.
    """
    require_package("a key that signs consent", "cryptography", "server")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

    beside = public_path(path)
    for one in (path, beside):
        if os.path.lexists(one):
            raise FormatError(f"{one}: exists, and a key is never written over; give another name")
    secret = Ed25519PrivateKey.generate()
    text = secret.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)  # exclusive: two processes may race
        with os.fdopen(descriptor, "wb") as file:
            file.write(text)
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror})") from None
    replace_file(beside, [secret.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)])
    return _private(secret)


def private_key(path: Path) -> PrivateKey:
    """Return the key in a file. Raises FormatError unless it is an Ed25519 private key in PEM without a passphrase."""
    require_package("a key that signs consent", "cryptography", "server")
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(_read(path), None)
    except (ValueError, TypeError, UnsupportedAlgorithm):  # not PEM, a passphrase, an unknown curve
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise FormatError(
            f"{path}: expected an Ed25519 private key (PEM, without a passphrase); make one with --new-key"
        )
    warn_if_exposed(path)
    return _private(key)


def public_key(path: Path) -> str:
    """Return the public key in a file (PEM or 64 hexadecimal digits) as digits. Raises FormatError."""
    data = _read(path)
    text = data.decode("ascii", "replace").strip()
    if _HEX.fullmatch(text):
        return text
    if "PRIVATE KEY" in text:
        raise FormatError(f"{path}: a private key; give the public one, {public_path(path).name}, and keep this to you")
    require_package("a key in PEM", "cryptography", "server", "give its 64 hexadecimal digits")
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(data)
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PublicKey):
        raise FormatError(f"{path}: expected an Ed25519 public key (PEM, or 64 digits of 0-9a-f in one line)")
    return key.public_bytes_raw().hex()


def signature_of(key: PrivateKey, data: bytes) -> str:
    """Return the signature of ``data`` as 128 hexadecimal digits."""
    return key.secret.sign(data).hex()


def signed_by(key: str, signature: str, data: bytes) -> bool:
    """Return whether ``signature`` over ``data`` was made by the private key of ``key``; both are hexadecimal."""
    require_package("checking a signature of consent", "cryptography", "server")
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(key)).verify(bytes.fromhex(signature), data)
    except (InvalidSignature, ValueError):  # ValueError: a key that is not a point of the curve
        return False
    return True


def _private(secret: Ed25519PrivateKey) -> PrivateKey:
    return PrivateKey(secret.public_key().public_bytes_raw().hex(), secret)


def _read(path: Path) -> bytes:
    with naming(path), open_regular(path) as (file, size):
        if size > MAX_KEY_FILE_BYTES:
            raise FormatError(f"a key file has at most {MAX_KEY_FILE_BYTES} bytes, this one {size}")
        return file.read()


_KEY = "consent-key"


def kept_key(folder: Path) -> PrivateKey:
    """Return the key in the folder, created at the first call. Raises GlsplatError naming the file."""
    from glsplat.net.guard.state_dir import lock_of  # here: who reads a consent needs no server

    path = folder / _KEY
    with lock_of(folder):
        return private_key(path) if path.exists() else new_key(path)


def known_key(folder: Path) -> PrivateKey | None:
    """Return the key in the folder; None if none was created. Raises GlsplatError naming the file."""
    path = folder / _KEY
    return private_key(path) if path.exists() else None
