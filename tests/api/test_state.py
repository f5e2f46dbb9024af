"""A context that was given, in whatever state its owner left it: pictures are right, and the state is as before."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.gl.context import create_context
from glsplat.renderer import Renderer
from glsplat.renderer.present import Present
from tests.api.current_context import GL, nothing_current
from tests.api.variants import KINDS, SIZE, VIEWS
from tests.scenes import cloud

pytestmark = pytest.mark.gl

F = ctypes.c_float
Set = Callable[["User"], None]


class User:
    """A program with OpenGL of its own, in a moderngl context."""

    def __init__(self) -> None:
        nothing_current()
        self.ctx = moderngl.create_context(standalone=True, backend="egl")
        self.gl = GL(self.ctx)
        ctx = self.ctx
        self.names = (ctypes.c_uint * 4)()
        self.gl.GenSamplers(1, self.names)
        self.gl.SamplerParameteri(self.names[0], 0x2802, 0x8370)  # GL_TEXTURE_WRAP_S, GL_MIRRORED_REPEAT
        self.gl.SamplerParameteri(self.names[0], 0x2800, 0x2601)  # GL_TEXTURE_MAG_FILTER, GL_LINEAR
        self.buffer = ctx.buffer(np.arange(64, dtype=np.float32))
        self.pixels = ctx.buffer(reserve=4 * SIZE * SIZE * 16)
        self.texture = ctx.texture((8, 8), 4, np.random.default_rng(0).integers(0, 256, 256, np.uint8).tobytes())
        self.layers = ctx.texture_array((2, 2, 3), 4)
        self.framebuffer = ctx.framebuffer([ctx.texture((24, 16), 4)], ctx.depth_renderbuffer((24, 16)))
        self.other = ctx.framebuffer([ctx.texture((5, 7), 4)])
        self.program = ctx.program(
            vertex_shader="""
                #version 330
                uniform Block { vec4 shift; };
                void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 3 - 1 + shift.xy, 0.3, 1); }
            """,
            fragment_shader="""
                #version 330
                uniform sampler2D image;
                out vec4 f;
                void main() { f = vec4(texture(image, gl_FragCoord.xy / 9).rgb, 0.5); }
            """,
        )
        self.array = ctx.vertex_array(self.program, [], index_buffer=ctx.buffer(np.arange(3, dtype=np.uint32)))

    def draw(self) -> None:
        """A triangle by raw OpenGL, with everything set anew but what stays from frame to frame."""
        gl = self.gl
        gl.DrawElements(4, 3, 0x1405, None)

    def release(self) -> None:
        nothing_current()
        self.ctx.release()


@pytest.fixture
def user() -> Iterator[User]:
    user = User()
    yield user
    user.release()


@pytest.fixture(scope="module")
def alone() -> dict[str, NDArray[Any]]:
    pictures = {}
    for kind in KINDS:
        with kind.make() as renderer:
            pictures[kind.name] = kind.draw(renderer)
    return pictures


def enabled(*enums: int) -> Set:
    return lambda u: [u.gl.Enable(enum) for enum in enums] and None


def stored(**values: int) -> Set:
    enums = {"swap": 0, "length": 2, "rows": 3, "pixels": 4, "alignment": 5}

    def put(u: User) -> None:
        for side in (0x0D00, 0x0CF0):
            for name, value in values.items():
                u.gl.PixelStorei(side + enums[name], value)

    return put


def bound(u: User) -> None:
    """All that a draw call of the user's looks at."""
    u.framebuffer.use()
    gl = u.gl
    gl.UseProgram(u.program.glo)
    gl.BindVertexArray(u.array.glo)
    gl.BindBufferRange(0x8A11, 0, u.buffer.glo, 0, 64)
    gl.BindBuffer(0x8892, u.buffer.glo)
    gl.ActiveTexture(0x84C0 + 1)
    gl.BindTexture(0x8C1A, u.layers.glo)
    gl.ActiveTexture(0x84C0 + 0)
    gl.BindTexture(0x0DE1, u.texture.glo)
    gl.ActiveTexture(0x84C0 + 5)
    gl.Viewport(3, 2, 17, 11)


def feedback(u: User) -> None:
    gl = u.gl
    if u.ctx.version_code < 400:
        return
    gl.GenTransformFeedbacks(1, ctypes.byref(u.names, 4))
    gl.BindTransformFeedback(0x8E22, u.names[1])
    gl.BindBufferBase(0x8C8E, 0, u.buffer.glo)


def storage(u: User) -> None:
    if u.ctx.version_code >= 430:
        for slot in range(5):
            u.gl.BindBufferRange(0x90D2, slot, u.buffer.glo, 0, 256)


def clip(u: User) -> None:
    if u.ctx.version_code >= 450:
        u.gl.ClipControl(0x8CA2, 0x935F)  # upper left, zero to one


