"""Cloth continues on unseen surface: without prints and background, and as far up as straps reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.extras.authoring.body.segments import trunk_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.front_to_back_transfer import Front, match_to_front
from glsplat.extras.authoring.paint.inpaint.rows import (
    Rows,
    in_one_tone,
    rows_of,
    with_bare_neck,
    with_pattern_above,
    without_mixed_rows,
    without_straps,
    without_unseen_edges,
)
from glsplat.extras.authoring.paint.inpaint.sleeves import cut_sleeves
from glsplat.extras.authoring.paint.painter import Painter, painter_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.sample.scatter import even_points
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_linear
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.paint import scene as made_up
from tests.extras.authoring.paint.scene import Scene, albedo, photographed

SHIRT, SKIN = np.array([0.5, 0.1, 0.08]), np.array([0.45, 0.3, 0.22])


def places(scene: Scene) -> tuple[SurfacePoints, np.ndarray, np.ndarray]:
    """Points, where they are in the zero pose in heights of the person, and how far they turn to the front."""
    points = even_points(scene.mesh, 30_000)
    height = scene.mesh.vertices[:, 1].max()
    facing = points.directions(vertex_normals(scene.mesh.vertices, scene.mesh.faces))[:, 2]
    return points, points.at(scene.mesh.vertices) / height, facing


def unlit(painter: Painter, points: SurfacePoints) -> np.ndarray:
    """[M, 3] linear colours without the light."""
    return (
        to_linear(painter.colours(points)) / painter.light.shade(points.directions(painter.shots[0].normals))[:, None]
    )


def of(points: SurfacePoints, some: np.ndarray) -> SurfacePoints:
    return SurfacePoints(points.corners[some], points.weights[some])


def hue(colours: np.ndarray) -> np.ndarray:
    """[M, 3] without brightness."""
    return colours / colours.sum(axis=1, keepdims=True)


def with_picture(scene: Scene, rgb: np.ndarray) -> FittedPicture:
    return replace(scene.shots[0], rgb=np.ascontiguousarray(rgb))


def test_a_shirts_print_is_not_on_its_back() -> None:
    scene = photographed("front")
    points, where, facing = places(scene)
    chest = (np.abs(where[:, 0]) < 0.05) & (where[:, 1] > 0.66) & (where[:, 1] < 0.76)
    pixels = scene.shots[0].project(points.at(scene.shots[0].view.vertices))[chest & (facing > 0.5)]
    (x, y), (right, low) = pixels.min(axis=0).astype(int), pixels.max(axis=0).astype(int)
    rgb = scene.shots[0].rgb.copy()
    for left in range(x, right, 16):
        rgb[y:low, left : left + 8] = 250  # white bars, as letters are
    painter = painter_of(scene.body, [with_picture(scene, rgb)], points)
    front = unlit(painter, of(points, chest & (facing > 0.8)))
    assert (np.abs(hue(front) - 1 / 3).max(axis=1) < 0.05).mean() > 0.2  # it is where it was
    back = unlit(painter, of(points, chest & (facing < -0.5)))
    assert len(back) > 50 and np.abs(hue(back) - hue(SHIRT[None])).max() < 0.12


def test_a_shadow_on_the_front_is_not_on_the_back() -> None:
    scene = photographed("front")
    points, where, facing = places(scene)
    chest = (where[:, 0] > 0.02) & (where[:, 0] < 0.08) & (where[:, 1] > 0.62) & (where[:, 1] < 0.76)
    pixels = scene.shots[0].project(points.at(scene.shots[0].view.vertices))[chest & (facing > 0.5)]
    (x, y), (right, low) = pixels.min(axis=0).astype(int), pixels.max(axis=0).astype(int)
    rgb = scene.shots[0].rgb.copy()
    rgb[(y + low) // 2 : low, x:right] = 0.88 * rgb[(y + low) // 2 : low, x:right]
    dark, lit = (painter_of(scene.body, [shot], points) for shot in (with_picture(scene, rgb), scene.shots[0]))
    patch = chest & (where[:, 1] < 0.68)
    front, back = (
        np.median(unlit(dark, of(points, patch & some)) / unlit(lit, of(points, patch & some)))
        for some in (facing > 0.8, facing < -0.5)
    )
    assert front < 0.8 and back > 0.88, (front, back)


def test_regions_meet_within_triangles() -> None:
    scene = photographed("front")
    points, _, _ = places(scene)
    cloth = painter_of(scene.body, scene.shots, points).cloth
    own = cloth.shares.argmax(axis=1)
    mixed = scene.mesh.faces[(np.ptp(own[scene.mesh.faces], axis=1) > 0) & (own[scene.mesh.faces] < 8).all(axis=1)]
    assert len(mixed) > 50
    for corner in range(3):
        weights = np.tile(np.where(np.arange(3) == corner, 0.98, 0.01), (len(mixed), 1))
        found = cloth.region(SurfacePoints(mixed.astype(np.intp), weights))
        assert (found == own[mixed[:, corner]]).mean() > 0.95


def test_a_pattern_goes_on_at_its_scale_around_the_flank() -> None:
    scene = photographed("front")
    rest, hip = scene.mesh.vertices, scene.mesh.skeleton.joints[1, 1]
    there = match_to_front(scene.mesh, trunk_vertices(scene.body)).points[0].at(rest)
    normals = vertex_normals(rest, scene.mesh.faces)
    flank = trunk_vertices(scene.body) & (normals[:, 0] > 0.75) & (np.abs(rest[:, 1] - hip - 0.2) < 0.03)
    assert flank.sum() > 5
    deep, wide = np.ptp(rest[flank, 2]), np.ptp(there[flank, 0])
    assert wide > 0.3 * deep, (wide, deep)  # straight through the body it would be one smeared column
    assert np.abs(there[flank, 1] - rest[flank, 1]).max() < 0.01


def test_a_pattern_of_most_of_a_chest_goes_on_above_it() -> None:
    flat, pattern = np.zeros(40), np.arange(40) < 27

    def above(place: float) -> np.ndarray:
        colour = np.zeros((40, 3))
        return with_pattern_above(Rows(1, 0.0, colour, flat, colour, flat, pattern), place, 0.1).pattern

    assert above(0.305).all()  # seven of ten rows below it
    assert np.array_equal(above(0.335), pattern)  # four


def test_steps_of_light_down_a_garment_are_smoothed_and_hems_stay() -> None:
    colour = np.full((60, 3), 0.6)
    colour[20:40], colour[40:] = 0.55, (0.1, 0.1, 0.3)
    flat = np.zeros(60)
    (rows,) = in_one_tone([Rows(1, 0.0, colour, flat, colour, flat, flat > 0)])
    assert np.abs(np.diff(rows.colour[:40, 0])).max() < 0.01
    assert np.allclose(rows.colour[40:], colour[40:])
    assert (rows.tolerance >= np.abs(rows.colour - colour).max(axis=1)).all()  # what was its cloth still is
    assert in_one_tone([]) == []  # a neck that no picture shows


def test_hidden_rows_take_the_shirt_not_the_edge_of_an_arm_or_a_print() -> None:
    shirt, other = np.full(3, 0.6), np.array([0.6, 0.1, 0.1])
    at = np.linspace(0, 0.6, 1200)
    for edge, fraction in ((0.4125, 0.03), (0.44, 1.0)):  # few samples of a sleeve; a print of 4 cm
        look = np.where(((at > 0.4) & (at < edge))[:, None], other, shirt)
        weight = np.where((at > 0.25) & (at < 0.4), 0.0, np.where(at < 0.4, 1.0, np.where(at < edge, fraction, 1.0)))
        rows = rows_of(1, (0.0, 0.6), at, look, weight, 0.0125)
        assert rows is not None
        assert np.abs(rows.colour[(rows.places > 0.265) & (rows.places < 0.385)] - shirt).max() < 0.02


def test_a_sock_on_a_thin_ankle_keeps_its_rows() -> None:
    at = np.concatenate([np.linspace(0.0, 0.085, 850), np.linspace(0.12, 0.6, 4800)])
    sock, skin = np.full(3, 0.1), np.array([0.47, 0.4, 0.33])
    look, weight = np.where(at[:, None] < 0.1, sock, skin), np.where(at < 0.1, 0.08, 1.0)
    for thin, ankle in ((True, sock), (False, skin)):
        rows = rows_of(1, (0.0, 0.6), at, look, weight, 0.0125, thin)
        assert rows is not None and np.allclose(rows.colour[:8], ankle, atol=0.01)


def test_a_neck_is_bare_above_its_lowest_skin_and_covered_below() -> None:
    skin, black = np.array([0.45, 0.31, 0.23]), np.full(3, 0.08)
    flat = np.zeros(14)
    beard, collar = np.tile(skin, (14, 1)), np.tile(skin, (14, 1))
    beard[4:9], collar[:9] = black, black
    for colour, cloth in ((beard, 0), (collar, 9)):
        colour[-2:] -= 0.01  # the nearest to the face's colour
        bare = with_bare_neck(Rows(1, 1.5, colour, flat, colour, flat, flat > 0), skin - 0.05).colour
        assert np.abs(bare[cloth:] - skin).max() < 0.02
        assert np.array_equal(bare[:cloth], colour[:cloth])


def test_a_throat_in_the_shadow_of_the_chin_is_bare_and_a_dark_collar_is_not() -> None:
    """A lock of hair lies across both."""
    skin, hair, flat = np.array([0.7, 0.51, 0.44]), np.array([0.1, 0.05, 0.05]), np.zeros(14)
    for below, bare in ((0.42 * skin, True), (np.array([0.3, 0.25, 0.27]), False)):
        colour = np.tile(skin, (14, 1))
        colour[:4], colour[4] = below, hair
        rows = with_bare_neck(Rows(1, 1.5, colour, flat, colour, flat, flat > 0), skin)
        assert np.allclose(rows.colour[5:], skin)
        assert np.allclose(rows.colour[:5], skin if bare else colour[:5])


def test_a_sandal_has_a_sole_and_straps_in_front_only() -> None:
    skin, leather = np.array([0.6, 0.5, 0.4]), np.array([0.2, 0.15, 0.1])
    at = np.linspace(0, 0.14, 1400)
    for bare, heel in ((0.4, skin), (0.1, leather)):  # a sandal, and a shoe with an open toe
        shown = np.arange(len(at)) % 10 < 10 * bare
        look = np.where(((at > 0.12) | ((at > 0.02) & shown))[:, None], skin, leather)
        rows = rows_of(1, (0.0, 0.14), at, look, np.ones(len(at)), 0.0125)
        assert rows is not None
        colour = without_straps(rows, at, look, np.ones(len(at))).colour
        assert np.abs(colour[4:10] - heel).max() < 0.05
        assert np.abs(colour[0] - leather).max() < 0.05 and np.abs(colour[-1] - skin).max() < 0.01


def test_light_that_leaves_a_leg_aslant_is_no_hem() -> None:
    """The lit colour has most of the upper rows, the dark one of the lower: the main colour turns at once."""
    across, at = (each.ravel() for each in np.meshgrid(np.linspace(-0.07, 0.07, 60), np.linspace(0, 0.6, 400)))

    def steps(lit: np.ndarray) -> tuple[float, float]:
        """Return the largest step between two rows, before and after."""
        look = np.where(lit, 0.6, 0.15)[:, None] * np.ones(3)
        rows = rows_of(1, (0.0, 0.6), at, look, np.ones(len(at)), 0.0125)
        assert rows is not None
        soft = without_unseen_edges(rows, at, across, look)
        before, after = (float(np.abs(np.diff(each.colour[:, 0])).max()) for each in (rows, soft))
        return before, after

    before, after = steps(across < 0.14 * (at / 0.6 - 0.5))
    assert before > 0.2 and after < 0.05
    before, after = steps(at > 0.3)  # a dark boot below a leg of the same hue
    assert before > 0.2 and after == before


def test_lettering_is_no_band_and_stripes_and_belts_are() -> None:
    colour, tolerance = np.tile([0.45, 0.09, 0.09], (40, 1)), np.full(40, 0.08)
    colour[15:21] = 0.3, 0.22, 0.23  # black and white letters on red
    flat = np.zeros(40)

    def cleaned(spread: float, flanks: np.ndarray | None = None) -> np.ndarray:
        tolerance[15:21] = spread
        return without_mixed_rows(Rows(1, 0.0, colour, tolerance, colour, flat, flat > 0), flanks).colour

    assert np.abs(cleaned(0.14) - colour[0]).max() < 0.01
    assert np.array_equal(cleaned(0.08), colour)  # of one colour: it goes round
    assert np.array_equal(cleaned(0.14, colour), colour)  # a bare belly
    assert np.abs(cleaned(0.14, np.tile(colour[0], (40, 1))) - colour[0]).max() < 0.01

    flanks = np.tile(colour[0], (40, 1))
    flanks[18] = colour[18]  # lettering that reaches the flank in one row
    assert np.abs(cleaned(0.14, flanks) - colour[0]).max() < 0.01
    hem = np.tile(colour[0], (40, 1))
    hem[20] = colour[15]
    rows = Rows(1, 0.0, hem, np.full(40, 0.08), hem, flat, flat > 0)
    assert np.array_equal(without_mixed_rows(rows).colour, hem)  # of a leg


def test_a_back_is_covered_between_straps(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = 0.05  # from the middle to the straps' outer edges, in heights of the person

    def vest(mesh: object) -> np.ndarray:
        colours = albedo(mesh)
        where = mesh.vertices / mesh.vertices[:, 1].max()
        bare = (where[:, 1] > 0.79) & (np.abs(where[:, 0]) > wide)
        neckline = (where[:, 1] > 0.80) & (np.abs(where[:, 0]) < 0.03) & (where[:, 2] > 0)
        colours[bare | neckline | (where[:, 1] > 0.84) | (np.abs(where[:, 0]) > 0.1)] = SKIN
        return colours

    monkeypatch.setattr(made_up, "albedo", vest)
    scene = photographed.__wrapped__("front")
    points, where, facing = places(scene)
    painter = painter_of(scene.body, scene.shots, points)
    back = (facing < -0.5) & (where[:, 1] > 0.80) & (where[:, 1] < 0.82)
    middle = unlit(painter, of(points, back & (np.abs(where[:, 0]) < 0.03)))
    assert len(middle) > 5 and np.abs(hue(middle) - hue(SHIRT[None])).max() < 0.15
    beside = unlit(painter, of(points, back & (np.abs(where[:, 0]) > wide + 0.02) & (np.abs(where[:, 0]) < 0.14)))
    assert len(beside) > 5 and np.abs(np.median(hue(beside), axis=0) - hue(SKIN[None])[0]).max() < 0.08


def test_an_arm_before_the_trunk_does_not_take_its_cloth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deep inside of an arm, too: the fit may have it beside its place."""
    scene = photographed("front")
    points, _, facing = places(scene)
    shot, shade = scene.shots[0], np.ones(len(points.corners))
    cloth = painter_of(scene.body, scene.shots, points).cloth
    arms = cloth.on_sleeves(points) & (facing > 0.9)
    legs = cloth.rows[1]
    assert arms.sum() > 200 and legs is not None
    trousers = np.tile(np.median(legs.colour, axis=0) ** 2, (len(shade), 1))
    material = cloth.at(points)
    deep = shot.outline_distance(shot.project(points.at(shot.view.vertices)), shot.layers_at(points)) > 0.02
    assert (arms & deep).sum() > 50
    assert cloth.foreign(shot, points, trousers, shade, material)[arms & deep].max() == 0
    monkeypatch.setattr(FittedPicture, "over_trunk", lambda self, pixels: np.ones(len(pixels), bool))
    assert cloth.foreign(shot, points, trousers, shade, material)[arms].min() > 0.9
    assert cloth.foreign(shot, points, material.colour, shade, material)[arms].max() == 0  # its own colour stays


def test_sleeves_are_cut_from_the_trunk(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = photographed("front")
    span, where = (0.95, 1.25), scene.mesh.vertices
    there = cut_sleeves(scene.mesh, Front(scene.mesh), span).at(where)
    arm = np.isin(
        scene.body.part,
        [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in ("shoulder", "elbow")],
    )
    aside = np.abs(there[arm])
    assert (aside[:, 0] > 0.02).all() and (aside[:, 0] < 0.12).all()
    assert (aside[:, 1] > span[0] - 0.01).all() and (aside[:, 1] < span[1] + 0.01).all()
    assert (np.sign(there[arm, 0]) == np.sign(where[arm, 0])).all()
    # along the arm it goes down, as far as the cloth reaches
    shoulder = scene.mesh.skeleton.joints[JOINT_NAMES.index("left_shoulder"), 0]
    first = arm & (where[:, 0] > shoulder + 0.02) & (where[:, 0] < shoulder + 0.25)
    assert np.polyfit(where[first, 0], there[first, 1], 1)[0] == pytest.approx(-1.0, abs=0.05)
