"""Track failed pictures by address, as a client could come back on a new connection. No I/O."""

from __future__ import annotations

from collections import OrderedDict

from glsplat.net.guard.limits import Strikes

_FORGET_S = 600.0
_MAX_ADDRESSES = 4096
_SUSPECT_S, _MAX_SUSPECT_S = 10.0, 300.0  # for which others are suspected, after the first fault and at most
_SLOW_SHARE = 1 / 4  # of the others, after a picture that took too long


class FaultTracker:
    """Count pictures that took too long or crashed the renderer: the first is a warning, the next ends the client.

    Faults of pictures that show other people of a room are not counted. Instead, pictures of that address show less of
    the others (``others``) for a while, which doubles with each fault.
    """

    def __init__(self) -> None:
        self._last: OrderedDict[str, float] = OrderedDict()  # time of an address's newest fault, oldest first
        self._others: OrderedDict[str, tuple[Strikes, float]] = OrderedDict()  # faults with others, share of others

    def again(self, address: str, now: float) -> bool:
        """Count a fault of this address; return whether it had one lately."""
        before = self._last.pop(address, None)
        self._last[address] = now
        if len(self._last) > _MAX_ADDRESSES:
            self._last.popitem(last=False)
        return before is not None and now - before < _FORGET_S

    def suspect_others(self, address: str, now: float, slow: bool) -> None:
        """Count a fault of a picture that shows others: it took too long (``slow``), or crashed the renderer."""
        strikes, _ = self._others.pop(address, (Strikes(0, _SUSPECT_S, _MAX_SUSPECT_S, _FORGET_S), 1.0))
        strikes.strike(now)
        self._others[address] = strikes, _SLOW_SHARE if slow and strikes.count == 1 else 0.0
        if len(self._others) > _MAX_ADDRESSES:
            self._others.popitem(last=False)

    def others(self, address: str, now: float) -> float:
        """Return the share of others in pictures of this address, as in RenderJob: 1 all, 0 nobody."""
        strikes, share = self._others.get(address, (None, 1.0))
        return 1.0 if strikes is None or not strikes.wait(now) else share

    def suspects(self, address: str, now: float) -> bool:
        """Return whether this address had a fault lately."""
        before = self._last.get(address)
        return before is not None and now - before < _FORGET_S
