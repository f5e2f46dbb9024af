"""Backs of garments have seams, hems and folds; fronts and bare skin have none."""

from __future__ import annotations

import numpy as np

from glsplat.extras.authoring.paint.inpaint.cloth import LEGS, TRUNK
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.sample.scatter import even_points
from glsplat.meshes import vertex_normals
from tests.extras.authoring.paint.scene import photographed


def test_hems_seams_and_folds_are_on_the_cloth_of_the_back() -> None:
    scene = photographed("front")
    points = even_points(scene.mesh, 30_000)
    painter = painter_of(scene.body, scene.shots, points)
    tailoring, facing = painter.tailoring, points.directions(vertex_normals(scene.mesh.vertices, scene.mesh.faces))
    factor, detail = tailoring.at(points)
    worn, where, _ = tailoring.worn(points)
    assert (factor[facing[:, 2] > 0.6] == 1).all() and (factor[worn == 0] == 1).all()
    cloth, region = (facing[:, 2] < -0.6) & (worn == 1), painter.cloth.region(points)
    hems = tailoring.hems[TRUNK]
    assert len(hems)
    near = cloth & (region == TRUNK) & (np.abs(where[:, 1] - hems.min()) < 0.005)
    assert near.sum() > 20 and factor[near].max() < 0.8 and detail[near].min() > 0.5
    knees = cloth & np.isin(region, LEGS)
    assert 0.02 < np.log(factor[knees]).std() < 0.2  # folds are soft
