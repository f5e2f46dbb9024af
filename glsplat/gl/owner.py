"""Owner: the process and the thread a context belongs to, and what nobody released in it.

Everything that owns GL objects does its work inside ``with owner.entered(...)``: the context is made current, and what
was current before is given back. Both together cost a few microseconds.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
import weakref
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Protocol

import moderngl

from glsplat.errors import ContextError
from glsplat.gl import current

__all__ = ["ContextGuard", "Owner", "State", "check_process", "destroy_when_dropped", "owner_of", "release_later"]

_forks = 0  # between the first process and this one
_made_after: int | None = None  # forks when the newest context was made


def _count_fork() -> None:
    global _forks
    _forks += 1


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_count_fork)

_FORKED = (
    "was made before this process was forked, and the driver's threads are not in the child; "
    "start the child with multiprocessing.get_context('spawn') and make the renderer there"
)


class State(Protocol):
    """GL state that a user set."""

    def save(self) -> Any:
        """Note it, and set what drawing needs."""

    def restore(self, was: Any) -> None:
        """Set what was noted."""


class Owner:
    """Of one OpenGL context."""

    def __init__(self, binding: current.Binding | None) -> None:
        global _made_after
        self.orphans: list[Callable[[], None]] = []  # what releases things that were dropped without release()
        self.inside = 0  # stays that are not over
        self._busy: tuple[str, FrameType] | None = None  # the call that draws, and where
        self.destroyed = False
        self.warned = False
        self.adopt(binding)
        _made_after = _forks

    def adopt(self, binding: current.Binding | None) -> None:
        """This thread is the owner from now on, and its context is ``binding`` (None: nothing is known of it)."""
        self.binding, self.thread, self._forks = binding, threading.get_ident(), _forks
        self._name = threading.current_thread().name

    @property
    def forked(self) -> bool:
        """True in a child of the process that made the context."""
        return self._forks != _forks

    @property
    def here(self) -> bool:
        """True on the owner's thread."""
        return self.thread == threading.get_ident() and not self.forked

    def check(self, call: str) -> None:
        """ContextError on any thread but the owner's, in a forked child, and within a call that draws."""
        if self._forks != _forks:
            raise ContextError(f"{call}: the OpenGL context {_FORKED}")
        if self.thread != threading.get_ident():
            raise ContextError(
                f"{call} was called on thread {threading.current_thread().name!r}, but its OpenGL context belongs to "
                f"thread {self._name!r}; call it there, or make and use the renderer in one ThreadPoolExecutor(1)"
            )
        if self._busy is None:
            return
        # one that was broken off while it ended is still noted, but nobody's caller any more
        former, begun = self._busy
        frame: FrameType | None = sys._getframe()
        while frame is not None and frame is not begun:
            frame = frame.f_back
        if frame is not None:
            raise ContextError(
                f"{call} was called within {former}, by a signal handler or a callback, and both draw in one context; "
                "call it when that is over"
            )

    def begin(self, call: str, frame: FrameType) -> None:
        """From now on ``call`` draws, which was called in ``frame``."""
        self._busy = call, frame

    def end(self) -> None:
        """Nothing draws any more."""
        self._busy = None

    def entered(self, call: str, state: State | None = None) -> ContextGuard:
        """``with`` it the context is current; then what was before is again. Raises ContextError as check() does."""
        return ContextGuard(self, call, state)

    def leave(self) -> None:
        """Leave the thread without a context if this one is current."""
        if self.binding is not None and current.is_current(self.binding):
            current.unbind()


class ContextGuard:
    """One stay in a context."""

    __slots__ = ("_call", "_draws", "_former", "_owner", "_state", "_switched", "_was")

    def __init__(self, owner: Owner, call: str, state: State | None, draws: bool = True) -> None:
        self._owner, self._call, self._state = owner, call, state
        self._draws = draws  # else others may draw within it
        self._switched, self._was = False, None
        self._former: current.Binding | None = None

    def __enter__(self) -> None:
        owner = self._owner
        owner.check(self._call)
        if _orphans and not owner.inside:
            release_dropped()
        owner.inside += 1
        try:
            if owner.binding is not None and not current.is_current(owner.binding):
                self._former = current.binding()
                self._switched = True
                current.bind(owner.binding)
            if self._state is not None:
                self._was = self._state.save()
            while owner.orphans and owner.inside == 1:
                owner.orphans.pop()()
            if self._draws:
                owner.begin(self._call, sys._getframe(1))
        except BaseException:  # Ctrl-C as well: what was current must not be lost
            self._leave()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave()

    def _leave(self) -> None:
        self._owner.inside -= 1
        if self._draws:
            self._owner.end()
        try:
            if self._state is not None and self._was is not None:
                self._state.restore(self._was)
        finally:
            if self._switched:
                current.give_back(self._former)


_owners: weakref.WeakKeyDictionary[moderngl.Context, Owner] = weakref.WeakKeyDictionary()
_orphans: dict[int, list[Callable[[], None]]] = {}
"""Contexts that were dropped on another thread than theirs, or in the middle of a frame; by their thread."""


def owner_of(ctx: moderngl.Context, binding: current.Binding | None = None) -> Owner:
    """The one owner of ``ctx``. A context that is met for the first time belongs to this thread."""
    owner = _owners.get(ctx)
    if owner is None:
        owner = _owners[ctx] = Owner(binding or current.binding())
    elif binding is not None:
        owner.adopt(binding)
    return owner


def check_process() -> None:
    """ContextError in a child of a process that made contexts: the driver would wait for threads for ever."""
    if _made_after not in (None, _forks):
        raise ContextError(f"an OpenGL context {_FORKED}")


def destroy_when_dropped(ctx: moderngl.Context, owner: Owner, label: str) -> None:
    """Destroy the context once nobody holds ``ctx`` any more, with a ResourceWarning unless it was released."""
    native = ctx.mglo

    def destroy() -> None:
        owner.leave()
        native.release()

    def dropped() -> None:
        if owner.destroyed or owner.forked or sys.is_finalizing():
            return
        _free(owner, destroy)
        if not owner.warned:
            _warn(label)

    weakref.finalize(ctx, dropped).atexit = False


def release_later(label: str, owner: Owner, release: Callable[[], None], owns_context: bool) -> None:
    """From ``__del__``: warn, and free it, or have it freed when its thread next draws.

    It may be any thread's garbage collector that calls, and in the middle of a frame. What lies in a context that
    others use waits until they enter it; a context of its own is entered now if this is its thread.
    """
    if owner.forked or sys.is_finalizing():
        return
    if owns_context:
        _free(owner, release)
    else:
        owner.orphans.append(release)
    owner.warned = owner.warned or owns_context  # one warning is enough for both
    _warn(label)


def release_dropped() -> None:
    """Free what was dropped by this thread, or for it."""
    for release in _orphans.pop(threading.get_ident(), ()):
        release()


def _free(owner: Owner, release: Callable[[], None]) -> None:
    if owner.here and not owner.inside:
        release()
    else:
        _orphans.setdefault(owner.thread, []).append(release)


def _warn(label: str) -> None:
    # without the object as its source: whoever records warnings would keep it alive
    warnings.warn(f"{label} was never released; call release() or use a with block", ResourceWarning, 4)
