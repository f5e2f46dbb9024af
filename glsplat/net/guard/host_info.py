"""Names and addresses of this machine, from the system alone: nothing is sent, nothing blocks."""

from __future__ import annotations

import ipaddress
import socket
import struct
from contextlib import suppress
from pathlib import Path

# documentation addresses: connecting a datagram socket only looks up the route, nothing is sent
_REMOTE = {socket.AF_INET: "198.51.100.1", socket.AF_INET6: "2001:db8::1"}
_SIOCGIFADDR = 0x8915  # Linux
_TRANSIENT = 0x01 | 0x08 | 0x20 | 0x40  # flags of IPv6 addresses: temporary, duplicate, deprecated, tentative


def machine_names() -> tuple[str, ...]:
    """Return this machine's names in a local network: its host name, also with .local (mDNS)."""
    name = socket.gethostname()
    return (name, f"{name.partition('.')[0]}.local") if name else ()


def machine_addresses() -> tuple[str, ...]:
    """Return addresses of this machine that others may reach: IPv4 before IPv6, that of the default route first.

    Temporary IPv6 addresses, which change every day, are left out. Outside Linux only the addresses of the default
    routes are found.
    """
    found = (_outward(socket.AF_INET), *_interfaces(), *_lasting())
    return tuple(dict.fromkeys(address for address in found if address))


def reachable_at(host: str) -> tuple[str, ...]:
    """Return the addresses or name of a server that listens on ``host``, the best first; may be empty."""
    if host == "0.0.0.0":
        return tuple(address for address in machine_addresses() if ":" not in address)
    return machine_addresses() if host == "::" else (host,)


def _outward(family: socket.AddressFamily) -> str:
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as asking:
        asking.connect((_REMOTE[family], 9))
        address = str(asking.getsockname()[0])
        return "" if ipaddress.ip_address(address).is_loopback else address
    return ""  # no such route, or no such family


def _interfaces() -> list[str]:
    """Return the IPv4 address of each network interface."""
    try:
        from fcntl import ioctl  # not on Windows
    except ImportError:
        return []
    found = []
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # it has none, or this is not Linux
                answer = ioctl(asking, _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
                found.append(socket.inet_ntoa(answer[20:24]))
    return [address for address in found if not ipaddress.ip_address(address).is_loopback]


def _lasting() -> list[str]:
    """Return the lasting global IPv6 addresses."""
    try:
        lines = Path("/proc/net/if_inet6").read_text(encoding="ascii").split("\n")
    except (OSError, ValueError):
        return [_outward(socket.AF_INET6)]
    found = []
    for fields in filter(None, map(str.split, lines)):
        address, scope, flags = bytes.fromhex(fields[0]), int(fields[3], 16), int(fields[4], 16)
        if scope == 0 and not flags & _TRANSIENT:
            found.append(socket.inet_ntop(socket.AF_INET6, address))
    return found
