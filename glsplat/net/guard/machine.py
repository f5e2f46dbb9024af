"""What this machine is called and where others reach it. Asks the system alone: nothing is sent, nothing waits."""

from __future__ import annotations

import ipaddress
import socket
import struct
from contextlib import suppress
from pathlib import Path

__all__ = ["machine_addresses", "machine_names", "reachable_at"]

# of the blocks for documentation: connecting a datagram socket only asks the routing table, and nothing is ever sent
_AFAR = {socket.AF_INET: "198.51.100.1", socket.AF_INET6: "2001:db8::1"}
_SIOCGIFADDR = 0x8915  # Linux
_PASSING = 0x01 | 0x08 | 0x20 | 0x40  # IPv6 addresses that are temporary, duplicates, deprecated or tentative


def machine_names() -> tuple[str, ...]:
    """What other machines of a local network call this one: its host name, also with .local (mDNS)."""
    name = socket.gethostname()
    return (name, f"{name.partition('.')[0]}.local") if name else ()


def machine_addresses() -> tuple[str, ...]:
    """Addresses of this machine that others may reach: IPv4 before IPv6, and the one of the default route first.

    IPv6 addresses are those that last: the system changes temporary ones every day. Elsewhere than on Linux only
    the addresses of the default routes are found.
    """
    found = (_outward(socket.AF_INET), *_interfaces(), *_lasting())
    return tuple(dict.fromkeys(address for address in found if address))


def reachable_at(host: str) -> tuple[str, ...]:
    """Addresses or the name by which others reach a server that listens on ``host``, the best first; may be none."""
    if host == "0.0.0.0":
        return tuple(address for address in machine_addresses() if ":" not in address)
    return machine_addresses() if host == "::" else (host,)


def _outward(family: socket.AddressFamily) -> str:
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as asking:
        asking.connect((_AFAR[family], 9))
        address = str(asking.getsockname()[0])
        return "" if ipaddress.ip_address(address).is_loopback else address
    return ""  # no such route, or no such family


def _interfaces() -> list[str]:
    """The IPv4 address of each network interface."""
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
    """Global IPv6 addresses that do not change by themselves."""
    try:
        lines = Path("/proc/net/if_inet6").read_text(encoding="ascii").split("\n")
    except (OSError, ValueError):
        return [_outward(socket.AF_INET6)]
    found = []
    for fields in filter(None, map(str.split, lines)):
        address, scope, flags = bytes.fromhex(fields[0]), int(fields[3], 16), int(fields[4], 16)
        if scope == 0 and not flags & _PASSING:
            found.append(socket.inet_ntop(socket.AF_INET6, address))
    return found
