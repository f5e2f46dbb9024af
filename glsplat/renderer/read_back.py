"""Read back: copy targets to arrays on the host, row 0 first (the top row of the image)."""

from __future__ import annotations

import ctypes

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextLostError
from glsplat.gl.context import Context
from glsplat.gl.functions import gl_functions
from glsplat.renderer.stats import Box
from glsplat.renderer.targets import ByteTarget, Target

_PACK_BUFFER, _STREAM_READ, _MAP_READ = 0x88EB, 0x88E1, 0x0001
_GPU_COMMANDS_COMPLETE, _FLUSH_COMMANDS, _TIMEOUT_EXPIRED = 0x9117, 0x0001, 0x911B
_NUMBER_BYTES = 4


def read_floats(target: Target, out: NDArray[np.float32]) -> None:
    """Copy all layers to ``out`` [V, H, W, 4]."""
    if target.numpy_dtype == out.dtype:
        target.texture.read_into(out)
        return
    pixels = np.empty(target.shape, target.numpy_dtype)
    target.texture.read_into(pixels)
    np.multiply(pixels, 1 / 255 if target.numpy_dtype == np.uint8 else 1, out=out, dtype=np.float32, casting="unsafe")


def read_depth(target: Target) -> NDArray[np.float32]:
    """Return the expected camera z [V, H, W] in metres, 0 where nothing was drawn."""
    assert target.depth is not None
    sums = np.frombuffer(target.depth.read(), np.float32).reshape(*target.shape[:3], 2)
    z, weight = sums[..., 0], sums[..., 1]
    return np.divide(z, weight, out=np.zeros_like(z), where=weight > 0)


def read_bytes(target: ByteTarget, out: NDArray[np.uint8], box: Box) -> None:
    """Copy the pixels of ``box`` of every view into ``out`` [V, H, W, 4] and fill the rest with the background.

    The background is taken from the box's rim (sort.covered_box), as the driver rounded it: no seam.
    """
    views, rows, columns, _ = target.shape
    x, y, width, height = box
    if (width, height) == (columns, rows):
        target.framebuffer.read_into(out, components=4)
        return
    part = np.empty((height, width, 4), np.uint8)
    for view in range(views):
        target.framebuffer.read_into(part, viewport=(x, view * rows + y, width, height), components=4)
        _place(part, out[view], box)


def _place(part: NDArray[np.uint8], out: NDArray[np.uint8], box: Box) -> None:
    """Copy the pixels ``part`` of ``box`` into ``out`` [H, W, 4] and fill the rest with the background."""
    x, y, width, height = box
    if part.shape != out.shape:
        background = part[0, 0] if x or y else part[-1, -1]
        out.view(np.uint32).fill(background.copy().view(np.uint32)[0])  # whole pixels: 30 times as fast
    out[y : y + height, x : x + width] = part


class PackBuffers:
    """The pixel-pack buffers of a context: the GPU copies a picture into one, and the next picture is drawn meanwhile.

    There are as many as pictures that are under way at once; each is used again.
    """

    def __init__(self, context: Context) -> None:
        self.context: Context = context
        function, unsigned, pointer = gl_functions(context.ctx), ctypes.c_uint, ctypes.c_void_p
        self.bind = function("BindBuffer", None, unsigned, unsigned)
        self.allocate = function("BufferData", None, unsigned, ctypes.c_ssize_t, pointer, unsigned)
        self.map = function("MapBufferRange", pointer, unsigned, ctypes.c_ssize_t, ctypes.c_ssize_t, unsigned)
        self.unmap = function("UnmapBuffer", ctypes.c_ubyte, unsigned)
        self.fence = function("FenceSync", pointer, unsigned, unsigned)
        self.wait = function("ClientWaitSync", unsigned, pointer, unsigned, ctypes.c_uint64)
        self.delete = function("DeleteSync", None, pointer)
        self.pictures = 0
        self._free: list[moderngl.Buffer] = []
        self._used: list[moderngl.Buffer] = []

    @property
    def used(self) -> int:
        """Buffers of pictures that are under way."""
        return len(self._used)

    def transfer(self) -> Transfer:
        """Return the transfer of another picture."""
        return Transfer(self)

    def take(self, nbytes: int) -> moderngl.Buffer:
        """Return a buffer of at least ``nbytes``."""
        buffer = self._free.pop() if self._free else None
        if buffer is None or buffer.size < nbytes:
            if buffer is not None:
                buffer.release()
            buffer = self.context.ctx.buffer(reserve=nbytes)
            self.bind(_PACK_BUFFER, buffer.glo)
            self.allocate(_PACK_BUFFER, nbytes, None, _STREAM_READ)  # in host memory; moderngl has no such hint
            self.bind(_PACK_BUFFER, 0)
        self._used.append(buffer)
        return buffer

    def give_back(self, buffer: moderngl.Buffer) -> None:
        """Use a buffer again; harmless after ``release``."""
        if buffer in self._used:
            self._used.remove(buffer)
            self._free.append(buffer)

    def release(self) -> None:
        """Delete all buffers, also those in use."""
        buffers, self._free, self._used = self._free + self._used, [], []
        for buffer in buffers:
            buffer.release()


