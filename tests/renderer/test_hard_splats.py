"""Stiff and extreme splats: exact, or gone and counted; never NaN, never silently vanished."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glsplat import reference
from glsplat.renderer import Renderer
from glsplat.splats import SH_C0
from tests.compare import assert_contract
from tests.scenes import camera, one_splat

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]

HARD = {
    "needle 1e6:1": {"scales": [[1.0, 1e-6, 1e-6]], "quats": [[0.9, 0.1, 0.3, 0.2]]},
    "sub-pixel": {"scales": [[1e-9, 1e-9, 1e-9]]},
    "zero scale": {"scales": [[0.1, 0.0, 0.1]]},
    "all scales zero": {"scales": [[0.0, 0.0, 0.0]]},
    "negative scale": {"scales": [[-0.1, 0.1, 0.1]]},
    "fills the screen": {"scales": [[50.0, 50.0, 50.0]]},
    "huge": {"scales": [[1e6, 1e6, 1e6]]},
    "opacity 1": {"opacities": [1.0]},
    "opacity 2": {"opacities": [2.0]},
    "bright": {"rgb": None, "sh": (np.array([[[30.0, 0.0, -5.0]]]) - 0.5) / SH_C0},
    "on the near plane": {"means": [[0.0, 0.0, 2.99]]},
    "just in front": {"means": [[0.001, 0.0, 2.985]], "scales": [[0.01, 0.01, 0.01]]},
    "far off axis": {"means": [[40.0, 0.0, 2.0]], "scales": [[20.0, 0.1, 0.1]]},
}


@pytest.mark.parametrize("name", HARD)
def test_hard_splats_match_the_reference(renderer_of: Make, name: str) -> None:
    scene = one_splat(**HARD[name])
    image = renderer_of(scene).render([camera()])
    assert np.isfinite(image).all()
    assert_contract(image, reference.render(scene, [camera()]))


GONE = {
    "opacity 0": ({"opacities": [0.0]}, "transparent"),
    "opacity below 1/255": ({"opacities": [0.0039]}, "transparent"),
    "negative opacity": ({"opacities": [-1.0]}, "transparent"),
    "behind": ({"means": [[0.0, 0.0, 4.0]]}, "out of range"),
    "outside": ({"means": [[9.0, 0.0, 0.0]]}, "outside"),
    "covariance overflows": ({"scales": [[1e30, 1e30, 1e30]]}, "degenerate"),
    "nan mean": ({"means": [[np.nan, 0.0, 0.0]]}, "skipped"),
    "inf scale": ({"scales": [[np.inf, 1.0, 1.0]]}, "skipped"),
    "nan colour": ({"rgb": [[np.nan, 0.0, 0.0]]}, "skipped"),
    "inf opacity": ({"opacities": [np.inf]}, "skipped"),
    "zero quaternion": ({"quats": [[0.0, 0.0, 0.0, 0.0]]}, "skipped"),
}


@pytest.mark.parametrize("name", GONE)
def test_what_cannot_be_drawn_is_counted(renderer_of: Make, name: str) -> None:
    changes, reason = GONE[name]
    renderer = renderer_of(one_splat(**changes))
    image = renderer.render([camera()])
    assert not image.any()
    counts = {"skipped": renderer.stats.skipped, **renderer.stats.culled}
    assert counts.pop(reason) == 1 and not any(counts.values()) and renderer.stats.drawn == 0


@pytest.mark.parametrize("scales", [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.0, 0.1]])
def test_without_a_low_pass_a_line_is_degenerate(renderer_of: Make, scales: list[float]) -> None:
    """One of these has no width on the screen, whatever it is seen from."""
    renderer = renderer_of(one_splat(scales=[scales]), eps2d=0.0)
    assert not renderer.render([camera()]).any()
    assert renderer.stats.culled["degenerate"] == 1
