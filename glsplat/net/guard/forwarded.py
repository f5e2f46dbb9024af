"""Client addresses behind trusted reverse proxies: X-Forwarded-For, and Forwarded (RFC 7239). No sockets."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

from glsplat.errors import GlsplatError

if TYPE_CHECKING:
    from multidict import CIMultiDictProxy

Address: TypeAlias = ipaddress.IPv4Address | ipaddress.IPv6Address
Network: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

FORWARDED = ("X-Forwarded-For", "Forwarded")  # headers
MAX_CHARACTERS = 2048  # of all lines of a header: some forty IPv6 hops

_PORT = r"(?::(?:[0-9]{1,5}|_[A-Za-z0-9._-]{1,32}))?"
_NODE = re.compile(rf"\[([0-9A-Fa-f:.]{{2,45}})\]{_PORT}|([0-9.]{{7,15}}){_PORT}|([0-9A-Fa-f:.]{{2,45}})")
# possessive quantifiers: matching takes time linear in the header's length
_PAIR = re.compile(r"""[ \t]*+(?:([!#$%&'*+.^_`|~0-9A-Za-z-]++)=("(?:[^"\\]|\\.)*+"|[^ \t",;]++))?[ \t]*+([,;]|$)""")


class TrustedProxies:
    """Reverse proxies, by their networks, that name their clients' addresses."""

    def __init__(self, networks: Sequence[Network]) -> None:
        self._networks = tuple(networks)

    def trusts(self, host: str) -> bool:
        """Return whether a connection from ``host``, an address, is a trusted proxy's."""
        address = _address(host.partition("%")[0])
        return address is not None and self._is_proxy(address)

    def client(self, headers: CIMultiDictProxy[str]) -> str | None:
        """Return the address of the client that a trusted proxy forwards a request for.

        It is the rightmost hop that is no trusted proxy: proxies append, so hops left of it may be forged. None where
        no header names one: absent, malformed, too long, "unknown", an obfuscated identifier (RFC 7239, section 6.3: a
        new one each time), or two headers that differ, of which the client may have sent one.
        """
        found = set()
        for name, read in zip(FORWARDED, (_listed, _forwarded), strict=True):
            lines = headers.getall(name, [])
            if lines:
                found.add(self._client(read(lines)) if sum(map(len, lines)) <= MAX_CHARACTERS else None)
        return str(address) if len(found) == 1 and (address := found.pop()) is not None else None

    def _client(self, hops: Sequence[str]) -> Address | None:
        address = None
        for hop in reversed(hops):
            address = _address(hop)
            if address is None or not self._is_proxy(address):
                break
        return address

    def _is_proxy(self, address: Address) -> bool:
        return any(address in network for network in self._networks)


def proxy_network(text: str) -> Network:
    """Return the network of a trusted proxy, an address or CIDR. Raises GlsplatError for what is none, or all."""
    try:
        network = ipaddress.ip_network(text)
    except ValueError as error:
        raise GlsplatError(
            f"expected an address or a network such as 10.0.0.0/8, found {text!r:.60}: {error}"
        ) from None
    if getattr(network.network_address, "ipv4_mapped", None) is not None:
        raise GlsplatError(f"{text}: write IPv4 networks as IPv4, such as 10.0.0.0/8")
    if network.prefixlen == 0:
        raise GlsplatError(f"{text} trusts every client to name its own address: give the proxy's address")
    return network


def _address(node: str) -> Address | None:
    """Parse an address with or without brackets and port; IPv4 in IPv6 becomes IPv4."""
    found = _NODE.fullmatch(node)
    if found is None:
        return None
    try:
        address = ipaddress.ip_address(found[1] or found[2] or found[3])
    except ValueError:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def _listed(lines: Sequence[str]) -> list[str]:
    """Return the hops of X-Forwarded-For, the nearest last."""
    return [hop for hop in (one.strip(' \t"') for one in ",".join(lines).split(",")) if hop]


def _forwarded(lines: Sequence[str]) -> list[str]:
    """Return the ``for`` of each element of Forwarded, the nearest last; "" where it has none or cannot be parsed."""
    hops = []
    for line in lines:
        at, pairs = 0, []
        while at < len(line):
            pair = _PAIR.match(line, at)
            if pair is None:
                hops.append("")  # of the whole line: where an element ends cannot be told
                break
            name, value, end = pair.groups()
            pairs += [(name.lower(), value)] if name else []
            at = pair.end()
            if pairs and (end != ";" or at == len(line)):
                nodes = [re.sub(r"\\(.)", r"\1", value.strip('"')) for name, value in pairs if name == "for"]
                hops.append(nodes[0] if len(nodes) == 1 else "")
                pairs = []
    return hops
