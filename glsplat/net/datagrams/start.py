"""Whether this machine has what datagrams need."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from glsplat.errors import GlsplatError

if TYPE_CHECKING:
    from glsplat.net.datagrams.listener import DatagramListener

__all__ = ["datagram_listener"]


def datagram_listener(clock: Callable[[], float]) -> DatagramListener:
    """What a server listens with. Raises GlsplatError where what it needs is not installed."""
    try:
        from glsplat.net.datagrams.listener import DatagramListener  # here: most servers have none
    except ImportError:
        raise GlsplatError("--webtransport needs aioquic: pip install 'glsplat[webtransport]'") from None
    return DatagramListener(clock)
