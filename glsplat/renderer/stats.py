"""FrameStats: counts of one call of render(), summed over its passes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

Box = tuple[int, int, int, int]
"""Pixels: x, y, width, height, from the top left corner."""


@dataclass(frozen=True)
class FrameStats:
    """Counts of one call of render(), summed over its passes."""

    splats: int  # in the scene, at the levels of detail that were drawn
    drawn: int  # of these, summed over the passes of the call
    skipped: int  # splats that are not finite or have no rotation: never uploaded
    culled: dict[str, int] = field(default_factory=dict)  # splats by reason
    sorted: bool = True  # False: the previous order was used again
    covered: Box = (0, 0, 0, 0)  # only background outside
    cost: int = 0  # covered pixels, if counted by Renderer.prepare()
    posed: int = 0  # items that were skinned or placed, each level of detail counted
    levels: tuple[int, ...] = ()  # of detail, one per shown item of splats; 0 is the finest
    coarsest: bool = True  # every visible item was drawn at its coarsest level

    def plus(self, drawn: int, culled: dict[str, int], covered: Box, cost: int) -> FrameStats:
        """Return the sums with one more pass."""
        sums = {reason: self.culled.get(reason, 0) + count for reason, count in culled.items()}
        box = union(self.covered, covered)
        return replace(self, drawn=self.drawn + drawn, culled=sums, covered=box, cost=self.cost + cost)


def union(a: Box, b: Box) -> Box:
    """Return the smallest box that holds both boxes; an empty one adds nothing."""
    if not (a[2] and a[3]):
        return b
    if not (b[2] and b[3]):
        return a
    x, y = min(a[0], b[0]), min(a[1], b[1])
    return x, y, max(a[0] + a[2], b[0] + b[2]) - x, max(a[1] + a[3], b[1] + b[3]) - y
