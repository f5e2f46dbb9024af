"""FakeRuntime: an OpenXR runtime that behaves like Monado 25.0.0, with images that are OpenGL textures.

It refuses what a runtime refuses: calls out of order, invalid poses, held images.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import hypot, pi

import numpy as np

from glsplat.errors import ContextError, ContextLostError
from glsplat.extras.openxr.runtime import Devices, Event, Fov, FrameTiming, Projection, State, ViewPose
from glsplat.gl.context import Context
from glsplat.gl.functions import gl_functions
from glsplat.tracking.sample import Transform

HEAD: Transform = (0.1, 1.6, 0.2, 0.0, 0.0, 0.0, 1.0)
FOVS = (Fov(-0.94, 0.70, 0.73, -0.96), Fov(-0.70, 0.94, 0.73, -0.96))
GRIPS = ((-0.25, 1.1, -0.2, 0.0, 0.0, 0.0, 1.0), (0.25, 1.2, -0.3, 0.0, 0.0, 0.0, 1.0))
SRGB8, RGBA8, RGBA16F, DEPTH32F, DEPTH24 = 0x8C43, 0x8058, 0x881A, 0x8CAC, 0x81A6
PERIOD = 13_888_889  # nanoseconds


class FakeRuntime:
    """Tests set ``tracked``, ``eyes`` and ``fovs``; ``shown`` is what came with each frame, ``log`` all calls."""

    name = "a fake runtime"

    def __init__(
        self,
        context: Context | None = None,  # None: no images
        *,
        size: tuple[int, int] = (96, 80),
        arrays: bool = True,  # False: images of one layer only
        formats: Sequence[int] = (0x805B, RGBA16F, SRGB8, RGBA8, DEPTH32F, 0x81A5),  # Monado's, in its order
        blends: Sequence[str] = ("opaque",),
    ) -> None:
        self.size, self.max_size = size, (4096, 4096)
        self.formats, self.blends = tuple(formats), tuple(blends)
        self.extensions = frozenset({"XR_KHR_opengl_enable", "XR_EXT_hand_tracking"})
        self.tracked = Devices(head=HEAD, grips=GRIPS)
        self.eyes: tuple[Transform, ...] | None = tuple((HEAD[0] + x, *HEAD[1:]) for x in (-0.032, 0.032))
        self.fovs = FOVS
        self.log: list[str] = []
        self.shown: list[tuple[Projection | None, str]] = []
        self.swapchains: list[FakeSwapchain] = []
        self.dead = self.closed = False
        self.should_render = True
        self.place: Transform | None = None
        self._context, self._arrays = context, arrays
        self._state, self._running = State.UNKNOWN, False
        self._frame = ""  # "", waited, begun
        self._time = 1_000_000_000
        self._events: deque[Event] = deque()
        self._turn(State.IDLE, State.READY)

    def kill(self) -> None:
        """As when its process dies: nothing answers any more."""
        self.dead = True

    def recentre(self) -> None:
        """The user asked for it; it counts from the frame after the next."""
        self._events.append(Event("recentred", time=self._time + 2 * PERIOD))

    def tell(self, *events: Event) -> None:
        self._events.extend(events)

    def _turn(self, *states: State) -> None:
        for state in states:
            self._events.append(Event("state", state))

    def _call(self, name: str, wanted: bool = True, why: str = "") -> None:
        if self.closed:
            raise AssertionError(f"{name} after close()")
        if self.dead:
            raise ContextLostError(f"the OpenXR runtime is gone ({name}: InstanceLostError)")
        self.log.append(name)
        if not wanted:
            raise ContextError(f"the OpenXR runtime refuses {name}: CallOrderInvalidError: {why}")

    def poll(self) -> Event | None:
        if self.dead:
            raise ContextLostError("the OpenXR runtime is gone (xrPollEvent: InstanceLostError)")
        if not self._events:
            return None
        event = self._events.popleft()
        if event.kind == "state":
            self._state = event.state
        return event

    def begin(self) -> None:
        self._call("begin", self._state is State.READY and not self._running, f"in {self._state.name}")
        self._running, self._first = True, True
        self._turn(State.SYNCHRONIZED, State.VISIBLE, State.FOCUSED)

    def end(self) -> None:
        self._call("end", self._state is State.STOPPING, f"in {self._state.name}")
        self._running = False
        self._turn(State.IDLE, State.EXITING)

    def request_exit(self) -> None:
        self._call("request_exit", self._running, "not running")
        self._turn(State.STOPPING)

    def wait_frame(self) -> FrameTiming:
        self._call("wait_frame", self._running and self._frame == "", f"frame {self._frame or 'not running'}")
        self._frame = "waited"
        self._time += PERIOD
        drawn, self._first = self.should_render and not self._first, False
        return FrameTiming(self._time, PERIOD, drawn)

    def begin_frame(self) -> None:
        self._call("begin_frame", self._frame == "waited", f"frame {self._frame}")
        self._frame = "begun"

    def end_frame(self, display_time: int, projection: Projection | None, blend: str) -> None:
        self._call("end_frame", self._frame == "begun", f"frame {self._frame}")
        self._frame = ""
        assert display_time == self._time
        assert blend in self.blends, f"blends by {blend}"
        if projection is not None:
            self._check(projection)
        self.shown.append((projection, blend))

    def views(self, time: int) -> tuple[ViewPose, ViewPose] | None:
        self._call("views", self._frame == "begun", "outside a frame")
        if self.eyes is None:
            return None
        left, right = (ViewPose(self._moved(eye), fov) for eye, fov in zip(self.eyes, self.fovs, strict=True))
        return left, right

    def devices(self, time: int, active: bool) -> Devices:
        self._call("devices", self._running, "not running")
        tracked = self.tracked
        if not active:  # actions are silent then
            tracked = replace(tracked, grips=(None, None), gaze=None, next_view=False)
        return replace(tracked, head=None if tracked.head is None else self._moved(tracked.head))

    def move(self, place: Transform) -> None:
        self._call("move")
        self.place = place

    def swapchain(self, internal_format: int, size: tuple[int, int], layers: int, depth: bool) -> FakeSwapchain:
        self._call("swapchain")
        if internal_format not in self.formats:
            raise ContextError("the OpenXR runtime refuses xrCreateSwapchain: SwapchainFormatUnsupportedError")
        if layers > 1 and not self._arrays:
            raise ContextError("the OpenXR runtime refuses xrCreateSwapchain: FeatureUnsupportedError")
        made = FakeSwapchain(self, self._context, internal_format, size, layers)
        self.swapchains.append(made)
        return made

    def close(self) -> None:
        self.closed = True

    def _moved(self, pose: Transform) -> Transform:
        """In the space as it was put elsewhere; about the vertical only."""
        if self.place is None:
            return pose
        x, _, z, _, sine, _, cosine = self.place
        dx, dz, s, c = pose[0] - x, pose[2] - z, 2 * sine * cosine, cosine * cosine - sine * sine
        qx, qy, qz, qw = pose[3:]
        turned = (cosine * qx - sine * qz, cosine * qy - sine * qw, cosine * qz + sine * qx, cosine * qw + sine * qy)
        return (c * dx - s * dz, pose[1], s * dx + c * dz, *turned)

    def _check(self, projection: Projection) -> None:
        """As a validation layer would."""
        assert len(projection.views) == 2
        for view in projection.views:
            assert abs(hypot(*view.pose[3:]) - 1) < 1e-3
            assert -pi / 2 < view.fov.left < view.fov.right < pi / 2
            assert -pi / 2 < view.fov.down < view.fov.up < pi / 2
        for chains in (projection.colour, projection.depth):
            assert len(chains) in ((0, 1, 2) if chains is projection.depth else (1, 2))
            for chain in chains:
                assert isinstance(chain, FakeSwapchain) and not chain.closed and chain.layers == 3 - len(chains)
                assert chain.released and not chain.held, "shown while it is drawn into, or before it ever was"
        if projection.depth:
            assert projection.depth_range is not None and 0 < projection.depth_range.near < projection.depth_range.far


class FakeSwapchain:
    def __init__(
        self, runtime: FakeRuntime, context: Context | None, internal_format: int, size: tuple[int, int], layers: int
    ) -> None:
        self.size, self.layers, self.format = size, layers, internal_format
        self.held: list[int] = []
        self.released = 0
        self.closed = False
        self._runtime, self._context, self._next = runtime, context, 0
        self.textures: list[int] = [0, 0, 0] if context is None else [self._texture(context) for _ in range(3)]

    @property
    def last(self) -> int:
        """The texture released last."""
        return self.textures[(self._next - 1) % 3]

    def acquire(self) -> int:
        self._runtime._call("acquire", not self.held and not self.closed, "held")
        self.held.append(self._next)
        self._next = (self._next + 1) % 3
        return self.held[-1]

    def release(self) -> None:
        self._runtime._call("release", bool(self.held), "not held")
        self.held.pop()
        self.released += 1

    def close(self) -> None:
        assert not self.closed
        self.closed = True

    @property
    def _target(self) -> int:
        return 0x8C1A if self.layers > 1 else 0x0DE1

    def _texture(self, context: Context) -> int:
        function = gl_functions(context.ctx)
        name = ctypes.c_uint()
        function("GenTextures", None, ctypes.c_int, ctypes.c_void_p)(1, ctypes.byref(name))
        bind = function("BindTexture", None, ctypes.c_uint, ctypes.c_uint)
        bind(self._target, name.value)
        deep = self.format in (DEPTH32F, DEPTH24, 0x81A5)
        kinds = (0x1902, 0x1406) if deep else (0x1908, 0x1401)
        pixels = (ctypes.c_ubyte * (self.size[0] * self.size[1] * 8 * self.layers))(*([77] * 16))  # not black
        numbers = [ctypes.c_uint, ctypes.c_int, ctypes.c_int, *[ctypes.c_int] * (2 + (self.layers > 1))]
        rest = [ctypes.c_int, ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p]
        call = function("TexImage3D" if self.layers > 1 else "TexImage2D", None, *numbers, *rest)
        shape = (*self.size, self.layers) if self.layers > 1 else self.size
        call(self._target, 0, self.format, *shape, 0, *kinds, pixels)
        for parameter in (0x2801, 0x2800):  # GL_TEXTURE_MIN_FILTER, MAG: without mipmaps
            function("TexParameteri", None, ctypes.c_uint, ctypes.c_uint, ctypes.c_int)(self._target, parameter, 0x2600)
        bind(self._target, 0)
        return name.value

    def read(self) -> np.ndarray:
        """[layers, H, W, 4] bytes, or [layers, H, W] floats of a depth, of the image released last; row 0 on top."""
        assert self._context is not None
        function = gl_functions(self._context.ctx)
        deep = self.format in (DEPTH32F, DEPTH24, 0x81A5)
        shape = (self.layers, self.size[1], self.size[0])
        out = np.empty(shape if deep else (*shape, 4), np.float32 if deep else np.uint8)
        bind = function("BindTexture", None, ctypes.c_uint, ctypes.c_uint)
        bind(self._target, self.last)
        read = function("GetTexImage", None, *[ctypes.c_uint] * 4, ctypes.c_void_p)
        read(self._target, 0, *((0x1902, 0x1406) if deep else (0x1908, 0x1401)), out.ctypes.data)
        bind(self._target, 0)
        return out[:, ::-1]