class Transfer:
    """The pixels of one 8-bit picture, on their way from the GPU to the host. Call ``drop`` at the end.

    A number is drawn and read after the pixels: a lost context may ignore calls without an error, and the buffer would
    still hold another client's picture.
    """

    def __init__(self, buffers: PackBuffers) -> None:
        self._buffers = buffers
        self._buffer: moderngl.Buffer | None = None
        self._parts: list[tuple[NDArray[np.uint8], Box, int]] = []  # picture [H, W, 4], its box, first byte
        self._filled = 0  # bytes
        self._fence: int | None = None
        buffers.pictures = (buffers.pictures + 1) % 2**32
        self._number = buffers.pictures.to_bytes(_NUMBER_BYTES, "little")

    def begin(self, nbytes: int) -> None:
        """Take a buffer for pixels of ``nbytes``."""
        self._buffer = self._buffers.take(nbytes + _NUMBER_BYTES)

    def read(self, target: ByteTarget, out: NDArray[np.uint8], box: Box) -> None:
        """Let the GPU copy the pixels of ``box`` of every view; ``collect`` puts them into ``out`` [V, H, W, 4]."""
        x, y, width, height = box
        for view, picture in enumerate(out):
            part = (x, view * target.shape[1] + y, width, height)
            target.framebuffer.read_into(self._buffer, part, components=4, write_offset=self._filled)
            self._parts.append((picture, box, self._filled))
            self._filled += 4 * width * height

    def end(self) -> None:
        """Set the fence behind the picture."""
        scratch = self._buffers.context.scratch
        red, green, blue, alpha = (byte / 255 for byte in self._number)
        scratch.clear(red, green, blue, alpha)
        scratch.read_into(self._buffer, components=4, write_offset=self._filled)
        self._fence = self._buffers.fence(_GPU_COMMANDS_COMPLETE, 0)

    def ready(self, seconds: float) -> bool:
        """Wait up to ``seconds``; return whether the GPU has finished (or has failed: ``collect`` finds out)."""
        return bool(self._buffers.wait(self._fence, _FLUSH_COMMANDS, int(seconds * 1e9)) != _TIMEOUT_EXPIRED)

    def collect(self) -> None:
        """Wait for the pixels and put them where they go. Raises ContextLostError."""
        buffers, count = self._buffers, self._filled + _NUMBER_BYTES
        assert self._buffer is not None
        with buffers.context.entered("Transfer.collect()"):
            buffers.bind(_PACK_BUFFER, self._buffer.glo)
            address = buffers.map(_PACK_BUFFER, 0, count, _MAP_READ)
            try:
                found = np.ctypeslib.as_array((ctypes.c_uint8 * count).from_address(address)) if address else None
                if found is None or found[self._filled :].tobytes() != self._number:
                    raise ContextLostError(f"{buffers.context.driver} does not respond")
                for out, box, start in self._parts:
                    width, height = box[2:]
                    _place(found[start : start + 4 * width * height].reshape(height, width, 4), out, box)
            finally:
                if address:
                    buffers.unmap(_PACK_BUFFER)
                buffers.bind(_PACK_BUFFER, 0)

    def drop(self) -> None:
        """Release the buffer, collected or not; may be called twice."""
        buffer, fence, self._buffer, self._fence = self._buffer, self._fence, None, None
        if fence is not None:
            self._buffers.delete(fence)
        if buffer is not None:
            self._buffers.give_back(buffer)
