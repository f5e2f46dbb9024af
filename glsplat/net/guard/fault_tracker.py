"""Who asked for the pictures that went wrong. By address, as a client could come back on a new connection. No I/O."""

from __future__ import annotations

from collections import OrderedDict

from glsplat.net.guard.limits import Strikes

__all__ = ["FaultTracker"]

_FORGET = 600.0  # seconds after which a bad picture is forgotten
_MOST = 4096  # addresses that are remembered
_DOUBT, _LONGEST_DOUBT = 10.0, 300.0  # seconds for which others are suspected, after the first fault and at most
_FEWER = 1 / 4  # of what others may add to a picture, after one that took too long


class FaultTracker:
    """Pictures that took too long, or that the renderer did not survive: the first is a warning, the next ends it.

    A picture that shows other people of a room is nobody's fault yet: for a while, which doubles with each, those of
    this address show less of them (``others``). What goes wrong without them is its client's own.
    """

    def __init__(self) -> None:
        self._since: OrderedDict[str, float] = OrderedDict()  # by address: the newest bad picture, oldest first
        self._others: OrderedDict[str, tuple[Strikes, float]] = (
            OrderedDict()
        )  # of those that showed others, and how much

    def again(self, address: str, now: float) -> bool:
        """Count a bad picture of this address; True if it had one before that is not forgotten."""
        before = self._since.pop(address, None)
        self._since[address] = now
        if len(self._since) > _MOST:
            self._since.popitem(last=False)
        return before is not None and now - before < _FORGET

    def suspect_others(self, address: str, now: float, slow: bool) -> None:
        """Count a bad picture of this address that shows others: it took too long (``slow``), or was not survived."""
        strikes, _ = self._others.pop(address, (Strikes(0, _DOUBT, _LONGEST_DOUBT, _FORGET), 1.0))
        strikes.strike(now)
        self._others[address] = strikes, _FEWER if slow and strikes.count == 1 else 0.0
        if len(self._others) > _MOST:
            self._others.popitem(last=False)

    def others(self, address: str, now: float) -> float:
        """How much of others the pictures of this address are to show, as in RenderJob: 1 all, 0 nobody."""
        strikes, share = self._others.get(address, (None, 1.0))
        return 1.0 if strikes is None or not strikes.wait(now) else share

    def suspects(self, address: str, now: float) -> bool:
        """True while a bad picture of this address is not forgotten."""
        before = self._since.get(address)
        return before is not None and now - before < _FORGET
