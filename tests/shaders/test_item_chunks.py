"""The chunks of items (skin, place, cone, lift, light) over arrays, against their float64 twins."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

from glsplat import reference
from glsplat.camera import look_at, stereo_cameras
from glsplat.config import RenderConfig, with_fields
from glsplat.extras.authoring.finish.cones import hidden
from glsplat.extras.watermark.mark import Watermark, marked
from glsplat.extras.watermark.pattern import TILE
from glsplat.gl.context import Context
from glsplat.light import Light, Surface
from glsplat.renderer.frame_block import FrameBlock, frame_dtype
from glsplat.renderer.stage import ROW
from glsplat.rotations import rodrigues_parameters, rotation_matrices, signed_axes
from glsplat.scene import similarity
from glsplat.shaders import SkinVariant, Variant
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from tests.glsl import run_chunk
from tests.skinning.faces import random_shapes

pytestmark = pytest.mark.gl


COUNT, JOINTS = 3000, 40
POSED = {"posed_mean": 4, "posed_x": 4, "posed_y": 4, "posed_z": 4}


def chunk_text(name: str) -> str:
    return (resources.files("glsplat.shaders") / name).read_text(encoding="utf-8")


def random_bones(rng: np.random.Generator) -> np.ndarray:
    """[J, 3, 4] rigid, anywhere within a few metres."""
    return np.concatenate(
        [rotation_matrices(rng.normal(0, 1.5, (JOINTS, 3))), rng.normal(0, 2, (JOINTS, 3, 1))], axis=-1
    )


def random_splats(rng: np.random.Generator) -> Splats:
    scales = np.exp(rng.uniform(-12, 1, (COUNT, 3)))
    scales[:20, 1] = 0  # flat ones
    scales[20:40] *= -1
    opacities = rng.uniform(0, 1, COUNT)
    return Splats.create(
        rng.normal(0, 2, (COUNT, 3)), rng.normal(size=(COUNT, 4)), scales, opacities, rgb=rng.random((COUNT, 3))
    )


def random_skin(rng: np.random.Generator, influences: int) -> Skin:
    ids = np.argsort(rng.random((COUNT, JOINTS)), axis=1)[:, :influences]
    weights = rng.dirichlet([0.7] * influences, COUNT)
    weights[:50] = np.eye(influences)[0]  # one joint alone
    return Skin.create(ids, weights, JOINTS, influences)


def skin_inputs(skin: Skin) -> dict[str, np.ndarray]:
    joints, weights = skin.joints.astype(np.uint32), skin.weights
    if skin.influences == 1:
        return {"joints0": joints[:, 0], "weights0": weights[:, 0]}
    inputs = {"joints0": joints[:, :4], "weights0": weights[:, :4]}
    return inputs | ({"joints1": joints[:, 4:], "weights1": weights[:, 4:]} if skin.influences == 8 else {})


def bone_texture(bones: np.ndarray) -> dict[str, np.ndarray]:
    return {"bones": bones.astype(np.float32)}  # row j of the texture is bone j, its texels the rows of the matrix


@pytest.mark.parametrize("influences", [1, 2, 4, 8])
def test_blended_and_anchor_bones(gl: Context, rng: np.random.Generator, influences: int) -> None:
    bones, skin = random_bones(rng), random_skin(rng, influences)
    text = """
    #include "skin.glsl"
    out vec4 bx, by, bz, ax, ay, az;
    void main() {
        Affine b = blended_bones(), a = anchor_bone();
        bx = b.x; by = b.y; bz = b.z; ax = a.x; ay = a.y; az = a.z;
        gl_Position = vec4(0);
    }"""
    outputs = dict.fromkeys(("bx", "by", "bz", "ax", "ay", "az"), 4)
    out = run_chunk(
        gl, text, skin_inputs(skin), outputs, SkinVariant(influences=influences), textures=bone_texture(bones)
    )
    blended = np.einsum("nk,nkij->nij", skin.weights.astype(np.float64), bones[skin.joints])
    assert np.abs(np.stack([out["bx"], out["by"], out["bz"]], 1) - blended).max() < 5e-6
    anchor = bones[skin.joints[:, 0]].astype(np.float32)
    np.testing.assert_array_equal(np.stack([out["ax"], out["ay"], out["az"]], 1), anchor)


def posed_of(out: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means [N, 3], shapes [N, 3, 3] and Rodrigues parameters [N, 3] of what an item's pass wrote."""
    columns = [out[name] for name in ("posed_x", "posed_y", "posed_z")]
    shapes = np.stack([c[:, :3] for c in columns], axis=-1)
    return out["posed_mean"][:, :3], shapes, np.stack([c[:, 3] for c in columns], axis=-1)


