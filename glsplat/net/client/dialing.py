"""Checks of a server's address and token, and the errors of a connection that fails."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import aiohttp

from glsplat.errors import GlsplatError, ProtocolError


def checked_url(url: str) -> str:
    """Return the address with the path of the WebSocket. Raises GlsplatError for an invalid one."""
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except (ValueError, AttributeError, TypeError):  # not a string
        valid = False
    if not valid or not isinstance(url, str):
        raise GlsplatError(f"{url!s:.80}: expected ws://HOST:PORT/ws or wss://HOST:PORT/ws")
    return parts._replace(path="/ws").geturl() if parts.path in ("", "/") else url


def client_tls(cafile: str | Path) -> ssl.SSLContext:
    """Return a context that trusts the certificate in a file. Raises GlsplatError where there is none."""
    try:
        return ssl.create_default_context(cafile=str(cafile))
    except (OSError, ssl.SSLError):
        raise GlsplatError(f"{cafile}: expected a certificate in PEM") from None


def check_token(token: Any) -> None:
    """Raise GlsplatError for a token that is not printable ASCII without blanks, as a header needs it."""
    if token is not None and not (
        isinstance(token, str) and token.isascii() and token.isprintable() and " " not in token
    ):
        kind = "one with blanks, line ends or other signs" if isinstance(token, str) else type(token).__name__
        raise GlsplatError(f"a token is a word of printable ASCII, not {kind}; strip() what was read from a file")


async def offered_avatars(
    http: aiohttp.ClientSession, url: str, headers: Mapping[str, str], tls: ssl.SSLContext | bool
) -> list[str]:
    """Return the names in /session of the server at ``url``; none if it does not answer as a glsplat server."""
    parts = urlsplit(url)
    scheme, path = parts.scheme.replace("ws", "http"), f"{parts.path.rpartition('/')[0]}/session"
    address = parts._replace(scheme=scheme, path=path, query="").geturl()
    options: dict[str, Any] = {"headers": headers, "ssl": tls, "allow_redirects": False}
    try:
        async with asyncio.timeout(2.0), http.get(address, **options) as answer:
            return [name for one in (await answer.json())["avatars"] if (name := str(one["name"])).isprintable()]
    except (aiohttp.ClientError, OSError, TimeoutError, ValueError, KeyError, TypeError):
        return []


async def not_connected(url: str, error: Exception, seconds: float, offered: Sequence[str] = ()) -> ProtocolError:
    """Return the error for a failed connection: the likely reason, and what to do.

    ``offered`` are the names of the server's avatars, where it answers /session.
    """
    if isinstance(error, TimeoutError):
        why = "is it a glsplat server, is it overloaded, is the timeout too short?"
        return ProtocolError(f"{url}: no answer within {seconds:g} s; {why}", "timeout")
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return ProtocolError(f"{url}: its certificate is not trusted; give it with --tls-ca", "tls")
    if isinstance(error, aiohttp.ClientConnectorSSLError):
        reason = getattr(error.os_error, "reason", None)
        if reason in _NO_TLS:
            return ProtocolError(f"{url}: this server does not use TLS: use an address that begins with ws://", "tls")
        return ProtocolError(f"{url}: the TLS handshake failed ({reason or error.os_error})", "tls")
    reached = not isinstance(error, aiohttp.ClientConnectorError)
    refused = error if isinstance(error, aiohttp.WSServerHandshakeError) else None
    # 400 is what some servers with TLS answer to plain HTTP
    plain = offered or (refused is not None and refused.status != 400)
    if reached and not plain and url.startswith("ws:") and await _speaks_tls(url):
        return ProtocolError(f"{url}: this server uses TLS: use an address that begins with wss://", "tls")
    if refused is not None:
        return ProtocolError(_refused(url, refused, offered), "refused")
    if reached:
        return ProtocolError(f"{url}: the server closed the connection; is it a glsplat server?", "unreachable")
    return ProtocolError(f"no server at {url}: start one with `glsplat serve`", "unreachable")


# OpenSSL's reasons for an answer in plain HTTP, in old and new versions
_NO_TLS = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST", "UNEXPECTED_MESSAGE")


async def _speaks_tls(url: str) -> bool:
    """Return whether a TLS handshake succeeds at ``url``, with any certificate."""
    parts = urlsplit(url)
    tls = ssl.create_default_context()
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    try:
        async with asyncio.timeout(2.0):
            _, writer = await asyncio.open_connection(parts.hostname, parts.port or 80, ssl=tls)
    except (OSError, TimeoutError):
        return False
    writer.transport.abort()  # a graceful end would outlive the event loop
    return True


def _refused(url: str, error: aiohttp.WSServerHandshakeError, offered: Sequence[str]) -> str:
    reasons = {
        400: "it does not know an option of the address: avatar is one of its /session, mirror 0 or 1, window 1 to 8, "
        "height 0.5 to 2.8, span 0.3 to 2.5, name letters and digits, at x,z,degrees",
        401: "it needs a token; give it with --token-file",
        403: "it does not serve this origin, or this account may not have this avatar, room or name now",
        404: "there is no such room, which /session lists, or no WebSocket at this path, which is /ws",
        409: "somebody of this name is in the room, or was a moment ago; choose another",
        421: "it does not go by this name; start it with allow-host in its options",
        429: "this address has too many clients there, or broke a limit; try again later",
        503: "it, or the room, is full, or it stops; try again later",
    }
    reason = reasons.get(error.status, "no glsplat server?")
    avatar = error.request_info.url.query.get("avatar")
    if offered and avatar not in (None, *offered):
        reason = f'it has no avatar "{avatar:.40}", but {", ".join(offered):.400}'
    return f"{url}: the server refuses ({error.status}): {reason}"
