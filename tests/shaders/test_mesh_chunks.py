"""The chunks of textured meshes over arrays, against plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.pictures import to_linear, to_srgb
from glsplat.renderer.frame_block import FrameBlock, frame_dtype
from glsplat.rotations import rotation_matrices
from glsplat.shaders import MeshVariant, Variant
from tests.glsl import run_chunk

pytestmark = pytest.mark.gl


@pytest.mark.parametrize("lowest", [0.0, 0.125, 0.5])
def test_cutout(gl: Context, rng: np.random.Generator, lowest: float) -> None:
    texels, change = rng.random((2000, 4)), 10 ** rng.uniform(-5, 0, 2000)
    texels[:, :3] *= texels[:, 3:]
    text = """
    #include "cutout.glsl"
    in vec4 texel; in float change; uniform float lowest; out vec4 seen;
    void main() { seen = cut_out(texel, change, lowest); gl_Position = vec4(0); }"""
    out = run_chunk(gl, text, {"texel": texels, "change": change}, {"seen": 4}, uniforms={"lowest": lowest})["seen"]
    if lowest == 0.0:
        np.testing.assert_array_equal(out, np.column_stack([texels[:, :3], np.ones(2000)]).astype(np.float32))
        return
    alpha = np.clip((texels[:, 3] - 0.5) / np.maximum(change, 1e-3) + 0.5, 0, 1)
    kept = alpha >= lowest
    assert 500 < kept.sum() < 1500
    expected = np.column_stack([texels[:, :3] / texels[:, 3:], np.ones(2000) if lowest == 0.5 else alpha])
    np.testing.assert_allclose(out[kept], expected[kept], rtol=1e-4, atol=1e-4)
    assert not out[~kept].any()


def test_footprints_are_bounded(gl: Context) -> None:
    """Beyond the whole texture there is one place."""
    slopes = np.array([0.0, 0.3, 1.0, 1.01, 50.0, 1e30, np.inf])
    across = np.concatenate([np.stack([slopes, np.zeros(7)], 1), np.zeros((7, 2))])
    down = np.concatenate([np.zeros((7, 2)), np.stack([np.zeros(7), slopes], 1)])
    uv = np.tile([3.25, -0.75], (14, 1))
    text = """
    #include "cutout.glsl"
    in vec2 uv; in vec2 across; in vec2 down; out vec2 place;
    void main() { place = bounded(uv, across, down); gl_Position = vec4(0); }"""
    found = run_chunk(gl, text, {"uv": uv, "across": across, "down": down}, {"place": 2})["place"]
    small = np.tile(slopes <= 1, 2)
    np.testing.assert_array_equal(found, np.where(small[:, None], uv, 0.5))


def test_srgb(gl: Context) -> None:
    values = np.linspace(0, 1, 1000)[:, None] * np.ones(3)
    text = """
    #include "srgb.glsl"
    in vec3 given; out vec3 light; out vec3 back;
    void main() { light = linear_of(given); back = srgb_of(given * 1.2 - 0.1); gl_Position = vec4(0); }"""
    out = run_chunk(gl, text, {"given": values}, {"light": 3, "back": 3})
    np.testing.assert_allclose(out["light"], to_linear(values), atol=2e-6)
    np.testing.assert_allclose(out["back"], to_srgb(np.clip(values * 1.2 - 0.1, 0, 1)), atol=2e-6)


def test_surface(gl: Context, rng: np.random.Generator) -> None:
    """One joint a vertex: where the pinhole camera of the contract puts it, and depth from -1 at near to 1 at far."""
    bones = np.concatenate([rotation_matrices(rng.normal(size=(5, 3))), rng.normal(size=(5, 3, 1))], axis=-1)
    points, joints = rng.normal(size=(800, 3)), rng.integers(0, 5, 800)
    camera = Camera(look_at((0.3, 0.2, 9), (0, 0, 0)), [[150, 0, 41.3], [0, 118, 57.8], [0, 0, 1]], 96, 80)
    camera = replace(camera, near=2.0, far=30.0)
    block = FrameBlock(gl.ctx, 1)
    block.write([camera], camera.viewmat, np.zeros(3), RenderConfig())
    frame = np.frombuffer(block.buffer.read(), frame_dtype(1))[0]
    block.release()
    text = """
    #include "surface.glsl"
    out vec3 point; out vec4 place;
    void main() { point = camera_point(); place = clip_place(point); gl_Position = place; }"""
    weights = np.zeros((800, 4))
    weights[:, 0] = 1
    inputs = {"vertex": points, "weights0": weights}
    inputs["joints0"] = np.repeat(joints[:, None], 4, axis=1).astype(np.uint32)
    given = {"bones": bones.reshape(5, 3, 4).astype(np.float32)}
    out = run_chunk(gl, text, inputs, {"point": 3, "place": 4}, MeshVariant(), frame=frame, textures=given)
    world = np.einsum("nij,nj->ni", bones[joints][:, :, :3], points) + bones[joints][:, :, 3]
    seen = world @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    np.testing.assert_allclose(out["point"], seen, atol=2e-5)
    pixels = seen[:, :2] / seen[:, 2:] * (150, 118) + (41.3, 57.8)
    w = out["place"][:, 3:]
    np.testing.assert_allclose((out["place"][:, :2] / w + 1) / 2 * (96, 80), pixels, atol=2e-3)
    depth = (seen[:, 2] * 32 - 2 * 30 * 2) / 28 / seen[:, 2]
    np.testing.assert_allclose(out["place"][:, 2] / w[:, 0], depth, atol=1e-5)


@pytest.mark.parametrize("views", [1, 2])
def test_ground(gl: Context, rng: np.random.Generator, views: int) -> None:
    """Each view has its own textures."""
    names = [name + ending for ending in ("", "_2")[:views] for name in ("mesh_z", "mesh_colour", "mesh_samples")]
    textures = {name: rng.random((6, 7, 4)).astype(np.float32) for name in names}
    place = np.stack([rng.integers(0, 7, 100), rng.integers(0, 6, 100), rng.integers(0, views, 100)], axis=1)
    text = """
    #include "mesh_layer.glsl"
    in uvec3 place; out float z; out vec4 colour; out vec4 samples;
    void main() {
        ivec2 pixel = ivec2(place.xy);
        z = mesh_z_at(pixel, int(place.z));
        colour = mesh_colour_at(pixel, int(place.z));
        samples = mesh_samples_at(pixel, int(place.z));
        gl_Position = vec4(0);
    }"""
    wanted = {"z": 1, "colour": 4, "samples": 4}
    out = run_chunk(
        gl, text, {"place": place.astype(np.uint32)}, wanted, Variant(views=views, sampled=4), textures=textures
    )
    for name, values in out.items():
        x, y, view = place.T
        stacks = np.stack([textures[f"mesh_{name}{ending}"] for ending in ("", "_2")[:views]])
        expected = stacks[view, y, x][:, : values.shape[1]]
        if name == "samples":
            expected[:, 3] = np.round(expected[:, 3] * 4) / 4
        np.testing.assert_array_equal(values, expected, name)
