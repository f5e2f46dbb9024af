"""Estimate the uncertainty of a fit's limbs from the networks' visibility and from arms behind the trunk."""

from __future__ import annotations

from collections.abc import Mapping

from glsplat.extras.authoring.fit.view import View

LIMBS: dict[str, tuple[int, ...]] = {
    "head": (0,),
    "left arm": (13, 15),
    "right arm": (14, 16),
    "left leg": (25, 27),
    "right leg": (26, 28),
}
"""Numbers of each limb's landmarks; the head's is the nose."""

_MAX_UNCERTAINTY = 0.6  # of one leg, or of the head


def limb_uncertainty(view: View, hidden: tuple[float, float]) -> dict[str, float]:
    """Return the uncertainty of each limb, from 0 (fully visible) to 1 (a guess).

    It is 1 minus the visibility of the limb's least visible landmark; for an arm at least the fraction ``hidden``
    (left, right) behind the trunk.
    """
    uncertainty = {limb: float(1 - view.visibility[list(marks)].min()) for limb, marks in LIMBS.items()}
    for limb, share in zip(("left arm", "right arm"), hidden, strict=True):
        uncertainty[limb] = max(uncertainty[limb], share)
    return uncertainty


def missing_part(uncertainty: Mapping[str, float], side: str) -> str:
    """Return one line that names a part of the person that the ``side`` picture does not show, or an empty one."""
    if min(uncertainty.get(f"{each} leg", 0.0) for each in ("left", "right")) > _MAX_UNCERTAINTY:
        return f"the legs are not seen in the {side} picture"
    if side == "front" and uncertainty.get("head", 0.0) > _MAX_UNCERTAINTY:
        return f"the head is not seen in the {side} picture"
    return ""
