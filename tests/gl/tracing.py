"""A context that counts its GL calls: each function that is loaded is a thunk that counts, then jumps to the driver."""

from __future__ import annotations

import ctypes
import importlib
import mmap
import platform
import struct
from collections import Counter
from typing import Any

import moderngl
import pytest

_THUNK_BYTES = 32  # count, address, and 12 bytes of code
_MAX_FUNCTIONS = 1024


class Tracing:
    """moderngl's interface of a context object on an EGL context, with a number of calls for each function."""

    def __init__(self) -> None:
        if platform.machine() not in ("x86_64", "AMD64"):
            pytest.skip("calls are counted by x86-64 code")
        egl: Any = importlib.import_module("glcontext").get_backend_by_name("egl")  # it has no types
        self._context: Any = egl(mode="standalone", device_index=0)
        access = mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
        self._thunks = mmap.mmap(-1, _MAX_FUNCTIONS * _THUNK_BYTES, prot=access)
        self._start = ctypes.addressof(ctypes.c_char.from_buffer(self._thunks))
        self._names: list[str] = []

    def load_opengl_function(self, name: str) -> int:
        """Return the address of a function's thunk, 0 if there is no such function."""
        address = self._context.load(name)
        if not address:
            return 0
        place = len(self._names) * _THUNK_BYTES
        self._names.append(name)
        # count: u64; address: u64; inc qword [rip - 23]; jmp [rip - 21]
        code = b"\x48\xff\x05" + struct.pack("<i", -23) + b"\xff\x25" + struct.pack("<i", -21)
        self._thunks[place : place + 16 + len(code)] = struct.pack("<QQ", 0, address) + code
        return self._start + place + 16

    def counts(self) -> Counter[str]:
        """Return the calls by function since the last call of this method."""
        found: Counter[str] = Counter()
        for index, name in enumerate(self._names):
            place = index * _THUNK_BYTES
            (count,) = struct.unpack_from("<Q", self._thunks, place)
            if count:
                found[name] += count
                self._thunks[place : place + 8] = bytes(8)
        return found

    def context(self) -> moderngl.Context:
        """Return the context, current on this thread."""
        context: Any = self
        return moderngl.create_context(require=330, context=context)

    def __enter__(self) -> Tracing:
        self._context.__enter__()
        return self

    def __exit__(self, *args: object) -> None:
        self._context.__exit__(*args)

    def release(self) -> None:
        """Destroy the context."""
        self._context.release()
