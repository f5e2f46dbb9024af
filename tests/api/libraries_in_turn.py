"""Run by test_contexts in a process of its own: EGL, OSMesa and a GLX window, in turn and nested."""

from __future__ import annotations

import ctypes
import itertools
import sys
from contextlib import ExitStack
from typing import Any

import moderngl
import numpy as np

from glsplat.gl.context import Context, create_context
from tests import needs
from tests.api.current_context import asked
from tests.api.variants import KINDS

NAMES = ("plain", "gpu", "limb", "mesh")


def main() -> None:
    contexts: dict[str, Context] = {"egl": create_context(backend="egl"), "osmesa": create_context(backend="osmesa")}
    users = moderngl.create_context(standalone=True, backend="egl")
    contexts["given egl"] = create_context(given=users)
    glfw: Any = None
    if "window" in sys.argv:
        import glfw

        contexts["egl"].owner.leave()
        with users:
            pass  # moderngl leaves the thread without a context
        assert glfw.init()
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 4)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 5)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        handle = glfw.create_window(64, 64, "", None, None)
        glfw.make_context_current(handle)
        assert asked()[3], "no GLX context"
        contexts["window"] = create_context(given=moderngl.create_context())
        assert asked()[3]
    assert needs.met("osmesa")
    osmesa = ctypes.CDLL("libOSMesa.so.8")
    osmesa.OSMesaGetCurrentContext.restype = ctypes.c_void_p

    kinds = [kind for kind in KINDS if kind.name in NAMES]
    assert len(kinds) == len(NAMES)
    renderers = {(where, kind.name): kind.make(context) for where, context in contexts.items() for kind in kinds}
    renderers |= {("its own", kind.name): kind.make() for kind in kinds}
    expected = {}
    for kind in kinds:
        with kind.make() as renderer:
            expected[kind.name] = kind.draw(renderer)

    def check(where: str) -> None:
        for kind in kinds:
            picture = kind.draw(renderers[where, kind.name])
            off = np.abs(picture.astype(float) - expected[kind.name])
            # OSMesa is another build of the same rasterizer
            assert off.max() <= (1 if where == "osmesa" else 0), (where, kind.name, off.max())

    order = [*contexts, "its own"]
    for first, second in itertools.permutations(order, 2):
        for where in (first, second, first):
            check(where)
    for outer, inner in itertools.permutations(contexts, 2):  # nested in with blocks, and given back
        with ExitStack() as stack:
            stack.enter_context(contexts[outer])
            before = asked(), osmesa.OSMesaGetCurrentContext()
            with contexts[inner]:
                check(outer)
                check(inner)
            check("its own")
            after = asked(), osmesa.OSMesaGetCurrentContext()
            assert before == after, (outer, inner, before, after)
            framebuffer = contexts[outer].ctx.simple_framebuffer((4, 4))  # a user's calls arrive where they should
            framebuffer.clear(0.5, 0.25, 1.0)
            assert np.abs(np.frombuffer(framebuffer.read(), np.uint8)[:3] - [127.5, 63.75, 255]).max() < 1
            framebuffer.release()
            assert contexts[inner] is not contexts[outer]
    for context in contexts.values():
        with context:
            assert context.ctx.error == "GL_NO_ERROR"
    for renderer in renderers.values():
        renderer.release()
    for context in contexts.values():
        context.release()
    if glfw is not None:
        glfw.terminate()
    users.release()
    print("right")


if __name__ == "__main__":
    main()