def rotations_of(rodrigues: np.ndarray) -> np.ndarray:
    s = (rodrigues.astype(np.float64) ** 2).sum(axis=1, keepdims=True)
    return reference.quaternion_matrices(np.concatenate([1 - s, 2 * rodrigues], axis=1) / (1 + s))


def apart(shapes: np.ndarray, expected: np.ndarray, splats: Splats) -> float:
    """Largest difference relative to the splat's longest axis."""
    longest = np.abs(splats.scales).max(axis=1)
    return float((np.abs(shapes - expected).max(axis=(1, 2)) / longest).max())


@pytest.mark.parametrize("influences", [1, 4, 8])
@pytest.mark.parametrize("raw", [0, 1])
def test_the_skin_pass_is_the_reference(gl: Context, rng: np.random.Generator, influences: int, raw: int) -> None:
    splats, bones, skin = random_splats(rng), random_bones(rng), random_skin(rng, influences)
    inputs = skin_inputs(skin) | {
        "mean_opacity": np.concatenate([splats.means, splats.opacities[:, None]], axis=1),
        "quat": splats.quats,
        "scale": splats.scales,
    }
    out = run_chunk(
        gl, chunk_text("skin.vert.glsl"), inputs, POSED, SkinVariant(influences=influences, raw=raw, turned=1),
        textures=bone_texture(bones), uniforms={"shift": 1.0, "size": 1.5, "signed_opacity": -1.0},
    )  # fmt: skip
    means, shapes, rodrigues = posed_of(out)
    posed = reference.skin(splats, skin, bones, "raw" if raw else "polar")
    assert np.abs(means - 1.5 * posed.means).max() < 4e-5  # metres, of up to 15
    np.testing.assert_array_equal(out["posed_mean"][:, 3], -splats.opacities)
    # four random rotations may cancel nearly: there the nearest rotation is steep, and held to what it is continuous in
    blended = np.einsum("nk,nkij->nij", skin.weights.astype(np.float64), bones[skin.joints][..., :3])
    singular = np.linalg.svd(blended)[1]
    clear = singular[:, 1] + np.sign(np.linalg.det(blended)) * singular[:, 2] > 0.3
    assert clear.mean() > 0.6
    assert apart(shapes, 1.5 * posed.shapes, splats) < (3e-5 if raw else 0.02)
    assert apart(shapes[clear], 1.5 * posed.shapes[clear], splats.take(clear)) < 3e-4
    assert np.abs(rotations_of(rodrigues)[clear] - posed.rotations[clear]).max() < 3e-4
    assert np.linalg.norm(rodrigues, axis=1).max() <= 1 + 1e-6


