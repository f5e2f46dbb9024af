"""Records pulled from a storage buffer by the vertex's number, and as attributes of instances: the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig, with_fields
from glsplat.errors import BudgetError, ContextError
from glsplat.gl.context import Context
from glsplat.net.backends.gl import PictureBudget
from glsplat.renderer import Renderer, draw, gpu_scene, pipeline
from glsplat.scene import Item, Scene
from glsplat.shaders import Variant
from tests.api.variants import bent, coned, sheet
from tests.scenes import cloud, eyes, limb

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]
LIMB = limb(degree=1)


@pytest.fixture
def storage(context: Context) -> None:
    if not context.vertex_storage:
        pytest.skip("no storage buffers in the vertex shader")


def beside_a_mesh() -> Scene:
    return Scene([Item(cloud(300, 1)), Item(sheet())])


def shifted(viewmat: NDArray[np.float64], z: float) -> NDArray[np.float64]:
    return viewmat + np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, z], [0, 0, 0, 0]])


@pytest.mark.parametrize("views", [eyes(), eyes()[:1]], ids=["pair", "one view"])
@pytest.mark.parametrize(
    ("scene", "config"),
    [
        pytest.param(cloud(), {}, id="plain"),
        pytest.param(cloud(300, 3), {"antialias": True}, id="degree 3 compensated"),
        pytest.param(cloud(300, 2), {"shape": "quad", "target": "16f"}, id="quads"),
        pytest.param(cloud(300, 1), {"max_sigma": 2.0, "output": "uint8"}, id="cut"),
        pytest.param(cloud(300, 1), {"layers": "geometry"}, id="geometry shader"),
        pytest.param(cloud(300, 1), {"layers": "geometry", "shape": "quad"}, id="geometry shader, quads"),
        pytest.param(cloud(2000), {"sorter": "gpu"}, id="gpu sorter"),
        pytest.param(cloud(2000), {"sorter": "gpu", "shape": "quad"}, id="gpu sorter, quads"),
        pytest.param(coned(), {"cull_hidden": True, "output": "uint8"}, id="hidden"),
        pytest.param(LIMB, {}, id="posed"),
        pytest.param(beside_a_mesh(), {}, id="mesh"),
        pytest.param(cloud(3).take(np.arange(0)), {}, id="nothing"),
    ],
)
def test_the_same_bytes(
    renderer_of: Make, storage: None, scene: Any, config: dict[str, Any], views: tuple[Camera, ...]
) -> None:
    pose = bent() if scene is LIMB else None
    depth = not config.get("cull_hidden")
    pulling, instanced = (
        renderer_of(scene, views=2, **{"shape": "triangle", "fetch": fetch, **config})
        for fetch in ("storage", "attributes")
    )
    nearer = [replace(view, viewmat=shifted(view.viewmat, 0.1 * i)) for i, view in enumerate(views)]  # z of its own
    for moved in (views, nearer):
        image, expected = pulling.render(moved, pose), instanced.render(moved, pose)
        assert np.array_equal(image, expected)
        assert (pulling.stats.drawn, pulling.stats.culled) == (instanced.stats.drawn, instanced.stats.culled)
        if depth:
            for first, second in zip(
                pulling.render(moved, pose, depth=True), instanced.render(moved, pose, depth=True), strict=True
            ):
                assert np.array_equal(first, second)
    assert (pulling.variant.pulled, instanced.variant.pulled) == (1, 0)


def test_parts_and_slices(renderer_of: Make, storage: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A draw in parts, and a costly one in slices that are drawn in parts, blend every record once and in order."""
    scene, views = cloud(1000), eyes()
    expected = renderer_of(scene, views=2, fetch="attributes").render(views)
    monkeypatch.setattr(draw, "MIN_PART_RECORDS", 7)
    monkeypatch.setattr(draw, "MAX_PARTS", 1000)
    renderer = renderer_of(scene, views=2, fetch="storage")
    assert np.array_equal(renderer.render(views), expected)
    asked: list[int] = []

    def count() -> bool:
        asked.append(1)
        return False

    budget = PictureBudget(slice_cost=5000, abandoned=count)
    assert np.array_equal(budget.render(renderer.prepare(views)), expected) and len(asked) > 3
    with pytest.raises(BudgetError):
        PictureBudget(slice_cost=5000, abandoned=lambda: True).render(renderer.prepare(views))
    assert np.array_equal(renderer.render(views), expected)  # what was broken off leaves nothing behind


def test_who_pulls(renderer_of: Make, context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Software rasterizers that can, for triangles, unless the records do not fit or are very many."""
    automatic = renderer_of(cloud(20))
    automatic.render(eyes()[:1])
    assert automatic.variant.pulled == int(context.software and context.vertex_storage)
    with monkeypatch.context() as patched:
        patched.setattr(gpu_scene, "MAX_PULLED", 19)
        many = renderer_of(cloud(20))
        many.render(eyes()[:1])
        assert many.variant.pulled == 0
    quads = renderer_of(cloud(20), shape="quad")
    quads.render(eyes()[:1])
    assert quads.variant.pulled == 0


def test_what_does_not_fit_is_not_pulled(
    renderer_of: Make, context: Context, storage: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = context.ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]
    variant = Variant(views=2, triangle=1, pulled=1)
    assert draw.fits(context.ctx, variant, limit // 56) and not draw.fits(context.ctx, variant, limit // 56 + 1)
    scene, views = cloud(100), eyes()
    expected = renderer_of(scene, views=2, fetch="storage").render(views)
    monkeypatch.setattr(pipeline, "fits", lambda ctx, variant, count: False)
    renderer = renderer_of(scene, views=2, fetch="storage")
    assert np.array_equal(renderer.render(views), expected) and renderer.variant.pulled == 0


def test_where_there_is_no_storage(context: Context) -> None:
    lacking = replace(context, vertex_storage=False)
    with pytest.raises(ContextError, match="fetch='attributes'"):
        Renderer(cloud(5), size=(8, 8), config=with_fields(RenderConfig(), fetch="storage"), context=lacking)
    with Renderer(cloud(5), size=(64, 64), context=lacking) as renderer:
        renderer.render(eyes()[:1])
        assert renderer.variant.pulled == 0
