"""Shoes stand on the floor in place of the feet, and are painted in the colours that the picture shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.dress.shoes import feet_vertices, with_shoes
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.paint import shoes as paint_shoes
from glsplat.extras.authoring.paint.shoes import footwear_of, shoe_painter
from glsplat.extras.authoring.sample.scatter import scatter
from glsplat.extras.authoring.templates.library import template
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.pictures import to_linear
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.paint import scene as made_up
from tests.extras.authoring.paint.scene import Scene, photographed

SKIN = np.array([0.45, 0.3, 0.22])


def in_shoes(colour: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """The person with feet of this colour."""
    usual, feet = made_up.albedo, feet_vertices(open_body(), "left") | feet_vertices(open_body(), "right")

    def worn(mesh: RiggedMesh) -> np.ndarray:
        colours = usual(mesh)
        colours[feet] = colour
        return colours

    monkeypatch.setattr(made_up, "albedo", worn)
    return photographed.__wrapped__("front")


@pytest.mark.parametrize(
    ("colour", "kind"), [(SKIN, "bare"), ((0.005, 0.005, 0.005), "low shoe"), ((0.7, 0.7, 0.7), "sneaker")]
)
def test_footwear_is_told_by_its_colour(colour: np.ndarray, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = in_shoes(colour, monkeypatch)
    found = footwear_of(scene.body, scene.shots[0])
    assert found.kind == kind and (found.template is None) == (kind == "bare")


@pytest.mark.parametrize("name", ["shoes01", "shoes05"])
def test_shoes_stand_on_the_floor_in_place_of_feet_and_have_their_colour(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = in_shoes(np.array([0.05, 0.08, 0.5]), monkeypatch)
    body, mesh = scene.body, scene.mesh
    floor = scene.fit.joints[0] - mesh.skeleton.joints[0]
    shod = with_shoes(body, body.shaped(scene.fit.betas)[0] - floor, mesh, template(name))
    shoes = shod.parts[-1]
    assert shoes.name == "shoes" and shoes.faces.min() == len(mesh.vertices)
    assert np.ptp([shod.vertices[shoes.faces][..., 1].min(), mesh.vertices[:, 1].min()]) < 0.01
    assert shod.vertices[shod.parts[0].faces][..., 1].min() > 0.03  # no toes
    painter = shoe_painter(body, scene.shots[0], scene.light, shod)
    rgb, visibility, _ = painter.paint(
        SurfacePoints(shoes.faces.astype(np.intp), np.full((len(shoes.faces), 3), 1 / 3))
    )
    assert 0.05 < (visibility > 0.5).mean() < 0.6
    blue = to_linear(rgb[visibility == 0])
    assert (blue[:, 2] > 3 * blue[:, 0]).mean() > 0.98


def test_plain_light_shoes_get_no_stripes_from_their_template(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = in_shoes(np.array([0.6, 0.6, 0.6]), monkeypatch)
    floor = scene.fit.joints[0] - scene.mesh.skeleton.joints[0]
    shod = with_shoes(scene.body, scene.body.shaped(scene.fit.betas)[0] - floor, scene.mesh, template("shoes02"))
    factors = shoe_painter(scene.body, scene.shots[0], scene.light, shod).seams[1]
    assert 0.05 < np.log(factors).std() < 0.2


def test_a_strip_of_floor_is_not_painted_on_shoes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = in_shoes(np.array([0.6, 0.3, 0.3]), monkeypatch)
    body, shot, floor = scene.body, scene.shots[0], scene.fit.joints[0] - scene.mesh.skeleton.joints[0]
    shod = with_shoes(body, body.shaped(scene.fit.betas)[0] - floor, scene.mesh, template("shoes01"))
    toe = feet_vertices(body, "left") & (shot.visibility > 0.5) & (scene.mesh.vertices[:, 1] > 0.03)
    x, y = shot.view.pixels[toe].astype(int).T
    rgb, room = shot.rgb.copy(), np.median(shot.rgb[~shot.mask], axis=0)
    rgb[y.min() : y.max(), int(np.median(x)) : int(np.median(x)) + max(2, np.ptp(x) // 6)] = room
    faces = shod.parts[-1].faces
    points = SurfacePoints(faces.astype(np.intp), np.full((len(faces), 3), 1 / 3))
    upper, found = points.at(shod.vertices)[:, 1] > 0.025, []
    for most in (0.0, 0.1):
        monkeypatch.setattr(paint_shoes, "_MAX_FLOOR", most)
        painted = shoe_painter(body, replace(shot, rgb=rgb), scene.light, shod).paint(points)[0]
        found.append((np.linalg.norm(painted[upper] - room / 255, axis=1) < 0.1).sum())
    assert found[0] > 20 and found[1] <= 2, found


def test_trousers_narrow_into_shoes_but_wide_hems_hang_over_them() -> None:
    scene = made_up.photographed("front")
    body, floor = scene.body, scene.fit.joints[0] - scene.mesh.skeleton.joints[0]
    bare = body.shaped(scene.fit.betas)[0] - floor
    leg = body.skin & (body.part == JOINT_NAMES.index("left_knee"))
    rim = leg & (body.vertices[:, 1] < -0.68)
    normals = vertex_normals(bare, body.faces)
    for width, gap in ((0.015, 0.004), (0.06, 0.06)):
        dressed = replace(scene.mesh, vertices=bare + width * normals)
        worn = with_shoes(body, bare, dressed, template("shoes01")).vertices[: len(bare)]
        assert rim.sum() > 10 and abs(np.linalg.norm(worn - bare, axis=1)[rim].max() - gap) < 0.004
        above = leg & (body.vertices[:, 1] > -0.64)
        assert np.allclose(worn[above], dressed.vertices[above])


def test_shoes_have_twice_the_splats_of_their_area() -> None:
    scene = made_up.photographed("front")
    floor = scene.fit.joints[0] - scene.mesh.skeleton.joints[0]
    shod = with_shoes(scene.body, scene.body.shaped(scene.fit.betas)[0] - floor, scene.mesh, template("shoes02"))
    points = scatter(shod, 10_000, np.random.default_rng(0)).points
    area = triangle_areas(shod.vertices, shod.faces)
    height, middle = points.at(shod.vertices)[:, 1], shod.vertices[shod.faces].mean(axis=1)[:, 1]
    shoes, legs = (
        ((low < height) & (height < high)).sum() / area[(low < middle) & (middle < high)].sum()
        for low, high in ((-1.0, 0.1), (0.2, 0.5))
    )
    assert 1.6 < shoes / legs < 2.2
