"""Real photographs of people who stand as they like: whole ones are fitted, halves refused in true words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.face import face_turn
from glsplat.authoring.fit.fit import fit_body
from glsplat.authoring.fit.view import View
from glsplat.authoring.networks.people import find_person
from glsplat.authoring.photo.mask import person_mask
from glsplat.authoring.reconstruct.builtin import PHONE
from glsplat.authoring.reconstruct.photos import CheckedPhoto, check_photos
from glsplat.skinning.smplx import JOINT_NAMES
from tests.authoring.captures import capture, needs_networks
from tests.authoring.poses import standing

pytestmark = [pytest.mark.shared, pytest.mark.check]

LEAST, MEDIAN = 0.88, 0.93
ARMS = [f"{side}_{name}" for side in ("left", "right") for name in ("elbow", "wrist")]


@pytest.fixture
def shots(shared_data: Path) -> dict[str, tuple[CheckedPhoto, str]]:
    """Each photograph, and what ought to become of it."""
    needs_networks()
    folder = shared_data / "photos"
    told = json.loads((folder / "photos.json").read_text())
    return {name: (check_photos(folder / name)["front"], facts["expected"]) for name, facts in told.items()}


def test_people_as_they_stand(shots: dict[str, tuple[CheckedPhoto, str]]) -> None:
    overlaps = {}
    for name, (shot, expected) in shots.items():
        findings = shot.capture.findings
        if expected != "avatar":
            code = expected.partition(": ")[2].replace(" ", "_")
            assert [finding.code for finding in findings if finding.refusal][:1] == [code], (name, findings)
            continue
        assert not shot.capture.refused, (name, findings)
        assert ("face" in [finding.code for finding in findings]) == (name == "11.jpg"), (name, findings)  # a mask
        body, focal = shot.capture.person.body, PHONE * max(shot.photo.picture.shape[:2])
        face = face_turn(open_body(), shot.capture.person.face, focal, shot.photo.picture.shape[1] / 2)
        fit = fit_body([View(shot.capture.mask, body.points, body.visible, focal, world=body.world, face=face)])
        overlaps[name] = fit.views[0].overlap
        assert fit.problem == "", name
    assert len(overlaps) == 12 and min(overlaps.values()) > LEAST, overlaps
    assert np.median(list(overlaps.values())) > MEDIAN, overlaps


POSES = {"crossed": 110, "hands on hips": 80, "a hand on the belly": 75, "turned by 45, a hand on the belly": 80}


@pytest.mark.parametrize(("pose", "most"), POSES.items())
def test_made_up_people_who_do_not_pose(pose: str, most: float) -> None:
    """Elbows and wrists in millimetres, the pelvis held; of people that no line was drawn on."""
    needs_networks()
    off = []
    for name in ("p14", "p15"):
        person = capture(name)
        taken = standing(person, pose)
        picture = person.shown(taken)
        read = find_person(picture)
        mask = person_mask(picture, read.body)
        focal = float(person.camera.K[0, 0])
        face = face_turn(open_body(), read.face, focal, picture.shape[1] / 2)
        fit = fit_body([View(mask, read.body.points, read.body.visible, focal, world=read.body.world, face=face)])
        frames = person.mesh.skeleton.forward(taken.rotations, taken.trans)[:, :3, 3]
        true = frames @ person.camera.viewmat[:3, :3].T
        names = person.mesh.skeleton.names
        moved = true[[names.index(joint) for joint in ARMS]] - true[names.index("pelvis")]
        found = fit.views[0].joints
        at = [JOINT_NAMES.index(joint) for joint in ARMS]
        off.append(float(np.linalg.norm(found[at] - found[0] - moved, axis=1).mean() * 1000))
    assert np.mean(off) < most, off
