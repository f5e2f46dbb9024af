"""A certificate that the server signs itself and keeps: for a headset's browser, which wants https and asks once.

Key and certificate are one file, so that they are replaced together or not at all; what clients are given to trust
(``--tls-ca``) is a second one, without the key. Imported only when it is used: ``cryptography`` takes its time.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from glsplat.errors import GlsplatError
from glsplat.io.files import open_regular, replace_file
from glsplat.net.guard.state_dir import lock_of

__all__ = ["CERTIFICATE", "KEY", "StoredCertificate", "holds", "kept_certificate", "passing_certificate"]

KEY, CERTIFICATE = "key-and-certificate.pem", "certificate.pem"
"""The names of the files in the folder."""
_LASTS = timedelta(days=730)  # Apple's systems refuse more than 825
_SOON = timedelta(days=30)
_EARLY = timedelta(days=1)  # a headset's clock may be behind
_ALWAYS = ("localhost", "127.0.0.1", "::1")
_MOST_ADDRESSES = 32
_LARGEST = 1 << 16  # bytes; a file that is larger is not ours
_DAMAGED = (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm, x509.InvalidVersion, x509.ExtensionNotFound)
_NAME = re.compile(r"(?:\*\.)?[a-z0-9_-]{1,63}(?:\.[a-z0-9_-]{1,63})*")


class StoredCertificate(NamedTuple):
    """A certificate on disk."""

    path: Path  # key and certificate, PEM
    fingerprint: str  # SHA-256 of the certificate, as browsers and openssl show it: AB:CD:...
    remade: str  # why it took another one's place; "" if it did not


def kept_certificate(folder: Path, names: Iterable[str]) -> StoredCertificate:
    """The certificate in ``folder`` for localhost and ``names`` (DNS names, ``*.lab.example``, addresses).

    It is made where there is none, and anew when it ends within 30 days, lacks a name or is damaged. Addresses that it
    had before stay in it: a laptop that goes to and fro between two networks keeps one certificate. Raises
    GlsplatError for a name that no certificate can hold and for files that cannot be read or written.
    """
    wanted = tuple(dict.fromkeys(_normal(name) for name in (*_ALWAYS, *names)))
    path = folder / KEY
    with lock_of(folder):
        remade = ""
        if path.exists():
            certificate = _read(path)
            if certificate is None:
                remade = "the one that was kept is damaged"
            else:
                held = _names_of(certificate)
                remade = _fault(certificate, held, wanted)
                earlier = [name for name in held if _address(name) and name not in wanted]
                wanted += tuple(earlier[:_MOST_ADDRESSES])
        if remade or not path.exists():
            certificate, data = _made(wanted)
            replace_file(path, [data], private=True)
        assert certificate is not None
        public = certificate.public_bytes(Encoding.PEM)
        if not _same(folder / CERTIFICATE, public):
            replace_file(folder / CERTIFICATE, [public])
    return StoredCertificate(path, certificate.fingerprint(hashes.SHA256()).hex(":").upper(), remade)


def holds(name: str) -> bool:
    """True for a DNS name that a certificate can hold; systems may call themselves otherwise."""
    return len(name) <= 253 and _NAME.fullmatch(name.lower()) is not None


def _normal(name: str) -> str:
    """A name as it is compared. Raises GlsplatError if it is none."""
    plain = name.strip().lower().removesuffix(".")
    if (address := _address(plain.strip("[]"))) is not None:
        return str(address)
    if not holds(plain):
        expected = "expected letters, digits, hyphens and dots (xn--... for others), or an address"
        raise GlsplatError(f"{name!r} is no name that a certificate can hold: {expected}")
    return plain


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _read(path: Path) -> x509.Certificate | None:
    """What the file holds; None unless it is one certificate and its key. Raises FormatError if it cannot be read."""
    with open_regular(path) as (file, size):
        data = file.read(_LARGEST) if size <= _LARGEST else b""
    try:
        key, certificate = load_pem_private_key(data, None), x509.load_pem_x509_certificate(data)
        certificate.verify_directly_issued_by(certificate)
        _names_of(certificate)
    except _DAMAGED:
        return None
    return certificate if key.public_key() == certificate.public_key() else None


def _names_of(certificate: x509.Certificate) -> tuple[str, ...]:
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return (*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress)))


def _fault(certificate: x509.Certificate, held: Sequence[str], wanted: Sequence[str]) -> str:
    """Why this certificate will not do; "" if it will."""
    now = datetime.now(UTC)
    if certificate.not_valid_after_utc < now + _SOON:
        return f"the one that was kept ends on {certificate.not_valid_after_utc:%Y-%m-%d}"
    if certificate.not_valid_before_utc > now:
        return f"the one that was kept begins on {certificate.not_valid_before_utc:%Y-%m-%d}"
    missing = [name for name in wanted if name not in held]
    return f"the one that was kept lacks {', '.join(missing)}" if missing else ""


def passing_certificate(lasts: timedelta) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """A certificate for those who are told its SHA-256, and its key; nothing of it is kept.

    Browsers take such ones with keys on P-256 and for 14 days at most (WebTransport, W3C, "serverCertificateHashes").
    """
    return _signed(_ALWAYS, lasts)


def _made(names: Sequence[str]) -> tuple[x509.Certificate, bytes]:
    """A new certificate, and it with its key as PEM."""
    certificate, key = _signed(names, _LASTS)
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return certificate, private + certificate.public_bytes(Encoding.PEM)


def _signed(names: Sequence[str], lasts: timedelta) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    issuer = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "glsplat (signed by this server itself)")])
    alternatives = [x509.IPAddress(at) if (at := _address(name)) else x509.DNSName(name) for name in names]
    public = key.public_key()
    usage = dict.fromkeys(("key_encipherment", "data_encipherment", "key_agreement", "content_commitment"), False)
    usage |= dict.fromkeys(("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"), False)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(issuer)
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLY)
        .not_valid_after(now + lasts)
        .add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)  # it vouches for nobody else
        .add_extension(x509.KeyUsage(digital_signature=True, **usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    return certificate, key


def _same(path: Path, data: bytes) -> bool:
    try:
        return path.read_bytes() == data
    except OSError:
        return False
