"""Fits of participants and of real photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.check.photos import check_photos
from glsplat.extras.authoring.fit.body_fit import FittedView, fit_body
from glsplat.extras.authoring.fit.details import fit_details
from glsplat.extras.authoring.fit.eyes import read_eyes
from glsplat.extras.authoring.fit.face import face_turn
from glsplat.extras.authoring.fit.hands import hand_size
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import find_person
from glsplat.extras.authoring.reconstruct.builtin import PHONE_FOCAL_FACTOR
from glsplat.extras.authoring.segment.mask import person_mask
from glsplat.meshes import vertex_normals
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.captures import Capture, capture, needs_networks

pytestmark = [pytest.mark.shared, pytest.mark.check]


@pytest.mark.parametrize("name", ["11.jpg", "teaserb.jpg", "00000_half.png"])
def test_a_photograph(shared_data: Path, name: str) -> None:
    """11.jpg wears a mask; of the last only a half is seen."""
    needs_networks()
    shot = check_photos(shared_data / "photos" / name)["front"]
    findings = shot.capture.findings
    if name == "00000_half.png":
        assert next(finding.code for finding in findings if finding.refusal) == "cut_off"
        return
    assert not shot.capture.refused
    assert ("face" in [finding.code for finding in findings]) == (name == "11.jpg"), findings
    body, focal = shot.capture.person.body, PHONE_FOCAL_FACTOR * max(shot.photo.picture.shape[:2])
    face = face_turn(open_body(), shot.capture.person.face, focal, shot.photo.picture.shape[1] / 2)
    fit = fit_body([View(shot.capture.mask, body.points, body.visible, focal, world=body.world, face=face)])
    assert fit.problem == "" and fit.views[0].overlap > 0.88


EYES = [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")]
FINGERS = [k for k, name in enumerate(JOINT_NAMES) if name[-1] in "123" and name.startswith(("left", "right"))]


def fingers_off(person: Capture, seen: FittedView) -> float:
    """Mean distance of the fingers' joints in the picture, in percent of the hand's length."""
    true = np.array([person.joint(JOINT_NAMES[k]) for k in FINGERS])
    found = seen.joints[FINGERS]
    pixels = found[:, :2] / found[:, 2:] * person.camera.K[0, 0] + person.camera.K[:2, 2]
    length = 2 * hand_size(person.mesh.skeleton.rest[:, :3, 3]) * person.camera.K[0, 0] / found[:, 2].mean()
    return float(np.linalg.norm(pixels - true, axis=1).mean() / length * 100)


def face_off(person: Capture, seen: FittedView) -> float:
    """Mean distance of the face's skin in the picture, in percent of the distance between the eyes."""
    body = open_body()
    _x, y, z = body.vertices.T
    front = body.skin & (vertex_normals(body.vertices, body.faces)[:, 2] > 0.3) & (y > 0.76) & (y < 0.93) & (z > 0.07)
    true = person.skin()[front]
    pixels = true[:, :2] / true[:, 2:] * person.camera.K[0, 0] + person.camera.K[:2, 2]
    apart = np.linalg.norm(np.subtract(*[person.joint(JOINT_NAMES[eye]) for eye in EYES]))
    return float(np.nanmean(np.linalg.norm(seen.pixels[front] - pixels, axis=1)) / apart * 100)


@pytest.mark.check
@pytest.mark.shared
def test_a_participant() -> None:
    needs_networks()
    person = capture("p20")
    read = find_person(person.picture)
    mask = person_mask(person.picture, read.body)
    view = View(mask, read.body.points, read.body.visible, float(person.camera.K[0, 0]))
    fit = fit_body([view])
    found = fit_details(fit, [view], [read])
    before, after = fit.views[0], found.views[0]
    assert found.problem == "" and after.overlap > before.overlap - 0.004
    assert fingers_off(person, after) < min(4.0, fingers_off(person, before) + 0.5)
    assert face_off(person, after) < min(4.5, 0.75 * face_off(person, before))
    assert all(look.visible for look in read_eyes(person.picture, read.face).values())


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize(("name", "hidden"), [("p07", "right"), ("p08", "left")])
def test_hair_over_an_eye(name: str, hidden: str) -> None:
    needs_networks()
    picture = capture(name).picture
    read = find_person(picture)
    assert {side for side, look in read_eyes(picture, read.face).items() if not look.visible} == {hidden}
