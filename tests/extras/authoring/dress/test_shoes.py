"""Shoes stand on the floor in place of the feet, and are painted in the colours that the picture shows."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.dress.shoes import feet_vertices, with_shoes
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.shoes import footwear_of, shoe_painter
from glsplat.extras.authoring.templates.library import template
from glsplat.meshes import RiggedMesh
from glsplat.pictures import to_linear
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
