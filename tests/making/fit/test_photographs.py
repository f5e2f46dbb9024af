"""Real photographs of people who stand as they like: whole ones are fitted, halves refused in true words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.making.fit.fit import fit_body
from glsplat.making.fit.view import View
from glsplat.making.reconstruct.builtin import PHONE
from glsplat.making.reconstruct.photos import Shot, check_photos
from tests.making.captures import needs_networks

pytestmark = pytest.mark.shared

LEAST, MEDIAN = 0.88, 0.93


@pytest.fixture
def shots(shared_data: Path) -> dict[str, tuple[Shot, str]]:
    """Each photograph, and what ought to become of it."""
    needs_networks()
    folder = shared_data / "photos"
    told = json.loads((folder / "photos.json").read_text())
    return {name: (check_photos(folder / name)["front"], facts["expected"]) for name, facts in told.items()}


def test_people_as_they_stand(shots: dict[str, tuple[Shot, str]]) -> None:
    overlaps = {}
    for name, (shot, expected) in shots.items():
        findings = shot.capture.findings
        if expected != "avatar":
            code = expected.partition(": ")[2].replace(" ", "_")
            assert [finding.code for finding in findings if finding.refusal][:1] == [code], (name, findings)
            continue
        assert not shot.capture.refused, (name, findings)
        assert shot.capture.person is not None
        body, focal = shot.capture.person.body, PHONE * max(shot.photo.picture.shape[:2])
        fit = fit_body([View(shot.capture.mask, body.points, body.visible, focal, world=body.world)])
        overlaps[name] = fit.views[0].overlap
        assert fit.problem == "", name
    assert len(overlaps) == 12 and min(overlaps.values()) > LEAST, overlaps
    assert np.median(list(overlaps.values())) > MEDIAN, overlaps
