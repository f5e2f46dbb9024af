"""Access rules of the server: bind address, TLS, token, browser origin, host name. Decisions only, no sockets.

Browsers let any page open a WebSocket to any host, localhost included, so a page's Origin has to be on a list
(cross-site WebSocket hijacking, CWE-1385); other clients send no Origin, and need the token alone. A page may also
resolve its own name to this server and then read it as its own (DNS rebinding), so host names are checked, too.
"""

from __future__ import annotations

import base64
import hmac
import ipaddress
import re
import ssl
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from glsplat.errors import GlsplatError
from glsplat.io.secret_files import warn_if_exposed
from glsplat.net.guard.forwarded import Network

if TYPE_CHECKING:
    from glsplat.net.rights import Accounts

SUBPROTOCOL = "glsplat.v1"
TOKEN_PREFIX = "token."  # browsers cannot set headers on a WebSocket: they offer "glsplat.v1" and "token.SECRET"
_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
_HOST = re.compile(r"(?:\[(?P<address>[0-9a-f:.]{2,45})\]|(?P<name>[a-z0-9._-]{1,253}))(?::[0-9]{1,5})?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """The rules of one server. ``refusal`` applies them to a request's headers."""

    host: str = "127.0.0.1"
    token: str | None = field(default=None, repr=False)
    accounts: Accounts | None = None  # instead of the one token: each user has one
    tls: bool = False
    insecure: bool = False  # allow another address than loopback without TLS and token
    origins: tuple[str, ...] = ()  # further pages that may connect, e.g. "https://lab.example:8000"
    hosts: tuple[str, ...] = ()  # names besides addresses and localhost; "*.lab.example" for one more label
    proxies: tuple[Network, ...] = ()  # trusted reverse proxies

    def __post_init__(self) -> None:
        if self.token is not None and self.accounts is not None:
            raise GlsplatError("a server has one token (token-file) or accounts (--users), not both; leave one out")
        if not is_loopback(self.host) and not self.insecure and not (self.tls and self.guarded):
            raise GlsplatError(
                f"{self.host} can be reached from other machines: give --self-signed, or tls-cert, tls-key and "
                "token-file or --users, or accept the risk with --insecure"
            )

    @property
    def local(self) -> bool:
        """True where only programs of this machine connect: on loopback without a proxy."""
        return is_loopback(self.host) and not self.proxies

    @property
    def guarded(self) -> bool:
        """True where a token is needed."""
        return self.token is not None or self.accounts is not None

    def wrong_host(self, given: Sequence[str]) -> tuple[int, str] | None:
        """Return the HTTP status and line of a refusal unless ``given``, the Host headers, name this server.

        An address is always allowed: it cannot be rebound. The port is ignored, as it may be forwarded.
        """
        found = _HOST.fullmatch(given[0].strip().lower()) if len(given) == 1 else None
        if found is None:
            return 400, "a request needs one Host header"
        name = (found["address"] or found["name"]).removesuffix(".")
        if name == "localhost" or name.endswith(".localhost") or _is_address(name):
            return None
        for own in (self.host, *self.hosts):
            own = own.lower().removesuffix(".")
            if name == own or (own.startswith("*.") and name.partition(".")[2] == own[2:]):
                return None
        return 421, "this server does not go by that name: start it with allow-host = NAME to allow it"

    def refusal(self, headers: Mapping[str, str], public: bool = False) -> tuple[int, str] | None:
        """Return the HTTP status and line of a refusal; None lets a request in. ``public``: no token is needed."""
        if not self._origin_allowed(headers.get("Origin"), headers.get("Host", "")):
            return 403, "this page may not use the server: start it with origin = PAGE to allow it"
        if not public and self.token is not None and not self._token_given(headers):
            return 401, "a token is needed: Authorization: Bearer TOKEN, or the subprotocols glsplat.v1, token.TOKEN"
        return None

    def _origin_allowed(self, origin: str | None, host: str) -> bool:
        if origin is None or origin in self.origins:
            return True
        try:
            page = urlsplit(origin)
            if is_loopback(self.host):  # a name that resolves to loopback (DNS rebinding) is not this host
                return page.hostname in _LOOPBACK_NAMES and _port(page) == _port(urlsplit(f"{page.scheme}://{host}"))
            return page.netloc.lower() == host.lower() and page.scheme == ("https" if self.tls else "http")
        except ValueError:
            return False

    def offers_token(self, headers: Mapping[str, str]) -> bool:
        """Return whether a request has any token, right or wrong."""
        protocols = headers.get("Sec-WebSocket-Protocol", "")
        return "Authorization" in headers or any(p.strip().startswith(TOKEN_PREFIX) for p in protocols.split(","))

    def tokens(self, headers: Mapping[str, str]) -> list[str]:
        """Return the tokens of a request; the one of a browser's password dialog is the last."""
        kind, _, value = headers.get("Authorization", "").partition(" ")
        offered = [value.strip()] if kind.lower() == "bearer" else []
        protocols = headers.get("Sec-WebSocket-Protocol", "").split(",")
        offered += [p.strip()[len(TOKEN_PREFIX) :] for p in protocols if p.strip().startswith(TOKEN_PREFIX)]
        if kind.lower() == "basic":  # a browser that opens the status page asks for a name (any) and a password
            offered.append(_basic_password(value))
        return offered

    def _token_given(self, headers: Mapping[str, str]) -> bool:
        assert self.token is not None
        offered = self.tokens(headers)
        # constant-time comparisons; bytes that are not UTF-8 arrive as surrogates, which encode() would refuse
        return any([hmac.compare_digest(v.encode(errors="replace"), self.token.encode()) for v in offered[:4]])


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def certificate_names(cert: str | Path, server: ssl.SSLContext) -> tuple[str, ...]:
    """Return the DNS names of a certificate; none if they cannot be read (an expired one, for example).

    Python reads only a peer's certificate, so a client shakes hands with ``server`` in memory.
    """
    try:
        client = ssl.create_default_context(cafile=cert)
        client.check_hostname = False
        client.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # trust the certificate itself, whoever issued it
        there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
        ends = client.wrap_bio(back, there), server.wrap_bio(there, back, server_side=True)
        for end in ends * 3:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
        found: Mapping[str, object] = ends[0].getpeercert() or {}
    except (ssl.SSLError, OSError, ValueError):
        return ()
    names = found.get("subjectAltName", ())
    return tuple(value for kind, value in names if kind == "DNS") if isinstance(names, tuple) else ()


def read_token(path: str | Path) -> str:
    """Read a token: one line of 16 or more letters, digits or -._~. Raises GlsplatError naming the file."""
    try:
        token = Path(path).read_text(encoding="utf-8").strip()
    except OSError as error:
        raise GlsplatError(f"{path}: cannot read the token ({error.strerror})") from None
    except UnicodeError:
        raise GlsplatError(f"{path}: a token file is one line of text, found bytes that are not UTF-8") from None
    if len(token) < 16 or not all(c.isascii() and (c.isalnum() or c in "-._~") for c in token):
        raise GlsplatError(f"{path}: a token needs 16 or more letters, digits or -._~ in one line, found {len(token)}")
    warn_if_exposed(path)
    return token


def server_tls(cert: str | Path, key: str | Path) -> ssl.SSLContext:
    """Return a TLS context for the server. Raises GlsplatError naming the missing or wrong file."""
    for path in (cert, key):
        if not Path(path).is_file():
            raise GlsplatError(f"{path}: expected a PEM file for TLS, found none")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(cert, key, password=lambda: "-")  # without it OpenSSL would ask for a passphrase
    except (ssl.SSLError, OSError):  # OpenSSL's message names lines of its source
        message = f"{cert}, {key}: expected a certificate and the key that belongs to it in PEM, without a passphrase"
        raise GlsplatError(message) from None
    warn_if_exposed(key)
    return context


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _basic_password(value: str) -> str:
    try:
        return base64.b64decode(value.strip(), validate=True).decode().partition(":")[2]
    except ValueError:  # not base64, not UTF-8
        return ""


def _port(parts: object) -> int:
    port = getattr(parts, "port", None)
    return port if port is not None else (443 if getattr(parts, "scheme", "") == "https" else 80)
