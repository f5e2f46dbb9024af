"""How a driver draws unasked, told from its name alone: triangles that are pulled, or instanced quads in two layers.

The driver of the test session answers to the name of another, so all that is decided by names is decided as there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from glsplat.config import LEAN, RenderConfig, with_fields
from glsplat.gl.context import Context, create_context
from glsplat.renderer import Renderer
from tests.scenes import camera, cloud, eyes, limb

pytestmark = pytest.mark.gl

SOFTWARE = {
    "llvmpipe": "llvmpipe (LLVM 15.0.6, 256 bits)",
    "softpipe": "softpipe",
    "swrast": "Mesa DRI swrast",
    "lavapipe": "zink (llvmpipe (LLVM 15.0.6, 256 bits))",
    "lavapipe, newer": "zink Vulkan 1.3(llvmpipe (LLVM 19.1.1, 256 bits) (MESA_LLVMPIPE))",
    "SwiftShader": "ANGLE (Google, Vulkan 1.3.0 (SwiftShader Device (Subzero) (0x0000C0DE)), SwiftShader driver)",
}
GPUS = {
    "NVIDIA, server": "NVIDIA H100 80GB HBM3/PCIe/SSE2",
    "NVIDIA": "NVIDIA GeForce RTX 4090/PCIe/SSE2",
    "AMD": "AMD Radeon RX 7900 XTX (radeonsi, navi31, LLVM 15.0.6, DRM 3.57, 6.8.0)",  # LLVM is no sign
    "AMD, RADV": "zink Vulkan 1.3(AMD Radeon Graphics (RADV RAPHAEL) (MESA_RADV))",  # nor is zink
    "Intel": "Mesa Intel(R) UHD Graphics 620 (KBL GT2)",
    "Apple": "Apple M2",
}

Named = Callable[[str], Context]


@pytest.fixture
def named(context: Context, monkeypatch: pytest.MonkeyPatch) -> Iterator[Named]:
    """The context of the session under another driver's name."""
    made: list[Context] = []

    def name(renderer: str) -> Context:
        monkeypatch.setitem(context.ctx.info, "GL_RENDERER", renderer)
        made.append(create_context(given=context.ctx))
        return made[-1]

    with context.ctx:
        yield name
        for each in made:
            each.release()


@pytest.mark.parametrize("driver", SOFTWARE)
def test_software_pulls_triangles(named: Named, driver: str) -> None:
    context = named(SOFTWARE[driver])
    assert context.software and context.driver.startswith(SOFTWARE[driver])
    for scene in (cloud(20), limb(20)):
        with Renderer(scene, size=(32, 32), views=2, context=context) as renderer:
            renderer.render(eyes(32))
            assert (renderer.variant.triangle, renderer.variant.pulled) == (1, int(context.vertex_storage))
            assert renderer.target_dtype == "f4"


@pytest.mark.parametrize("driver", GPUS)
def test_gpus_draw_instanced_quads_into_two_layers(named: Named, driver: str) -> None:
    context = named(GPUS[driver])
    assert not context.software
    for scene in (cloud(20), limb(20)):
        with Renderer(scene, size=(32, 32), views=2, context=context) as renderer:
            image = renderer.render(eyes(32))
            variant = renderer.variant
            assert (variant.views, variant.triangle, variant.pulled) == (2, 0, 0)
            assert variant.geometry == int(not context.vertex_layers)  # gl_Layer by the vertex shader where it can
            assert renderer.target_dtype == "f2"
            assert image[0].any() and image[1].any() and (image[0] != image[1]).any()


@pytest.mark.parametrize(("name", "dtype"), [(SOFTWARE["llvmpipe"], "f1"), (GPUS["NVIDIA"], "f2")])
def test_a_fast_target_has_8_bits_where_blending_rounds(named: Named, name: str, dtype: str) -> None:
    with Renderer(cloud(20), size=(32, 32), config=LEAN, context=named(name)) as renderer:
        assert renderer.target_dtype == dtype


@pytest.mark.parametrize("name", [SOFTWARE["llvmpipe"], GPUS["NVIDIA"]])
@pytest.mark.parametrize("fetch", ["auto", "attributes"])
def test_what_is_asked_for_goes_before_the_name(named: Named, name: str, fetch: str) -> None:
    """Shape and target as asked; what is not asked is pulled for triangles on software only."""
    context = named(name)
    pulls = fetch == "auto" and context.software and context.vertex_storage
    for shape in ("quad", "triangle"):
        config = with_fields(RenderConfig(), shape=shape, fetch=fetch, target="8")
        with Renderer(cloud(20), size=(32, 32), config=config, context=context) as renderer:
            renderer.render([camera(32)])
            triangle = shape == "triangle"
            assert (renderer.variant.triangle, renderer.variant.pulled) == (int(triangle), int(triangle and pulls))
            assert renderer.target_dtype == "f1"