HOSTILE: dict[str, Set] = {
    "wireframe": lambda u: setattr(u.ctx, "wireframe", True),
    "polygon mode": lambda u: u.gl.PolygonMode(0x0408, 0x1B00),
    "blend equation": lambda u: u.gl.BlendEquationSeparate(0x8007, 0x8008),
    "blend": lambda u: (u.gl.Enable(0x0BE2), u.gl.BlendFuncSeparate(0, 0x0300, 0x0302, 1)) and None,
    "logic op": lambda u: (u.gl.Enable(0x0BF2), u.gl.LogicOp(0x1506)) and None,
    "restart index": lambda u: (u.gl.Enable(0x8F9D), u.gl.PrimitiveRestartIndex(3)) and None,
    "sampler": lambda u: [u.gl.BindSampler(unit, u.names[0]) for unit in (0, 1)] and None,
    "pack buffer": lambda u: u.gl.BindBuffer(0x88EB, u.pixels.glo),
    "unpack buffer": lambda u: u.gl.BindBuffer(0x88EC, u.pixels.glo),
    "row length": stored(length=1000),
    "skip": stored(rows=3, pixels=5),
    "swap bytes": stored(swap=1, alignment=8),
    "cull face": lambda u: (u.gl.Enable(0x0B44), u.gl.CullFace(0x0408)) and None,
    "depth": lambda u: (
        (
            u.gl.Enable(0x0B71),
            u.gl.DepthFunc(0x0200),
            u.gl.DepthRange(ctypes.c_double(0.9), ctypes.c_double(0.2)),
            u.gl.DepthMask(0),
        )
        and None
    ),
    "stencil": lambda u: (u.gl.Enable(0x0B90), u.gl.StencilFunc(0x0200, 0, 255)) and None,
    "scissor": lambda u: (u.gl.Enable(0x0C11), u.gl.Scissor(1, 2, 3, 4)) and None,
    "colour mask": lambda u: u.gl.ColorMask(0, 1, 0, 1),
    "discard": enabled(0x8C89),
    "multisample": enabled(0x809E, 0x809F, 0x80A0, 0x8E51),
    "smooth and offset": lambda u: (u.gl.Enable(0x8037), u.gl.Enable(0x0B41), u.gl.PolygonOffset(F(9), F(99))) and None,
    "srgb, clamp, dither": lambda u: (u.gl.Enable(0x8DB9), u.gl.Enable(0x864F), u.gl.Disable(0x0BD0)) and None,
    "clip distances": enabled(*range(0x3000, 0x3008)),
    "clip control": clip,
    "clear values": lambda u: (
        (u.gl.ClearColor(F(0.1), F(0.2), F(0.3), F(0.4)), u.gl.ClearDepth(ctypes.c_double(0.25))) and None
    ),
    "read framebuffer": lambda u: u.gl.BindFramebuffer(0x8CA8, u.other.glo),
    "provoking vertex": lambda u: u.gl.ProvokingVertex(0x8E4D),
    "storage": storage,
    "transform feedback": feedback,
    "bindings": bound,
}
WATCHED = {  # enum -> values
    **dict.fromkeys((0x8B8D, 0x85B5, 0x8894, 0x88ED, 0x88EF, 0x8CA6, 0x8CAA, 0x84E0, 0x0B72, 0x0B74, 0x0B40), 1),
    **dict.fromkeys((0x80C9, 0x80C8, 0x80CB, 0x80CA, 0x8009, 0x883D, 0x8E4F, 0x891C, 0x8F9E, 0x0BF0), 1),
    **dict.fromkeys((0x0BA2, 0x0C10, 0x0C23), 4),
    **dict.fromkeys((0x0D00, 0x0D02, 0x0D03, 0x0D04, 0x0D05, 0x0CF0, 0x0CF2, 0x0CF3, 0x0CF4, 0x0CF5), 1),
}
SWITCHES = (
    0x0BE2, 0x0B71, 0x0B44, 0x8C89, 0x8642, 0x0C11, 0x809E, 0x809F, 0x0B90, 0x0BF2, 0x0BD0, 0x8F9D, 0x8DB9, 0x809D,
    0x80A0, 0x8E51, 0x8037, 0x2A02, 0x2A01, 0x0B41, 0x0B20, 0x864F, *range(0x3000, 0x3008),
)  # fmt: skip


