"""Each GLSL chunk over arrays, against its twin in reference.py, degenerate inputs included."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat import reference
from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.renderer.frame_block import FrameBlock, frame_dtype
from glsplat.renderer.stage import ROW
from glsplat.rotations import rotation_matrices
from glsplat.shaders import Variant
from glsplat.shaders.variant import COLOUR_TEXELS
from glsplat.splats import Splats
from tests.glsl import run_chunk
from tests.skinning.avatars import turn

pytestmark = pytest.mark.gl


def unit(values: np.ndarray) -> np.ndarray:
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def close(actual: np.ndarray, expected: np.ndarray, rtol: float = 1e-5) -> None:
    """Relative to the largest entry of each row: what matters of a matrix or a colour."""
    scale = np.abs(expected).reshape(len(expected), -1).max(axis=1) + 1e-30
    error = np.abs(actual - expected).reshape(len(expected), -1).max(axis=1)
    assert (error / scale).max() <= rtol, (error / scale).max()


def test_covariance(gl: Context, rng: np.random.Generator) -> None:
    quats = unit(rng.normal(size=(4000, 4)))
    quats[:4] = np.eye(4)
    scales = np.exp(rng.uniform(-14, 6, (4000, 3)))  # needles to 1e8:1
    scales[10:20, 0] = 0
    text = """
    #include "covariance.glsl"
    in vec4 q; in vec3 s; out vec3 c0, c1, c2;
    void main() { mat3 m = shape_matrix(q, s); c0 = m[0]; c1 = m[1]; c2 = m[2]; gl_Position = vec4(0); }"""
    out = run_chunk(gl, text, {"q": quats, "s": scales}, {"c0": 3, "c1": 3, "c2": 3})
    expected = reference.quaternion_matrices(quats) * scales[:, None, :]
    close(np.stack([out["c0"], out["c1"], out["c2"]], -1), expected)


@pytest.mark.parametrize(("degree", "stored"), [(0, 0), (1, 1), (2, 2), (3, 3), (0, 3), (1, 2)])
def test_sh(gl: Context, rng: np.random.Generator, degree: int, stored: int) -> None:
    """More than one row of the texture, of which a camera may ask for a lower degree than is stored."""
    sh = rng.normal(size=(2000, (stored + 1) ** 2, 3)).astype(np.float32)
    directions = unit(rng.normal(size=(2000, 3)))
    directions[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    texels, components = COLOUR_TEXELS[stored], 4 if stored else 3
    rows = np.zeros((2 * ROW, texels * components), np.float32)
    rows[:2000, : sh[0].size] = sh.reshape(2000, -1)
    text = """
    #include "sh.glsl"
    in uint index; in vec3 d; out vec3 colour;
    void main() { colour = evaluate_sh(int(index), d); gl_Position = vec4(0); }"""
    inputs = {"index": np.arange(2000, dtype=np.uint32)} | ({"d": directions} if degree else {})
    variant = Variant(sh_degree=degree, stored_degree=stored)
    colours = {"colours": rows.reshape(2, ROW * texels, components)}
    out = run_chunk(gl, text, inputs, {"colour": 3}, variant, textures=colours)
    expected = reference.evaluate_sh(sh.astype(np.float64), directions, degree)
    assert (expected == 0).any() and np.abs(out["colour"] - expected).max() < 2e-6


def frame_of(camera: Camera, config: RenderConfig, gl: Context) -> np.ndarray:
    block = FrameBlock(gl.ctx, 1)
    block.write([camera], camera.viewmat, np.zeros(3), config)
    record = np.frombuffer(block.buffer.read(), frame_dtype(1))[0].copy()
    block.release()
    return record


PROJECT = """
#include "frame.glsl"
#include "extent.glsl"
#include "covariance.glsl"
#include "project.glsl"
in vec3 mean; in vec4 q; in vec3 s; in float opacity;
out vec2 centre; out vec3 chol; out float alpha; out float reason;
void main() {
    Footprint foot;
    reason = float(project(mean, shape_matrix(q, s), opacity, 0, foot));
    centre = foot.centre; chol = foot.cholesky; alpha = foot.alpha;
    gl_Position = vec4(0);
}"""


@pytest.mark.parametrize("antialias", [False, True])
def test_project(gl: Context, rng: np.random.Generator, antialias: bool) -> None:
    count = 6000
    splats = Splats.create(
        rng.normal(0, 2, (count, 3)),
        rng.normal(size=(count, 4)),
        np.exp(rng.uniform(-12, 0.5, (count, 3))),
        rng.uniform(0, 1, count) ** 2,
        rgb=rng.random((count, 3)),
    )
    K = np.array([[170.0, 0, 55], [0, 140, 81], [0, 0, 1]])  # off-centre, fx != fy
    camera = Camera(look_at((0.3, 1, 3), (0, 0, 0)), K, 128, 160)
    config = RenderConfig(antialias=antialias)
    out = run_chunk(
        gl,
        PROJECT,
        {"mean": splats.means, "q": splats.quats, "s": splats.scales, "opacity": splats.opacities},
        {"centre": 2, "chol": 3, "alpha": 1, "reason": 1},
        Variant(antialias=int(antialias)),
        frame_of(camera, config, gl),
    )
    expected = reference.project(reference.rest(splats), splats, camera, config)
    drawn = out["reason"][:, 0] == 0
    assert 500 < expected.visible.sum() < count and (drawn != expected.visible).sum() <= 2
    both = drawn & expected.visible
    near = expected.depths[both] < 0.3  # there pixels are huge and so is an ulp of them
    assert np.abs(out["centre"][both] - expected.means2d[both])[~near].max() < 2e-3
    l00, l10, l11 = out["chol"][both].astype(np.float64).T
    close(np.stack([l00 * l00, l00 * l10, l10 * l10 + l11 * l11], -1), expected.covars2d[both], 2e-4)
    det = expected.covars2d[both][:, 0] * expected.covars2d[both][:, 2] - expected.covars2d[both][:, 1] ** 2
    well = det > 1e-6 * (expected.covars2d[both][:, 0] * expected.covars2d[both][:, 2])
    close(((l00 * l11) ** 2)[well, None], det[well, None], 1e-3)
    assert np.abs(out["alpha"][both, 0] - expected.alphas[both]).max() < 1e-4


def test_project_needles_keep_their_area(gl: Context) -> None:
    """A plane seen edge-on, 1e6:1: det by a c - b^2 would be negative in float32; here it is right to 1e-3."""
    angles = np.linspace(0, np.pi, 200)
    quats = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], -1)
    splats = Splats.create(
        np.zeros((200, 3)), quats, np.tile([10.0, 1e-5, 1e-5], (200, 1)), np.ones(200), rgb=np.ones((200, 3))
    )
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]]), 1000, 1000)
    inputs = {"mean": splats.means, "q": splats.quats, "s": splats.scales, "opacity": splats.opacities}
    outputs = {"centre": 2, "chol": 3, "alpha": 1, "reason": 1}
    out = run_chunk(gl, PROJECT, inputs, outputs, Variant(), frame_of(camera, RenderConfig(), gl))
    posed = reference.rest(splats)
    a, b, c = reference.project(posed, splats, camera).covars2d.T
    minor = (a * c - b * b) / (a + c)  # the smaller eigenvalue of a needle, float64
    ours = (out["chol"][:, 0].astype(np.float64) * out["chol"][:, 2]) ** 2 / (a + c)
    assert (out["reason"] == 0).all()
    assert np.abs(ours / minor - 1).max() < 1e-3


ROTATION = """
#include "covariance.glsl"
#include "rotation.glsl"
in vec3 a0, a1, a2, s0, s1, s2; in float shift; out vec4 q;
void main() { q = blended_quaternion(mat3(a0, a1, a2), mat3(s0, s1, s2), shift); gl_Position = vec4(0); }"""


def blended(gl: Context, matrices: np.ndarray, strongest: np.ndarray, shift: float = 1.0) -> np.ndarray:
    inputs = {f"{name}{i}": m[:, :, i] for name, m in (("a", matrices), ("s", strongest)) for i in range(3)}
    inputs["shift"] = np.full(len(matrices), shift)
    return run_chunk(gl, ROTATION, inputs, {"q": 4})["q"].astype(np.float64)


def test_blended_rotation_is_the_reference(gl: Context, rng: np.random.Generator) -> None:
    bones = rotation_matrices(rng.normal(0, 1.2, (20000, 4, 3)))
    weights = -np.sort(-rng.dirichlet([1.0] * 4, 20000), axis=1)
    matrices = np.einsum("nk,nkij->nij", weights, bones)
    quats = blended(gl, matrices, bones[:, 0])
    assert np.abs(np.linalg.norm(quats, axis=1) - 1).max() < 1e-6
    ours, expected = reference.quaternion_matrices(quats), reference.blended_rotations(matrices, bones[:, 0])
    angles = turn(ours, expected)
    assert np.percentile(angles, 99.9) < 0.02 and angles.max() < 0.5
    singular = np.linalg.svd(matrices)[1]
    clear = singular[:, 1] + np.linalg.det(matrices) / (singular[:, 0] * singular[:, 1]) > 0.5
    u, _, vt = np.linalg.svd(matrices[clear])
    assert clear.mean() > 0.5 and turn(ours[clear], u @ vt).max() < 0.05  # the polar rotation, where it is well defined


@pytest.mark.parametrize(
    "weights", [(0.5, 0.5, 0.0), (0.4, 0.3, 0.3), (0.6, 0.4, 0.0), (0.51, 0.49, 0.0)], ids=["half", "three", "60", "51"]
)
def test_blended_rotation_is_continuous_through_a_collapse(gl: Context, weights: tuple[float, ...]) -> None:
    """A candy wrapper: one bone turns a full circle. Steps of the result stay within 40 steps of the sweep."""
    steps = 20001
    angle = np.linspace(0, 2 * np.pi, steps)
    bones = np.tile(np.eye(3), (steps, 3, 1, 1))
    bones[:, 1] = bones[:, 2] = rotation_matrices(angle[:, None] * unit(np.array([1.0, 0.2, 0.1])))
    matrices = np.einsum("k,nkij->nij", np.array(weights), bones)
    result = reference.quaternion_matrices(blended(gl, matrices, bones[:, 0]))
    assert np.isfinite(result).all()
    assert turn(result[1:], result[:-1]).max() < 40 * 360 / (steps - 1)


def test_blended_rotation_of_hopeless_matrices(gl: Context) -> None:
    reflection = np.diag([1.0, 1.0, -1.0])
    matrices = np.stack([np.zeros((3, 3)), reflection, -np.eye(3), np.eye(3) * 1e6, np.eye(3) * 1e-6, np.ones((3, 3))])
    strongest = np.stack([np.eye(3)] * len(matrices))
    for shift in (1.0, 3.0):
        quats = blended(gl, matrices, strongest, shift)
        assert np.isfinite(quats).all() and np.abs(np.linalg.norm(quats, axis=1) - 1).max() < 1e-5
        assert np.allclose(np.linalg.det(reference.quaternion_matrices(quats)), 1, atol=1e-5)


def test_extent(gl: Context) -> None:
    alphas = np.concatenate([[1 / 255, 0.004, 0.5, 0.99, 1.0], np.geomspace(1 / 254, 1, 500)])
    text = """
    #include "frame.glsl"
    #include "extent.glsl"
    in float a; out float e;
    void main() { e = extent_of(a); gl_Position = vec4(0); }"""
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), np.array([[64.0, 0, 32], [0, 64, 32], [0, 0, 1]]), 64, 64)
    out = run_chunk(gl, text, {"a": alphas}, {"e": 1}, Variant(), frame_of(camera, RenderConfig(), gl))["e"][:, 0]
    expected = np.minimum(3.33, np.sqrt(2 * np.log(np.maximum(alphas.astype(np.float32) * np.float64(255), 1))))
    assert np.abs(out - expected)[2:].max() < 1e-4
    assert np.abs(out - expected).max() < 2e-3  # log near 1 is steep under a root
    edge = alphas[1:] * np.exp(-(out[1:].astype(np.float64) ** 2) / 2)
    assert np.abs(edge * 255 - 1).max() < 0.01  # the quad ends where alpha is 1/255


def test_project_of_hopeless_splats(gl: Context) -> None:
    """Every input gives a reason or a finite footprint: nothing explodes and nothing turns NaN."""
    nan, inf = np.nan, np.inf
    ok = ((0.0, 0, 0), (1.0, 0, 0, 0), (0.1, 0.1, 0.1), 0.5)
    rows = [ok]
    rows += [((v, 0, 0), *ok[1:]) for v in (nan, inf, -inf, 3e38, 1e30)]
    rows += [((0, 0, v), *ok[1:]) for v in (nan, inf, 3.0, 2.99, 2.989999, 1e30, -1e30)]
    rows += [(ok[0], q, *ok[2:]) for q in ((0, 0, 0, 0), (nan, 0, 0, 0), (inf, 0, 0, 0), (1e20, 0, 0, 0))]
    rows += [(*ok[:2], (v, 0.1, 0.1), 0.5) for v in (0, -0.1, nan, inf, 1e19, 1e30, 1e-38)]
    rows += [(*ok[:3], v) for v in (0, -1, 1 / 256, 1 / 255, 1, 2, nan, inf)]
    means, quats, scales, opacities = (np.array([row[i] for row in rows], np.float32) for i in range(4))
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), np.array([[64.0, 0, 32], [0, 64, 32], [0, 0, 1]]), 64, 64)
    inputs = {"mean": means, "q": quats, "s": scales, "opacity": opacities}
    outputs = {"centre": 2, "chol": 3, "alpha": 1, "reason": 1}
    for antialias in (0, 1):
        frame = frame_of(camera, RenderConfig(), gl)
        out = run_chunk(gl, PROJECT, inputs, outputs, Variant(antialias=antialias), frame)
        reason = out["reason"][:, 0]
        drawn = reason == 0
        assert drawn[0] and 5 < drawn.sum() < len(rows) - 10 and set(reason) <= {0, 1, 2, 3, 4}
        for name in ("centre", "chol", "alpha"):
            assert np.isfinite(out[name][drawn]).all(), name
        assert (out["chol"][drawn][:, [0, 2]] > 0).all() and (out["alpha"][drawn] <= 1).all()
        not_finite = ~(np.isfinite(means).all(1) & np.isfinite(quats).all(1) & np.isfinite(scales).all(1))
        assert not drawn[not_finite].any()