def test_expressed_is_the_reference(gl: Context, rng: np.random.Generator) -> None:
    """More entries than a row of the texture has, every axis the thin one somewhere, and splats without any."""
    splats, shapes = random_splats(rng), random_shapes(COUNT)
    scales = splats.scales.copy()
    scales[:3] = [[1, 2, 2], [2, 1, 1], [1, 1, 1]]  # of equals the first
    splats = Splats(splats.means, splats.quats, scales, splats.opacities, splats.sh)
    weights = np.array([0.7, 0.0, 1.0, 0.2])
    texels = shapes.texels()
    rows = np.zeros((-(-len(texels) // ROW) * ROW, 4), np.uint32)
    rows[: len(texels)] = texels
    assert len(rows) > 2 * ROW
    text = """
    #include "covariance.glsl"
    #include "shapes.glsl"
    in vec3 mean; in vec4 quat; in vec3 scale; out vec3 at, x, y, z;
    void main() { at = mean; mat3 m = expressed(at, quat, scale); x = m[0]; y = m[1]; z = m[2]; gl_Position = vec4(0); }
    """
    out = run_chunk(
        gl, text,
        {"mean": splats.means, "quat": splats.quats, "scale": splats.scales,
         "range": np.stack([shapes.starts[:-1], shapes.starts[1:]], axis=1).astype(np.uint32)},
        {"at": 3, "x": 3, "y": 3, "z": 3}, SkinVariant(shaped=1),
        textures={"entries": rows.reshape(-1, ROW, 4), "amounts": shapes.amounts(weights)[None]},
    )  # fmt: skip
    wanted = reference.expressed(splats, shapes, weights)
    assert np.abs(out["at"] - wanted.means).max() < 1e-6
    assert apart(np.stack([out["x"], out["y"], out["z"]], axis=-1), wanted.shapes, splats) < 2e-6
    still = np.flatnonzero(np.diff(shapes.starts) == 0)
    assert len(still) > 100
    np.testing.assert_array_equal(out["at"][still], splats.means[still])


@pytest.mark.parametrize(
    ("translation", "rotation", "size"),
    [
        ((0, 0, 0), (0, 0, 0, 1), 1.0),
        ((3, -2, 0.5), (0.3, -0.5, 0.2, 0.7), 2.5),
        ((-8, 1, 1), (0.6, 0, 0.8, 0), 0.01),  # by 180 degrees: w is 0
    ],
)
@pytest.mark.parametrize("numbered", [0, 1])
def test_the_place_pass_is_the_reference(
    gl: Context,
    rng: np.random.Generator,
    numbered: int,
    translation: tuple[float, ...],
    rotation: tuple[float, ...],
    size: float,
) -> None:
    splats, transform = random_splats(rng), similarity(translation, rotation, size)
    rows = np.zeros((-(-COUNT // ROW) * ROW, 12), np.float32)
    rows[:COUNT, :3], rows[:COUNT, 3] = splats.means, splats.opacities
    rows[:COUNT, 4:8], rows[:COUNT, 8:11] = splats.quats, splats.scales
    turn = transform[:3, :3] / size
    first, count = (700, 2000) if numbered else (0, COUNT)  # over the end of a row of the texture
    uniforms = {
        "turn": tuple(turn.T.ravel()), "rodrigues": tuple(rodrigues_parameters(turn)),
        "offset": tuple(transform[:3, 3]), "size": size, "signed_opacity": 1.0,
    }  # fmt: skip
    numbers = {"number": np.arange(first, first + count, dtype=np.uint32)} if numbered else {}
    out = run_chunk(
        gl, chunk_text("place.vert.glsl"), numbers, POSED, Variant(numbered=numbered),
        textures={"splats": rows.reshape(-1, ROW * 3, 4)}, uniforms=uniforms, vertices=count,
    )  # fmt: skip
    means, shapes, rodrigues = posed_of(out)
    part = splats.take(np.arange(first, first + count))
    posed = reference.placed(reference.rest(part), transform)
    assert np.abs(means - posed.means).max() < 1e-6 * np.abs(posed.means).max()
    assert apart(shapes, posed.shapes, part) < 1e-5 * max(size, 1)
    assert np.abs(rotations_of(rodrigues) - posed.rotations).max() < 1e-6
    np.testing.assert_array_equal(out["posed_mean"][:, 3], part.opacities)


@pytest.mark.parametrize("margin", [0.0, 0.2])
@pytest.mark.parametrize("views", [1, 2])
def test_cones_hide_what_the_twin_says(gl: Context, rng: np.random.Generator, views: int, margin: float) -> None:
    cones = rng.integers(-128, 128, (COUNT, 4)).astype(np.int8)
    cones[:100, 3], cones[100:200, 3] = 127, -127  # seen from nowhere, from everywhere
    plain = random_splats(rng)
    splats = Splats(plain.means, plain.quats, plain.scales, plain.opacities, plain.sh, cones=cones)
    head = np.linalg.inv(np.diag([1.0, -1, -1, 1]) @ look_at((0.4, 1, 5), (0, 0, 0)))
    cameras = stereo_cameras(head, 0.7, size=(64, 64))[:views]
    block = FrameBlock(gl.ctx, views)
    block.write(
        cameras, cameras[0].viewmat, np.zeros(3), with_fields(RenderConfig(), cull_hidden=True, cull_margin=margin)
    )
    frame = np.frombuffer(block.buffer.read(), frame_dtype(views))[0].copy()
    block.release()
    text = """
    #include "frame.glsl"
    #include "covariance.glsl"
    #include "cone.glsl"
    in vec3 mean; in vec4 q; in vec3 s; out float gone;
    void main() { gone = hidden(mean, shape_matrix(q, s)) ? 1.0 : 0.0; gl_Position = vec4(0); }"""
    inputs = {"mean": splats.means, "q": splats.quats, "s": splats.scales, "cone": cones.astype(np.float32)}
    variant = Variant(views=views, cull_hidden=1)
    gone = run_chunk(gl, text, inputs, {"gone": 1}, variant, frame)["gone"][:, 0] > 0.5
    expected = hidden(splats, [camera.position for camera in cameras], margin)
    assert 0.2 < expected.mean() < 0.95 and not gone[:20].any()  # what is flat has no axes, and stays
    assert (gone != expected).sum() <= 3  # within float32 of the edge of a cone


def test_lift(gl: Context, rng: np.random.Generator) -> None:
    alpha = np.concatenate([[0, 1, 0.5], rng.random(COUNT)])
    pixels = np.concatenate([rng.random((len(alpha), 3)) * 2, alpha[:, None]], axis=1).astype(np.float32)
    background = rng.random((len(alpha), 3)).astype(np.float32)
    text = """
    #include "lift.glsl"
    in vec4 pixel; in vec3 background; out vec4 result;
    void main() { result = lifted(pixel, background); gl_Position = vec4(0); }"""
    result = run_chunk(gl, text, {"pixel": pixels, "background": background}, {"result": 4})["result"]
    expected = np.stack(
        [
            reference.lifted(pixel[None, None].astype(np.float64), tuple(map(float, behind)))[0, 0]
            for pixel, behind in zip(pixels, background, strict=True)
        ]
    )
    assert np.abs(result - expected).max() < 1e-6
    np.testing.assert_array_equal(result[:2], pixels[:2])  # nothing stays nothing, opaque opaque
    infinite = np.array([[np.inf, 1, 1, 0.5]], np.float32)
    out = run_chunk(gl, text, {"pixel": infinite, "background": background[:1]}, {"result": 4})["result"]
    assert out[0, 0] == np.inf and np.isfinite(out[0, 1:]).all()


def test_posed_splats_come_out_of_the_arena_as_they_went_in(gl: Context, rng: np.random.Generator) -> None:
    turns = rotation_matrices(rng.normal(0, 2, (COUNT, 3)))
    rows = np.zeros((-(-COUNT // ROW) * ROW, 4, 4), np.float32)
    rows[:COUNT] = rng.normal(size=(COUNT, 4, 4))
    rows[:COUNT, 1:, 3] = [rodrigues_parameters(turn) for turn in turns]
    directions = rng.normal(size=(COUNT, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    text = """
    #include "covariance.glsl"
    #include "splat_input.glsl"
    in uint index; in vec3 d; out vec4 mean_opacity; out vec3 m0, m1, m2, canonical;
    void main() {
        Splat s = splat_of(int(index));
        mean_opacity = vec4(s.mean, s.opacity); m0 = s.shape[0]; m1 = s.shape[1]; m2 = s.shape[2];
        canonical = canonical_direction(d, s.turn);
        gl_Position = vec4(0);
    }"""
    out = run_chunk(
        gl, text, {"index": np.arange(COUNT, dtype=np.uint32), "d": directions},
        {"mean_opacity": 4, "m0": 3, "m1": 3, "m2": 3, "canonical": 3},
        Variant(posed=1, turned=1, sh_degree=1, stored_degree=1), textures={"splats": rows.reshape(-1, ROW * 4, 4)},
    )  # fmt: skip
    np.testing.assert_array_equal(out["mean_opacity"], rows[:COUNT, 0])
    for column in range(3):
        np.testing.assert_array_equal(out[f"m{column}"], rows[:COUNT, 1 + column, :3])
    expected = np.einsum("nji,nj->ni", turns, directions)  # R^T d
    assert np.abs(out["canonical"] - expected).max() < 2e-6


@pytest.mark.parametrize("antialias", [0, 1])
@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("view", [0, 1])
def test_a_view_picks_its_part_of_a_record(
    gl: Context, rng: np.random.Generator, view: int, degree: int, antialias: int
) -> None:
    inputs = {f"centre{v}": rng.random((50, 2)) for v in (0, 1)} | {f"cholesky{v}": rng.random((50, 3)) for v in (0, 1)}
    inputs |= {f"rgb{v}": rng.random((50, 3)) for v in range(1 + degree)}
    inputs |= {f"alpha{v}": rng.random(50) for v in range(1 + antialias)} | {f"z{v}": rng.random(50) for v in (0, 1)}
    text = """
    #include "record_input.glsl"
    in uint view; out vec2 centre; out vec3 cholesky; out vec4 colour; out float z;
    void main() {
        Record r = record_of(0, int(view));
        centre = r.centre; cholesky = r.cholesky; colour = r.colour; z = r.z;
        gl_Position = vec4(0);
    }"""
    variant = Variant(views=2, sh_degree=degree, stored_degree=degree, antialias=antialias, depth=1)
    given = inputs | {"view": np.full(50, view, np.uint32)}
    out = run_chunk(gl, text, given, {"centre": 2, "cholesky": 3, "colour": 4, "z": 1}, variant)
    expected = {
        "centre": inputs[f"centre{view}"],
        "cholesky": inputs[f"cholesky{view}"],
        "colour": np.column_stack([inputs[f"rgb{view * degree}"], inputs[f"alpha{view * antialias}"]]),
        "z": inputs[f"z{view}"][:, None],
    }
    for name, values in expected.items():
        np.testing.assert_array_equal(out[name], values.astype(np.float32), name)


def test_step(gl: Context, rng: np.random.Generator) -> None:
    """Where nobody has registered one it changes nothing."""
    text = """
    #include "step.glsl"
    in vec4 pixel; out vec4 result;
    void main() { result = stepped(pixel, ivec2(3, 5)); gl_Position = vec4(0); }"""
    pixels = rng.normal(size=(COUNT, 4)).astype(np.float32)
    np.testing.assert_array_equal(run_chunk(gl, text, {"pixel": pixels}, {"result": 4})["result"], pixels)


def test_mark(gl: Context, rng: np.random.Generator) -> None:
    """The chunk over the pixels of a row, whose tile values it gets, against the twin, which finds them itself."""
    mark = Watermark(1, 2, b"sixteen bytes 01")
    image = np.concatenate([rng.random((1, COUNT, 3)) * 1.5 - 0.2, rng.random((1, COUNT, 1))], axis=2)
    image = image.astype(np.float32)
    image[0, :2] = (0, 0.5, 1, 0), (1, 1, 1, 1)  # nothing, and white
    text = f"""
    {mark.source}
    in vec4 pixel; in float tile; out vec4 result;
    void main() {{ result = marked(pixel, tile, LEVELS); gl_Position = vec4(0); }}"""
    inputs = {"pixel": image[0], "tile": mark.tile()[0, np.arange(COUNT) % TILE]}
    result = run_chunk(gl, text, inputs, {"result": 4})["result"]
    assert np.abs(result - marked(image, mark)[0]).max() < 1e-6 and np.abs(result - image[0]).max() > 0.01
    np.testing.assert_array_equal(result[0], image[0, 0])
    assert (result[:, :3] <= np.maximum(image[0, :, :3], image[0, :, 3:])).all()


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
