"""Who asked for the pictures that went wrong. By address, as a client could come back on a new connection. No I/O."""

from __future__ import annotations

from collections import OrderedDict

__all__ = ["FaultTracker"]

_FORGET = 600.0  # seconds after which a bad picture is forgotten
_MOST = 4096  # addresses that are remembered


class FaultTracker:
    """Pictures that took too long, or that the renderer did not survive: the first is a warning, the next ends it."""

    def __init__(self) -> None:
        self._since: OrderedDict[str, float] = OrderedDict()  # by address: the newest bad picture, oldest first

    def again(self, address: str, now: float) -> bool:
        """Count a bad picture of this address; True if it had one before that is not forgotten."""
        before = self._since.pop(address, None)
        self._since[address] = now
        if len(self._since) > _MOST:
            self._since.popitem(last=False)
        return before is not None and now - before < _FORGET

    def suspects(self, address: str, now: float) -> bool:
        """True while a bad picture of this address is not forgotten."""
        before = self._since.get(address)
        return before is not None and now - before < _FORGET
