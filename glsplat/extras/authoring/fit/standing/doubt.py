"""How much a fit doubts its own limbs, by what the networks saw of them and where the fit has put them."""

from __future__ import annotations

from collections.abc import Mapping

from glsplat.extras.authoring.fit.view import View

__all__ = ["LIMBS", "doubts_of", "unseen"]

LIMBS: dict[str, tuple[int, ...]] = {
    "head": (0,),
    "left arm": (13, 15),
    "right arm": (14, 16),
    "left leg": (25, 27),
    "right leg": (26, 28),
}
"""Each limb's landmarks in the network's order; the head's is the nose."""

_TOO_MUCH = 0.6  # of both legs, or of the head: nothing holds them


def doubts_of(view: View, hidden: tuple[float, float]) -> dict[str, float]:
    """Of each limb from 0 (seen whole) to 1 (a guess).

    That is what its least visible landmark lacks of being seen; of an arm also the share of it that the fit has
    ``hidden`` behind the trunk, left and right, where that is more.
    """
    doubts = {limb: float(1 - view.visibility[list(marks)].min()) for limb, marks in LIMBS.items()}
    for limb, share in zip(("left arm", "right arm"), hidden, strict=True):
        doubts[limb] = max(doubts[limb], share)
    return doubts


def unseen(doubts: Mapping[str, float], side: str) -> str:
    """One line that says which part of somebody the ``side`` picture does not show, or nothing."""
    if min(doubts.get(f"{each} leg", 0.0) for each in ("left", "right")) > _TOO_MUCH:
        return f"the legs are not seen in the {side} picture"
    if side == "front" and doubts.get("head", 0.0) > _TOO_MUCH:
        return f"the head is not seen in the {side} picture"
    return ""
