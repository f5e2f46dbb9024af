"""light.glsl over arrays, against its twins reference.shading and reference.lit, degenerate shapes included."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat import reference
from glsplat.gl.context import Context
from glsplat.light import Light, Surface
from glsplat.passes.item.buffers import ROW
from glsplat.rotations import signed_axes
from glsplat.splats import Splats
from tests.glsl import run_chunk

pytestmark = pytest.mark.gl

TEXT = """
#include "arena.glsl"
#include "light.glsl"
in uint at; in vec3 c0; in vec3 c1; in vec3 c2; in vec3 colour; out vec3 factor; out vec3 shown;
void main() { factor = shading(int(at), mat3(c0, c1, c2)); shown = lit(colour, factor); gl_Position = vec4(0); }"""


def surfaces_of(splats: Splats) -> np.ndarray:
    """The texture of one row of the arena."""
    rows = np.zeros((ROW, 2, 4))
    n = len(splats)
    rows[:n, 0, :3] = splats.surface.in_axes(signed_axes(splats.quats, splats.scales))
    rows[:n, 0, 3], rows[:n, 1, :3] = splats.surface.ao, 1 / splats.surface.shades
    return rows.reshape(1, 2 * ROW, 4).astype(np.float32)


@pytest.mark.parametrize("sun", [None, (0.3, 0.8, -0.5)])
def test_light_on_surfaces(context: Context, rng: np.random.Generator, sun: tuple[float, ...] | None) -> None:
    n = 1000
    quats = rng.normal(size=(n, 4))
    scales = np.exp(rng.uniform(-9, 1, (n, 3)))
    scales[:60, 2] = 0  # flat: the third axis follows from two
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[100:130] = 0  # of no surface
    surface = Surface.of(normals, rng.uniform(0, 1, n), rng.uniform(0.05, 3, (n, 3)))
    splats = Splats(np.zeros((n, 3)), quats, scales, np.ones(n), np.zeros((n, 1, 3)), surface=surface)
    turn = reference.quaternion_matrices(rng.normal(size=(1, 4)) / 2)[0]
    turn, _ = np.linalg.qr(turn)
    shapes = turn @ (reference.quaternion_matrices(splats.quats.astype(float)) * splats.scales[:, None, :])
    posed = reference.Posed(means=np.zeros((n, 3)), shapes=shapes, rotations=np.broadcast_to(turn, (n, 3, 3)))
    direction = None if sun is None else np.array(sun) / np.linalg.norm(sun)
    light = Light(rng.normal(0, 0.3, (9, 3)) + np.eye(9)[:, :1] * 3, direction, (2.0, 1.5, 1.0) if sun else (0, 0, 0))
    colours = rng.uniform(0, 1, (n, 3))
    columns = {f"c{k}": shapes[:, :, k] for k in range(3)}
    with context.ctx:
        out = run_chunk(
            context,
            TEXT,
            {"at": np.arange(n, dtype=np.uint32), **columns, "colour": colours},
            {"factor": 3, "shown": 3},
            textures={"surfaces": surfaces_of(splats)},
            uniforms={"light": [tuple(map(float, row)) for row in light.uniforms()]},
        )
    factors = reference.shading(posed, splats, light)
    assert (factors[100:130] == -1).all() and (factors[200:] >= 0).all()
    np.testing.assert_allclose(out["factor"], factors, atol=2e-4 * np.abs(factors).max(), rtol=2e-4)
    np.testing.assert_allclose(out["shown"], reference.lit(colours, factors), atol=3e-4)
