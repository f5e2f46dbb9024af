"""A participant on a turntable becomes a mesh, or splats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.fit.body_fit import BodyFit
from glsplat.extras.authoring.optimize.target_pictures import ViewConfig
from glsplat.extras.authoring.reconstruct import video
from glsplat.extras.authoring.reconstruct.reconstructor import Options
from glsplat.extras.authoring.reconstruct.video import from_pictures, from_video, reconstruct_frames
from glsplat.extras.evaluate.turntable import turntable
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import capture, needs_networks
from tests.extras.authoring.optimize.test_photo_fit import FEW


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match='made as mesh or splats, not "cloud"'):
        reconstruct_frames([], form="cloud")
    with pytest.raises(FormatError, match="a turn needs 8 to 120 frames, not 2"):
        from_video(tmp_path / "a.mp4", frames=2)
    with pytest.raises(FormatError, match=r"a\.mp4: .*No such file"):
        from_video(tmp_path / "a.mp4")


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.timeout(1200)
def test_a_participant_on_a_turntable(monkeypatch: pytest.MonkeyPatch) -> None:
    needs_networks()
    fits: list[BodyFit] = []  # the mesh and the splats are of one
    whole = video.fit_turning
    monkeypatch.setattr(video, "fit_turning", lambda *words: fits[0] if fits else fits.append(whole(*words)) or fits[0])
    person = capture("p01")
    camera = person.camera.resized(round(0.6 * person.camera.width), round(0.6 * person.camera.height))
    lamp = person.light["direction_to"], person.light["colour"]
    shown = list(turntable(person.mesh, camera, Pose(person.pose, person.trans), *lamp, frames=12, turns=1, seed=1))
    pictures = [(f"frame {index}", frame.rgb, None) for index, frame in enumerate(shown)]
    made = from_pictures(pictures, in_order=True, options=Options(height=1.66, texture=512), anyway=True)
    assert made.problem == "" and made.left_out == () and len(made.frames) == 12
    assert np.mean([seen.overlap for seen in made.fit.views]) > 0.955 and abs(made.fit.stature - 1.66) < 0.03
    assert made.unseen < 0.1 and isinstance(made.content, RiggedMesh)
    assert made.content.meta["source"] == "12 pictures of a turn" and made.content.meta["unseen"] == round(
        made.unseen, 4
    )
    true = np.array([shown[int(frame.name.split()[1])].turn for frame in made.frames])
    told = np.array([frame.turn for frame in made.frames])
    assert np.abs((told - true + 180) % 360 - 180).max() < 25 and abs((told[0] + 180) % 360 - 180) < 20
    for name, value in FEW.items():
        monkeypatch.setitem(ViewConfig.__init__.__kwdefaults__, name, value)
    again = reconstruct_frames(made.frames, options=Options(height=1.66, splats=2000, steps=1), form="splats")
    assert 1980 < len(again.content.splats) <= 2000
