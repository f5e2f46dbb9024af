"""Visible colours are kept, the light is found, and unseen colours are guessed well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import Camera
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.front_to_back_transfer import match_to_front
from glsplat.extras.authoring.paint.lamp import find_light
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.view_sample import hand_shares
from glsplat.extras.authoring.sample.scatter import scatter
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_srgb
from glsplat.skinning.pose import Pose
from tests.extras.authoring.paint.scene import Scene, albedo, photographed


def truth(scene: Scene, points: SurfacePoints) -> np.ndarray:
    """[M, 3] sRGB of the points in the person's light."""
    front = scene.shots[0]
    shade = scene.light.shade(points.directions(front.normals))
    nearest = points.corners[np.arange(len(points.corners)), points.weights.argmax(axis=1)]
    return to_srgb(albedo(scene.mesh)[nearest] * shade[:, None] * 0.6)


def some_points(scene: Scene, seed: int = 5) -> SurfacePoints:
    return scatter(scene.mesh, 500, np.random.default_rng(seed)).points


@pytest.mark.parametrize("lamp", [(0.5, -0.6, -0.62), (-0.6, -0.5, -0.6)])
def test_the_lamp_is_found(lamp: tuple[float, float, float]) -> None:
    scene = photographed("front", lamp=lamp)
    points = some_points(scene)
    front = scene.shots[0]
    sample = front.sample_surface(points)
    normals, up = points.directions(front.normals), front.view.root[:, 1]
    found = find_light(normals, sample.linear, sample.visibility, up, np.array([0, 0, -1.0]))
    assert np.degrees(np.arccos(found.direction @ scene.light.direction)) < 20
    assert 0.7 < found.strength / scene.light.strength < 1.4


