"""Contexts: device choice, backends, and errors that say what to do."""

from __future__ import annotations

import subprocess
import sys

import moderngl
import numpy as np
import pytest

from glsplat.errors import ContextError
from glsplat.gl import context as module
from glsplat.gl.context import Context, create_context, egl_devices
from glsplat.renderer import Renderer
from tests import needs
from tests.scenes import cloud, eyes

pytestmark = pytest.mark.gl


def test_device_by_index_name_and_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    names = egl_devices()
    assert names
    for device in (0, "0", names[0][:6].lower()):
        context = create_context(device)
        assert context.backend == "egl"
        context.release()
    monkeypatch.setenv("GLSPLAT_DEVICE", "no such device")
    with pytest.raises(ContextError, match=r"no EGL device 'no such device'; give an index or a part of a name: 0 = "):
        create_context()
    with pytest.raises(ContextError, match="no EGL device '99'"):
        create_context(99)


def test_no_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "egl_devices", list)
    monkeypatch.setattr(module, "_osmesa_library", lambda: None)
    with pytest.raises(ContextError, match="found 0 EGL devices; install"):
        create_context()
    with pytest.raises(ContextError, match=r"no OSMesa library; .*apt-get install libosmesa6"):
        create_context(backend="osmesa")
    with pytest.raises(ContextError, match="backend needs egl or osmesa, not metal"):
        create_context(backend="metal")


def test_given_context_is_not_released(context: Context) -> None:
    with context.ctx:
        given = create_context(given=context.ctx)
        assert given.backend == "given" and given.vertex_layers == context.vertex_layers
        given.release()
        assert context.ctx.buffer(reserve=4).size == 4


def test_old_opengl_is_refused(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    class Old(moderngl.Context):
        version_code = 320
        info = context.ctx.info

        def __init__(self) -> None: ...

        def __del__(self) -> None: ...

    with pytest.raises(ContextError, match=r"OpenGL 3\.3 is needed, this context has 3\.2"):
        create_context(given=Old())


@pytest.mark.check
def test_osmesa_draws_what_egl_draws() -> None:
    """In a process of its own: two OpenGL loaders in one process are asking for trouble."""
    needs.require("osmesa")
    script = (
        "import sys, numpy as np\n"
        "from glsplat.config import RenderConfig\n"
        "from glsplat.gl.context import create_context\n"
        "from glsplat.renderer import Renderer\n"
        "from tests.scenes import cloud, eyes\n"
        "context = create_context(backend=sys.argv[1])\n"
        "config = RenderConfig(output='float32', target='32f')\n"
        "with Renderer(cloud(), size=(64, 64), views=2, config=config, context=context) as renderer:\n"
        "    sys.stdout.buffer.write(renderer.render(eyes()).tobytes())\n"
        "context.release()\n"
    )
    egl, osmesa = (
        np.frombuffer(
            subprocess.run([sys.executable, "-c", script, b], check=True, capture_output=True).stdout, np.float32
        )
        for b in ("egl", "osmesa")
    )
    assert egl.any() and np.abs(egl - osmesa).max() <= 0.0022


def test_geometry_fallback_where_the_vertex_shader_cannot(context: Context) -> None:
    from dataclasses import replace

    lame = replace(context, vertex_layers=False)
    with context.ctx:
        with Renderer(cloud(), size=(64, 64), views=2, context=lame) as renderer:
            image = renderer.render(eyes())
            assert renderer.variant.geometry == 1 and image[0].any() and image[1].any()
        from glsplat.config import RenderConfig, with_fields

        with pytest.raises(ContextError, match="use layers='geometry'"):
            Renderer(cloud(), size=(8, 8), config=with_fields(RenderConfig(), layers="vertex"), context=lame)
        with pytest.raises(ContextError, match="use sorter='cpu'"):
            Renderer(cloud(), size=(8, 8), config=RenderConfig(sorter="gpu"), context=replace(context, compute=False))


def test_moderngl_is_new_enough() -> None:
    assert moderngl.__version__ >= "5.13"