def state_of(user: User) -> dict[str, Any]:
    gl = user.gl
    state: dict[str, Any] = {hex(enum): gl.integers(enum, count) for enum, count in WATCHED.items()}
    state |= {f"on {enum:x}": gl.IsEnabled(enum) & 255 for enum in SWITCHES}
    floats = (ctypes.c_float * 8)()
    gl.GetFloatv(0x0C22, floats)
    gl.GetFloatv(0x0B73, ctypes.byref(floats, 16))
    gl.GetFloatv(0x0B70, ctypes.byref(floats, 20))
    state["clear, range"] = tuple(floats)
    active = gl.integers(0x84E0)[0]
    for unit in (0, 1, 2):
        gl.ActiveTexture(0x84C0 + unit)
        state[f"unit {unit}"] = [gl.integers(enum) for enum in (0x8069, 0x8C1D, 0x8919)]
    gl.ActiveTexture(active)
    state["uniform 0"] = [gl.indexed(enum, 0) for enum in (0x8A28, 0x8A29, 0x8A2A)]
    if user.ctx.version_code >= 430:
        state["storage"] = [[gl.indexed(enum, i) for enum in (0x90D3, 0x90D4, 0x90D5)] for i in range(6)]
    if user.ctx.version_code >= 400:
        state["feedback"] = gl.integers(0x8E25), gl.indexed(0x8C8F, 0)
    if user.ctx.version_code >= 450:
        state["clip"] = gl.integers(0x935C), gl.integers(0x935D)
    state["moderngl"] = user.ctx.fbo and user.ctx.fbo.glo, user.ctx.fbo and user.ctx.viewport, user.ctx.wireframe
    assert gl.GetError() == 0
    return state


def everything(user: User) -> None:
    for name, put in HOSTILE.items():
        if name not in ("polygon mode",):
            put(user)


@pytest.mark.parametrize("name", [*HOSTILE, "everything"])
def test_pictures_and_state(user: User, alone: dict[str, NDArray[Any]], name: str) -> None:
    context = create_context(given=user.ctx)
    kinds = KINDS if name == "everything" else [k for k in KINDS if k.name in ("plain", "float", "gpu", "limb", "mesh")]
    renderers = [(kind, kind.make(context)) for kind in kinds]
    (everything if name == "everything" else HOSTILE[name])(user)
    before = state_of(user)
    for _ in range(2):
        for kind, renderer in renderers:
            picture = kind.draw(renderer)
            assert state_of(user) == before, kind.name
            assert np.array_equal(picture, alone[kind.name]), kind.name
    late = KINDS[0].make(context)
    assert state_of(user) == before
    assert np.array_equal(KINDS[0].draw(late), alone["plain"])
    for _, renderer in renderers:
        renderer.release()
        assert state_of(user) == before
    late.release()
    assert create_context(given=user.ctx).vertex_layers == context.vertex_layers
    context.release()
    assert state_of(user) == before


def test_a_viewport_set_afterwards_is_the_users(user: User) -> None:
    """moderngl's own notes of what is bound stay right too."""
    user.framebuffer.use()
    context = create_context(given=user.ctx)
    with Renderer(cloud(), size=(SIZE, SIZE), context=context) as renderer:
        renderer.render(VIEWS)
        user.ctx.viewport = (1, 2, 3, 4)
        assert user.ctx.fbo is user.framebuffer and user.framebuffer.viewport == (1, 2, 3, 4)
        user.ctx.clear(1.0, 0.0, 0.0, 1.0)
        assert np.frombuffer(user.framebuffer.read(), np.uint8).reshape(-1, 3)[0].tolist() == [255, 0, 0]
        renderer.render(VIEWS)
        assert user.framebuffer.viewport == (1, 2, 3, 4) and user.gl.integers(0x0BA2, 4) == (1, 2, 3, 4)


def test_what_was_bound_may_go_with_the_renderer(user: User) -> None:
    """A user who binds a target of ours and then releases us gets no OpenGL error."""
    context = create_context(given=user.ctx)
    renderer = KINDS[0].make(context)
    target = renderer.draw(VIEWS)  # type: ignore[union-attr]
    target.framebuffer.use()
    target.texture.use(0)
    renderer.release()
    assert user.gl.GetError() == 0
    user.framebuffer.use()
    user.framebuffer.clear(0.0, 1.0, 0.0)
    assert np.frombuffer(user.framebuffer.read(), np.uint8).reshape(-1, 3)[5].tolist() == [0, 255, 0]
    context.release()


def test_present_leaves_the_state_too(user: User) -> None:
    context = create_context(given=user.ctx)
    renderer = KINDS[0].make(context)
    window = user.ctx.framebuffer([user.ctx.texture((2 * SIZE, SIZE), 4)])
    present = Present(context)

    def show() -> bytes:
        present.run(renderer.draw(VIEWS), window, (2 * SIZE, SIZE), "side-by-side")  # type: ignore[union-attr]
        state = state_of(user)
        stored(length=0, rows=0, pixels=0, swap=0, alignment=1)(user)
        user.gl.BindBuffer(0x88EB, 0)
        shown[:] = [state]
        return window.read(components=4)

    shown: list[Any] = []
    clean = show()
    everything(user)
    before = state_of(user)
    assert show() == clean and shown[0] == before
    assert len(set(clean)) > 9
    present.release()
    renderer.release()
    context.release()
