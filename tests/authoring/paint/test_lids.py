"""Lids have no eye painted on them."""

from __future__ import annotations

import cv2
import numpy as np

from glsplat.authoring.faces.open_face import open_face
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.eyes import EyeLook, eyeball
from glsplat.authoring.paint.lids import lids_of, within_eyes
from glsplat.authoring.paint.paint import painter_of
from glsplat.authoring.paint.scatter import even_points
from glsplat.authoring.paint.shot import SurfacePoints
from tests.authoring.paint.scene import photographed


def test_lids_are_what_a_blink_moves_most() -> None:
    body, lids, blinks = open_body(), lids_of(), open_face().expressions
    assert body.skin[lids].all()
    for name in ("eyeBlinkLeft", "eyeBlinkRight"):
        number = blinks.names.index(name)
        some = slice(blinks.starts[number], blinks.starts[number + 1])
        far = np.linalg.norm(blinks.offsets[some], axis=1)
        most = blinks.vertices[some][far > 0.5 * far.max()]
        assert len(most) > 20 and lids[most][body.skin[most]].mean() > 0.9


def test_an_eyes_colours_do_not_lie_on_closed_lids() -> None:
    """The picture shows wide open blue eyes where the fitted face has its lids."""
    scene = photographed("front")
    shot, lids = scene.shots[0], lids_of() & (scene.shots[0].trust > 0.5)
    rgb, looks = shot.rgb.copy(), {}
    for side in ("left", "right"):
        ball = shot.view.pixels[eyeball(scene.body, side).vertices]
        low, high = ball.min(axis=0), ball.max(axis=0)
        turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        outline = (low + high) / 2 + 0.5 * (high - low) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        eye = (low + high) / 2 + 0.7 * (outline - (low + high) / 2)  # pixels at the lids' edges are mixed
        cv2.fillConvexPoly(rgb, np.round(eye).astype(np.int32), (0, 0, 255))
        grey = np.full(3, 128.0)
        looks[side] = EyeLook(True, (low + high) / 2, 2.0, grey, grey, outline)
    shot = type(shot)(rgb, shot.mask, shot.focal, shot.view, shot.mesh)
    points = even_points(scene.mesh, 20_000)
    corners = np.flatnonzero(lids & (within_eyes(looks, shot.view.pixels) == 1))
    there = SurfacePoints(np.repeat(corners[:, None], 3, axis=1), np.full((len(corners), 3), 1 / 3))
    blue = []
    for given in ({}, looks):
        colours = painter_of(scene.body, [shot], points, given).colours(there)
        blue.append(float((colours[:, 2] - colours[:, :2].max(axis=1) > 0.3).mean()))
    assert blue[0] > 0.3 and blue[1] < 0.1, blue
    assert within_eyes(looks, np.zeros((3, 2))).tolist() == [0, 0, 0]
