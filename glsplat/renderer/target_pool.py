"""TargetPool: the targets of a renderer, by size. Clients that take turns with other sizes do not make them anew."""

from __future__ import annotations

from collections import OrderedDict

from glsplat.gl.context import Context
from glsplat.renderer.targets import ByteTarget, Target

__all__ = ["TargetPool"]

SIZES = 4
"""Sizes that are kept at most."""

KEPT_BYTES = 256 * 2**20
"""What targets of sizes other than the current one may take."""

Size = tuple[int, int]  # width, height


class TargetPool:
    """Targets of the sizes used last, made when they are first asked for."""

    def __init__(self, context: Context, dtype: str) -> None:
        self._context, self._dtype = context, dtype
        self._floats: OrderedDict[Size, dict[tuple[int, bool], Target]] = (
            OrderedDict()
        )  # the size used last comes last; by views and depth
        self._bytes: dict[Size, dict[int, ByteTarget]] = {}

    @property
    def nbytes(self) -> int:
        """GPU bytes of all targets that are kept."""
        return sum(map(self._nbytes_of, self._floats))

    def float_target(self, size: Size, views: int, depth: bool = False) -> Target:
        """The float target of that size for so many views; drops sizes that have not been used for long."""
        mine = self._use(size)
        key = (views, depth)
        if key not in mine:
            mine[key] = Target(self._context.ctx, *size, views, self._dtype, depth)
            self._trim()
        return mine[key]

    def byte_target(self, size: Size, views: int) -> ByteTarget:
        """The same for the 8-bit picture made of it."""
        self._use(size)
        mine = self._bytes[size]
        if views not in mine:
            mine[views] = ByteTarget(self._context.ctx, *size, views)
            self._trim()
        return mine[views]

    def release(self) -> None:
        """Delete all targets; asking for one afterwards makes it anew."""
        while self._floats:
            self._drop()

    def _use(self, size: Size) -> dict[tuple[int, bool], Target]:
        if size not in self._floats:
            self._context.scratch.use()  # making a target restores the framebuffer that was bound, if it is still there
            self._bytes[size] = {}
            self._floats[size] = {}  # last: whatever has floats has bytes, wherever this is broken off
        self._floats.move_to_end(size)
        return self._floats[size]

    def _trim(self) -> None:
        while len(self._floats) > 1 and (
            len(self._floats) > SIZES or self.nbytes - self._nbytes_of(next(reversed(self._floats))) > KEPT_BYTES
        ):
            self._drop()

    def _drop(self) -> None:
        """Delete the targets of the size that was used longest ago."""
        self._context.scratch.use()  # nor may the framebuffer that is bound be one of those that go
        size = next(iter(self._floats))
        targets = self._targets_of(size)
        del self._floats[size], self._bytes[size]  # before they go: one that is broken off is not used again
        for target in targets:
            target.release()

    def _nbytes_of(self, size: Size) -> int:
        return sum(target.nbytes for target in self._targets_of(size))

    def _targets_of(self, size: Size) -> list[Target | ByteTarget]:
        return [*self._floats[size].values(), *self._bytes[size].values()]