def test_a_picture_without_colours_shows_its_lamp_too() -> None:
    """All of one kind: warnings of a search for several would be errors here."""
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(2000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    up, towards, lamp = np.array([0.0, -1, 0]), np.array([0.0, 0, -1]), np.array([0.6, -0.6, -0.529])
    grey = np.repeat(0.2 * (1 + np.maximum(normals @ lamp, 0))[:, None], 3, axis=1)
    light = find_light(normals, grey, np.ones(2000), up, towards)
    assert np.degrees(np.arccos(light.direction @ lamp)) < 20


def test_a_dark_picture_has_the_usual_lamp() -> None:
    normals = np.tile([0.0, 0, -1], (50, 1))
    up, towards = np.array([0.0, -1, 0]), np.array([0.0, 0, -1])
    light = find_light(normals, np.zeros((50, 3)), np.ones(50), up, towards)
    assert light.direction @ up > 0.5 and light.direction @ towards > 0.5


def test_seen_points_have_the_pictures_colours() -> None:
    scene = photographed("front")
    points = some_points(scene)
    painted = painter_of(scene.body, scene.shots, points).paint(points)
    seen = painted.visibility > 0.95
    assert 0.1 < seen.mean() < 0.5
    assert np.median(np.abs(painted.rgb - truth(scene, points))[seen].mean(axis=1)) < 0.01
    assert not painted.visibility[points.directions(scene.shots[0].normals)[:, 2] > 0.1].any()  # they face away


def test_colours_alone_are_those_of_the_whole_paint() -> None:
    scene = photographed("front")
    points = some_points(scene)
    painter = painter_of(scene.body, scene.shots, points)
    painted = painter.paint(points)
    assert np.abs(painter.colours(points) - painted.rgb).max() < 1e-5
    for some in (painted.visibility == 1, painted.visibility == 0, np.zeros(len(painted.visibility), bool)):
        few = SurfacePoints(points.corners[some], points.weights[some])
        assert np.abs(painter.colours(few) - painted.rgb[some]).max(initial=0) < 1e-5


def test_blocks_on_any_number_of_cores_are_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = photographed("front")
    points = some_points(scene)
    painter = painter_of(scene.body, scene.shots, points)
    whole, found = painter.paint(points), set()
    monkeypatch.setattr("glsplat.extras.authoring.paint.painter._BLOCK_POINTS", len(points.corners) // 3 - 7)
    for count in (1, 3):
        monkeypatch.setattr("glsplat.extras.authoring.compute.threads.cores", lambda count=count: count)
        parts = painter.paint(points)
        for name in ("rgb", "visibility", "detail"):
            assert np.allclose(getattr(parts, name), getattr(whole, name), atol=2e-6)
        found.add(parts.rgb.tobytes() + parts.visibility.tobytes() + parts.detail.tobytes())
    assert len(found) == 1
    assert painter.paint(points.take(slice(0, 0))).rgb.shape == (0, 3)


def test_the_back_is_darker_cloth_not_bright_cloth() -> None:
    scene = photographed("front")
    points = some_points(scene)
    painted = painter_of(scene.body, scene.shots, points).paint(points)
    back = (points.directions(vertex_normals(scene.mesh.vertices, scene.mesh.faces))[:, 2] < -0.5) & (
        points.at(scene.mesh.vertices)[:, 1] < 0.8 * scene.mesh.vertices[:, 1].max()
    )
    right = truth(scene, points)
    error = np.abs(painted.rgb - right)[back].mean(axis=1)
    unlit = paint_without_light(scene, points)
    assert np.median(error) < 0.05
    assert np.median(error) < 0.6 * np.median(np.abs(unlit - right)[back].mean(axis=1))


def paint_without_light(scene: Scene, points: SurfacePoints) -> np.ndarray:
    """The front's colours as they are, at the same place behind."""
    matches = match_to_front(scene.mesh, np.zeros(len(scene.mesh.vertices), bool))
    return to_srgb(matches.colours(scene.shots[0], points).linear)


def test_a_picture_of_the_back_gives_its_colours() -> None:
    scene = photographed("front", "back")
    points = some_points(scene)
    painted = painter_of(scene.body, scene.shots, points).paint(points)
    back = points.directions(scene.shots[0].normals)[:, 2] > 0.6
    assert painted.visibility[back].mean() > 0.8
    assert np.median(np.abs(painted.rgb - truth(scene, points))[back].mean(axis=1)) < 0.02


def test_no_face_on_the_back_of_the_head() -> None:
    """The face's colours must not be carried through the head."""
    scene = photographed("front")
    front = scene.shots[0]
    head = scene.mesh.skeleton.joints[15]
    vertices = scene.mesh.vertices
    mouth = (np.abs(vertices[:, 1] - head[1]) < 0.05) & (vertices[:, 2] > head[2] + 0.03) & (abs(vertices[:, 0]) < 0.05)
    green = front.rgb.copy()
    x, y = front.view.pixels[mouth].round().astype(int).T
    green[y.min() : y.max() + 1, x.min() : x.max() + 1] = (0, 255, 0)
    shot = type(front)(green, front.mask, front.focal, front.view, front.mesh)
    points = some_points(scene)
    painted = painter_of(scene.body, [shot], points).paint(points)
    where = points.at(vertices)
    behind = (where[:, 1] > head[1] - 0.05) & (where[:, 2] < head[2] - 0.02)
    greenness = painted.rgb[:, 1] - painted.rgb[:, [0, 2]].mean(axis=1)
    assert behind.sum() > 20
    assert greenness[painted.visibility > 0.9].max() > 0.8
    assert greenness[behind].max() < 0.1


def test_hands_and_the_farther_cheek_of_a_turned_face_take_no_pixels() -> None:
    scene = photographed("front", "left")
    front, left = (shot.unused for shot in scene.shots)
    hands = hand_shares(scene.body).sum(axis=0)
    assert hands.max() == 1 and np.array_equal(front[hands > 0], hands[hands > 0])
    cheeks = face_vertices(scene.body) & (scene.body.vertices[:, 1] < 0.87)
    near, far = (cheeks & (side * scene.body.vertices[:, 0] > 0.05) for side in (1, -1))
    assert front[near | far].max() < 0.2
    assert not left[near].any() and left[far].mean() > 0.9
    assert not replace(scene.shots[1], face=False).unused[far].any()  # the head's turn is a guess
    camera = scene.shots[0].camera(scene.mesh.skeleton.joints[0], 400)
    pixels = scene.shots[0].unused_pixels(camera)
    assert 0.5 < pixels.sum() / projected(scene, hands > 0.5, camera) < 1.5


def projected(scene: Scene, some: np.ndarray, camera: Camera) -> int:
    """Return the number of pixels of ``some`` vertices' faces."""
    ids = visible_faces(scene.mesh, scene.mesh.posed(Pose(scene.shots[0].view.rotations)), camera)[0]
    return int(some[scene.mesh.faces[ids[ids >= 0]]].all(axis=1).sum())
