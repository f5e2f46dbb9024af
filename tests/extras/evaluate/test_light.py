"""Lit ground truth: the formula on geometry that can be worked out, and the participants' captures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.turntable import CaptureLight, shade_of
from glsplat.gl.context import Context
from glsplat.meshes import MeshPart, RiggedMesh, standing, vertex_normals
from glsplat.pictures import to_linear, to_srgb
from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import capture
from tests.scene.people import boxes


def sheets(*corners: ArrayLike, grid: int = 9) -> RiggedMesh:
    """Rectangles of ``grid``^2 vertices, each from a corner and two edges [3, 3], on one joint, mid grey."""
    s, t = np.meshgrid(np.linspace(0, 1, grid), np.linspace(0, 1, grid), indexing="ij")
    i, j = np.meshgrid(np.arange(grid - 1), np.arange(grid - 1), indexing="ij")
    a = (i * grid + j).ravel()
    faces = np.concatenate([np.stack([a, a + grid, a + 1], 1), np.stack([a + 1, a + grid, a + grid + 1], 1)])
    rows = [np.asarray(c, float) for c in corners]
    points = [c[0] + s.ravel()[:, None] * c[1] + t.ravel()[:, None] * c[2] for c in rows]
    whole = np.concatenate([faces + n * grid**2 for n in range(len(rows))]).astype(np.int32)
    texture = np.full((4, 4, 4), (128, 64, 32, 255), np.uint8)
    part = MeshPart("sheets", whole, np.zeros((*whole.shape, 2)), texture)
    return standing(np.concatenate(points), (part,), "sheets")


FLOOR = [[-1, 0, -1], [0, 0, 2], [2, 0, 0]]  # facing up
ROOF = [[-0.5, 1, -0.5], [0, 0, 1], [1, 0, 0]]
LIGHT = CaptureLight((0.0, 2.0, 0.0), (0.6, 0.5, 0.4))


def test_the_formula() -> None:
    """Facing up all of the sky and all of the lamp; under a roof the lamp is away, at its edge partly."""
    open_ = sheets(FLOOR)
    assert np.allclose(vertex_normals(open_.vertices, open_.faces), (0, 1, 0))
    expected = np.array(LIGHT.sky) + LIGHT.colour
    np.testing.assert_allclose(shade_of(open_, open_.vertices, LIGHT), np.tile(expected, (81, 1)), atol=1e-9)
    both = sheets(FLOOR, ROOF)
    shade = shade_of(both, both.vertices, LIGHT)
    x, z = np.abs(both.vertices[:81, [0, 2]]).T
    np.testing.assert_allclose(shade[:81][(x < 0.45) & (z < 0.45)], np.tile(LIGHT.sky, (9, 1)), atol=1e-9)
    np.testing.assert_allclose(shade[:81][(x > 0.7) | (z > 0.7)][0], expected, atol=1e-9)
    slanted = CaptureLight((1.0, 1.0, 0.0), (0.6, 0.5, 0.4))
    wrapped = np.array(slanted.sky) + (np.sqrt(0.5) + 0.15) / 1.15 * np.array(slanted.colour)
    np.testing.assert_allclose(shade_of(open_, open_.vertices, slanted), np.tile(wrapped, (81, 1)), atol=1e-9)


def test_notes_that_do_not_fit() -> None:
    with pytest.raises(GlsplatError, match="direction_to and colour"):
        CaptureLight.of_note({"colour": [1, 1, 1]})
    with pytest.raises(GlsplatError, match="not zero"):
        CaptureLight.of_note({"direction_to": [0, 0, 0], "colour": [1, 1, 1]})


@pytest.mark.gl
def test_shade_multiplies_linear_light(context: Context) -> None:
    mesh = sheets([[-1, -1, 0], [2, 0, 0], [0, 2, 0]])
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), pinhole(48, 48, 60.0), 48, 48)
    factors = np.tile([0.5, 1.0, 2.5], (81, 1))
    with context, MeshTruth(mesh, size=(48, 48), output="float32", context=context) as renderer:
        plain = renderer.render([camera])
        lit = renderer.render([camera], shade=factors)
        assert np.array_equal(renderer.render([camera]), plain)  # what is not lit is as it was
        assert np.abs(renderer.render([camera], shade=np.ones((81, 3))) - plain).max() <= 1 / 255 + 1e-6
        inside = lit[0, ..., 3] == 1
        expected = to_srgb(to_linear(np.array([128, 64, 32]) / 255) * (0.5, 1.0, 2.5))
        assert np.abs(lit[0][inside][:, :3] - expected).max() <= 1 / 255
        for wrong in (np.ones((80, 3)), np.full((81, 3), np.nan), 1.0):
            with pytest.raises(GlsplatError, match=r"shade needs \(81, 3\) finite factors"):
                renderer.render([camera], shade=wrong)


@pytest.mark.gl
def test_shade_follows_vertices_through_seams(context: Context) -> None:
    """Vertices that texture seams split: a box lit by its number is as bright all over, whatever its corners' uv."""
    mesh = boxes()
    factors = np.repeat(np.linspace(0.2, 1.0, len(mesh.vertices) // 8), 8)[:, None] * np.ones(3)
    white = MeshPart("white", mesh.parts[0].faces, mesh.parts[0].uv, np.full((2, 2, 4), 255, np.uint8))
    mesh = RiggedMesh(mesh.vertices, mesh.skeleton, mesh.joints, mesh.weights, (white,))
    head = mesh.skeleton.joints[list(mesh.skeleton.names).index("head")]
    camera = Camera(look_at(head + (0, 0, 1), head), pinhole(32, 32, 5.0), 32, 32)
    with context, MeshTruth(mesh, size=(32, 32), output="float32", context=context) as renderer:
        seen = renderer.render([camera], shade=factors)[0, ..., :3]
    level = to_srgb(factors[8 * list(mesh.skeleton.names).index("head")])
    assert np.abs(seen - level).max() <= 1.5 / 255


@pytest.mark.gl
def test_a_capture(context: Context) -> None:
    """A participant under the light of their capture is the photograph's figure, but for highlights."""
    person = capture("p02")
    pose, size = Pose(person.pose, person.trans), (256, 384)
    shade = shade_of(person.mesh, person.mesh.posed(pose), CaptureLight.of_note(person.light))
    with context, MeshTruth(person.mesh, size=size, output="float32", context=context) as renderer:
        camera = person.camera.resized(*size)
        unlit, lit = renderer.render([camera], pose)[0], renderer.render([camera], pose, shade=shade)[0]
    photograph = cv2.resize(person.picture / 255.0, size, interpolation=cv2.INTER_AREA)
    inside = cv2.erode((lit[..., 3] == 1).astype(np.uint8), np.ones((3, 3))) > 0
    levels = [-10 * np.log10(((p[..., :3] - photograph) ** 2)[inside].mean()) for p in (unlit, lit)]
    assert levels[1] > 32 and levels[1] > levels[0] + 10, levels
