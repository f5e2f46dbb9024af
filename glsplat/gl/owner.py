"""Owner: the process and the thread of a context, and its GL objects queued for deletion.

Everything that owns GL objects works inside ``with owner.entered(...)``: the context is made current, and the previous
one is restored. Both together cost a few microseconds.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
import weakref
from collections.abc import Callable
from types import FrameType

import moderngl

from glsplat.errors import ContextError
from glsplat.gl import current
from glsplat.gl.state import GLState, Snapshot

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


class Owner:
    """Owner of one OpenGL context: its process, its thread, and objects queued for deletion."""

    def __init__(self, binding: current.Binding | None) -> None:
        global _made_after
        self.orphans: list[Callable[[], None]] = []  # deletes objects that were garbage collected without release()
        self.inside = 0  # guards that are entered
        self._busy: tuple[str, FrameType] | None = None  # the active draw call and its frame
        self.destroyed = False
        self.warned = False
        self.adopt(binding)
        _made_after = _forks

    def adopt(self, binding: current.Binding | None) -> None:
        """Make this thread the owner of ``binding``; None if the platform cannot report it."""
        self.binding, self.thread, self._forks = binding, threading.get_ident(), _forks
        self._name = threading.current_thread().name

    @property
    def forked(self) -> bool:
        """Return whether this is a forked child of the process that made the context."""
        return self._forks != _forks

    @property
    def here(self) -> bool:
        """Return whether this is the owner's thread."""
        return self.thread == threading.get_ident() and not self.forked

    def check(self, call: str) -> None:
        """Raise ContextError on another thread, in a forked child, and within an active draw call."""
        if self._forks != _forks:
            raise ContextError(f"{call}: the OpenGL context {_FORKED}")
        if self.thread != threading.get_ident():
            raise ContextError(
                f"{call} was called on thread {threading.current_thread().name!r}, but its OpenGL context belongs to "
                f"thread {self._name!r}; call it there, or make and use the renderer in one ThreadPoolExecutor(1)"
            )
        if self._busy is None:
            return
        # a draw that an exception interrupted while it ended is still recorded, but no longer a caller
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
        """Mark ``call`` in ``frame`` as the active draw; nested calls are refused."""
        self._busy = call, frame

    def end(self) -> None:
        """Clear the active draw."""
        self._busy = None

    def entered(self, call: str, state: GLState | None = None) -> ContextGuard:
        """Return a context manager that makes the context current, then restores the former. Raises as check() does."""
        return ContextGuard(self, call, state)

    def leave(self) -> None:
        """Unbind the context if it is current on this thread."""
        if self.binding is not None and current.is_current(self.binding):
            current.unbind()


class ContextGuard:
    """Context manager: makes a context current, and restores the previous one and its state."""

    __slots__ = ("_call", "_draws", "_former", "_owner", "_state", "_switched", "_was")

    def __init__(self, owner: Owner, call: str, state: GLState | None, draws: bool = True) -> None:
        self._owner, self._call, self._state = owner, call, state
        self._draws = draws  # False: calls within it may draw
        self._switched = False
        self._was: Snapshot | None = None
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
        except BaseException:  # also Ctrl-C: the previous context has to be restored
            self._leave()
            raise

    def __exit__(self, *_: object) -> None:
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
"""Deletions of contexts that were dropped on another thread than their own, or during a frame; by thread."""


def owner_of(ctx: moderngl.Context, binding: current.Binding | None = None) -> Owner:
    """Return the owner of ``ctx``. An unknown context becomes owned by this thread."""
    owner = _owners.get(ctx)
    if owner is None:
        owner = _owners[ctx] = Owner(binding or current.binding())
    elif binding is not None:
        owner.adopt(binding)
    return owner


def check_process() -> None:
    """Raise ContextError in a forked child of a process with contexts: the driver's threads are missing there."""
    if _made_after not in (None, _forks):
        raise ContextError(f"an OpenGL context {_FORKED}")


def destroy_when_dropped(ctx: moderngl.Context, owner: Owner, label: str) -> None:
    """Destroy the context when ``ctx`` is garbage collected, with a ResourceWarning unless it was released."""
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
    """Warn that an object was not released, and queue ``release``. Called by ``__del__``.

    The garbage collector may run on any thread and during a frame. Objects in a shared context are freed the next time
    its owner enters it. An object that owns its context is freed now if this is its thread.
    """
    if owner.forked or sys.is_finalizing():
        return
    if owns_context:
        _free(owner, release)
    else:
        owner.orphans.append(release)
    owner.warned = owner.warned or owns_context  # one warning for the object and its context
    _warn(label)


def release_dropped() -> None:
    """Destroy the contexts queued for deletion on this thread."""
    for release in _orphans.pop(threading.get_ident(), ()):
        release()


def _free(owner: Owner, release: Callable[[], None]) -> None:
    if owner.here and not owner.inside:
        release()
    else:
        _orphans.setdefault(owner.thread, []).append(release)


def _warn(label: str) -> None:
    # no ``source``: a recorded warning would keep the object alive
    warnings.warn(f"{label} was never released; call release() or use a with block", ResourceWarning, 4)
