"""Backs of garments have seams, hems and the front's wrinkles; fronts and bare skin get none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glsplat.extras.authoring.paint.inpaint.cloth import LEGS, TRUNK
from glsplat.extras.authoring.paint.inpaint.rows import dark_lines
from glsplat.extras.authoring.paint.inpaint.tailoring import tailoring_of
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.sample.scatter import even_points
from glsplat.meshes import vertex_normals
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.paint.scene import photographed


def test_hems_seams_and_wrinkles_are_on_the_cloth_of_the_back() -> None:
    scene = photographed("front")
    points = even_points(scene.mesh, 30_000)
    painter = painter_of(scene.body, scene.shots, points)
    tailoring, facing = painter.tailoring, points.directions(vertex_normals(scene.mesh.vertices, scene.mesh.faces))
    factor, detail = tailoring.at(points, np.zeros(len(points.corners)))
    worn, where, _ = tailoring.worn(points)
    assert (factor[facing[:, 2] > 0.6] == 1).all() and (factor[worn == 0] == 1).all()
    cloth, region = (facing[:, 2] < -0.6) & (worn == 1), painter.cloth.region(points)
    hems = tailoring.hems[TRUNK]
    assert len(hems)
    near = cloth & (region == TRUNK) & (np.abs(where[:, 1] - hems.min()) < 0.005)
    assert near.sum() > 20 and factor[near].max() < 0.8 and detail[near].min() > 0.5
    knees = cloth & np.isin(region, LEGS)
    wrinkled, fine = tailoring.at(points, np.full(len(points.corners), 0.1))
    assert np.abs(np.log(wrinkled / factor)[knees] - 0.1).max() < 0.01
    assert (wrinkled[worn == 0] == 1).all() and (fine[knees] > detail[knees]).all()


def test_a_shirt_of_the_trousers_colour_ends_at_a_belt_or_at_the_hips() -> None:
    """A line in two strips of twelve, as of lettering, is no belt."""
    scene = photographed("front")
    points = even_points(scene.mesh, 30_000)
    cloth = painter_of(scene.body, scene.shots, points).cloth
    hips, rng = scene.mesh.skeleton.joints[JOINT_NAMES.index("left_hip"), 1], np.random.default_rng(0)
    trunk = cloth.rows[TRUNK]
    assert trunk is not None
    grey = np.full_like(trunk.colour, 0.5)
    plain = replace(trunk, colour=grey, outer=grey)
    at, across = rng.uniform(trunk.places[0], trunk.places[-1], 40_000), rng.uniform(-0.18, 0.18, 40_000)

    def waist(half_width: float) -> float:
        dark = (np.abs(at - hips - 0.1) < 0.01) & (np.abs(across) < half_width)
        look = np.repeat(np.where(dark, 0.42, 0.5)[:, None], 3, axis=1)
        lines = dark_lines(plain, at, across, look)
        return tailoring_of(scene.mesh, replace(cloth, rows=(plain, *cloth.rows[1:]), lines=lines), True).waist

    assert abs(waist(0.2) - hips - 0.1) < 0.011
    assert waist(0.03) == hips
    assert (dark_lines(plain, np.zeros(0), np.zeros(0), np.zeros((0, 3))) == 0).all()


def test_legs_that_touch_have_a_shade_between_them_and_skirts_have_none() -> None:
    """As wide shorts: the legs reach 3 cm beyond the plane between them."""
    scene = photographed("front")
    points = even_points(scene.mesh, 30_000)
    painter = painter_of(scene.body, scene.shots, points)
    region = painter.cloth.region(points)
    behind = points.directions(vertex_normals(scene.mesh.vertices, scene.mesh.faces))[:, 2] < -0.6
    rest = scene.mesh.vertices.copy()
    for number, sign in zip(LEGS, (1.0, -1.0), strict=True):
        leg = painter.cloth.shares.argmax(axis=1) == number
        rest[leg, 0] -= sign * ((sign * rest[leg, 0]).min() + 0.03)
    tailoring = replace(painter.tailoring, mesh=replace(scene.mesh, vertices=rest))
    worn, where, lines = tailoring.worn(points)
    cloth = behind & (worn == 1) & (lines < 0.01) & np.isin(region, LEGS)
    inner = np.where(region == LEGS[0], where[:, 0], -where[:, 0])
    relief = np.zeros(len(where))
    factor, skirt = (each.at(points, relief)[0] for each in (tailoring, replace(tailoring, trousers=False)))
    near = cloth & (inner < 0.015)
    assert near.sum() > 20 and factor[near].max() < 0.8
    far = cloth & (inner > 0.08)
    assert far.sum() > 200 and factor[far].min() > 0.98
    assert skirt[cloth].min() > 0.98


def test_a_front_s_wrinkles_are_on_the_back_and_its_print_is_not() -> None:
    """Dark lines of 2 cm, level, over the whole shirt; a black square on the chest."""
    scene = photographed("front")
    shot = scene.shots[0]
    back = even_points(scene.mesh, 30_000)
    back = back.take(back.directions(vertex_normals(scene.mesh.vertices, scene.mesh.faces))[:, 2] < -0.8)
    where = back.at(scene.mesh.vertices)
    hip, chest = (scene.mesh.skeleton.joints[JOINT_NAMES.index(name)] for name in ("pelvis", "spine3"))
    back = back.take((where[:, 1] > hip[1] + 0.1) & (where[:, 1] < chest[1]) & (np.abs(where[:, 0]) < 0.1))
    row, column = np.indices(shot.mask.shape)
    metre = np.ptp(np.flatnonzero(shot.mask.any(axis=1))) / np.ptp(scene.mesh.vertices[:, 1])  # pixels
    lines = 1 - 0.15 * (np.floor(row / (0.02 * metre)) % 2)
    top, middle = shot.project(np.array([shot.view.joints[JOINT_NAMES.index("spine3")]]))[0][::-1]
    square = (np.abs(row - top - 0.08 * metre) < 0.05 * metre) & (np.abs(column - middle) < 0.05 * metre)

    def change(factor: np.ndarray) -> np.ndarray:
        rgb = np.rint(shot.rgb * np.sqrt(factor)[..., None]).astype(np.uint8)
        other = FittedPicture(rgb, shot.mask, shot.focal, shot.view, shot.mesh)
        before, after = (
            painter_of(scene.body, [each], even_points(scene.mesh, 30_000)).colours(back).sum(axis=1)
            for each in (shot, other)
        )
        return np.asarray(np.log(after / before))

    assert len(back.corners) > 300
    assert change(lines).std() > 0.02
    assert np.abs(change(np.where(square, 0.0, 1.0))).max() < 0.05
