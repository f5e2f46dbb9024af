"""Self-signed certificates, stored between runs: browsers of headsets require https and ask once per certificate.

Key and certificate share one file, so that they are replaced together; a second file holds only the certificate, for
clients to trust (``--tls-ca``). Imported on first use, as ``cryptography`` is slow to load.
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

KEY, CERTIFICATE = "key-and-certificate.pem", "certificate.pem"
"""The names of the files in the folder."""
_LIFETIME = timedelta(days=730)  # Apple's systems refuse more than 825 days
_RENEW_BEFORE = timedelta(days=30)  # the end
_BACKDATED = timedelta(days=1)  # a headset's clock may be slow
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
MAX_ADDRESSES = 32
MAX_FILE_BYTES = 1 << 16
_INVALID = (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm, x509.InvalidVersion, x509.ExtensionNotFound)
_NAME = re.compile(r"(?:\*\.)?[a-z0-9_-]{1,63}(?:\.[a-z0-9_-]{1,63})*")


class StoredCertificate(NamedTuple):
    """A certificate on disk."""

    path: Path  # key and certificate, PEM
    fingerprint: str  # SHA-256 as shown by browsers and openssl: AB:CD:...
    remade: str  # why it replaced another one; "" if it did not


def kept_certificate(folder: Path, names: Iterable[str]) -> StoredCertificate:
    """Return the certificate in ``folder`` for localhost and ``names`` (DNS names, ``*.lab.example``, addresses).

    It is made if it is missing, ends within 30 days, lacks a name or is damaged. Earlier addresses stay in it, so a
    laptop that moves between two networks keeps one certificate. Raises GlsplatError for invalid names, and if files
    cannot be read or written.
    """
    wanted = tuple(dict.fromkeys(_normalised(name) for name in (*_LOCAL_NAMES, *names)))
    path = folder / KEY
    with lock_of(folder):
        remade = ""
        if path.exists():
            certificate = _read(path)
            if certificate is None:
                remade = "the one that was kept is damaged"
            else:
                held = _names_of(certificate)
                remade = _renewal_reason(certificate, held, wanted)
                earlier = [name for name in held if _address(name) and name not in wanted]
                wanted += tuple(earlier[:MAX_ADDRESSES])
        if remade or not path.exists():
            certificate, key = _self_signed(wanted, _LIFETIME)
            pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
            replace_file(path, [pem + certificate.public_bytes(Encoding.PEM)], private=True)
        assert certificate is not None
        public = certificate.public_bytes(Encoding.PEM)
        if not _has_content(folder / CERTIFICATE, public):
            replace_file(folder / CERTIFICATE, [public])
    return StoredCertificate(path, certificate.fingerprint(hashes.SHA256()).hex(":").upper(), remade)


def holds(name: str) -> bool:
    """Return whether a certificate can hold the DNS name; host names may be invalid."""
    return len(name) <= 253 and _NAME.fullmatch(name.lower()) is not None


def _normalised(name: str) -> str:
    """Return a name in lower case without a final dot. Raises GlsplatError for an invalid name."""
    plain = name.strip().lower().removesuffix(".")
    if (address := _address(plain.strip("[]"))) is not None:
        return str(address)
    if not holds(plain):
        expected = "expected letters, digits, hyphens and dots (xn--... for others), or an address"
        raise GlsplatError(f"{name!r} is not a name that a certificate can hold: {expected}")
    return plain


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _read(path: Path) -> x509.Certificate | None:
    """Return the certificate in a file; None unless it is a certificate with its key. Raises FormatError."""
    with open_regular(path) as (file, size):
        data = file.read(MAX_FILE_BYTES) if size <= MAX_FILE_BYTES else b""
    try:
        key, certificate = load_pem_private_key(data, None), x509.load_pem_x509_certificate(data)
        certificate.verify_directly_issued_by(certificate)
        _names_of(certificate)
    except _INVALID:
        return None
    return certificate if key.public_key() == certificate.public_key() else None


def _names_of(certificate: x509.Certificate) -> tuple[str, ...]:
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return (*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress)))


def _renewal_reason(certificate: x509.Certificate, held: Sequence[str], wanted: Sequence[str]) -> str:
    """Return why a certificate has to be replaced; "" if it is valid for all names."""
    now = datetime.now(UTC)
    if certificate.not_valid_after_utc < now + _RENEW_BEFORE:
        return f"the one that was kept ends on {certificate.not_valid_after_utc:%Y-%m-%d}"
    if certificate.not_valid_before_utc > now:
        return f"the one that was kept begins on {certificate.not_valid_before_utc:%Y-%m-%d}"
    missing = [name for name in wanted if name not in held]
    return f"the one that was kept lacks {', '.join(missing)}" if missing else ""


def short_lived_certificate(lasts: timedelta) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return a certificate for localhost and its key, to be trusted by its SHA-256; nothing is stored.

    Browsers require keys on P-256 and at most 14 days (WebTransport, W3C, "serverCertificateHashes").
    """
    return _self_signed(_LOCAL_NAMES, lasts)


def _self_signed(names: Sequence[str], lasts: timedelta) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
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
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + lasts)
        .add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)  # it signs no others
        .add_extension(x509.KeyUsage(digital_signature=True, **usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    return certificate, key


def _has_content(path: Path, data: bytes) -> bool:
    try:
        return path.read_bytes() == data
    except OSError:
        return False
