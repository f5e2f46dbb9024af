"""A participant on a turntable becomes a mesh that looks like them in poses that no frame shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.authoring.fit.fit import BodyFit
from glsplat.authoring.optimize.pictures import ViewConfig
from glsplat.authoring.reconstruct import video
from glsplat.authoring.reconstruct.reconstructor import Options
from glsplat.authoring.reconstruct.video import from_video, reconstruct_frames
from glsplat.errors import FormatError
from glsplat.meshes import RiggedMesh
from tests.authoring.captures import needs_networks
from tests.authoring.filmed import cameras_of, compared, drawn, filmed
from tests.authoring.reconstruct.test_sharp import FEW


def test_what_nobody_can_want(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match='made as mesh or splats, not "cloud"'):
        reconstruct_frames([], form="cloud")
    with pytest.raises(FormatError, match="a turn needs 8 to 120 frames, not 2"):
        from_video(tmp_path / "a.mp4", frames=2)
    with pytest.raises(FormatError, match=r"a\.mp4: .*No such file"):
        from_video(tmp_path / "a.mp4")


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.timeout(1200)
def test_a_participant_on_a_turntable(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_networks()
    fits: list[BodyFit] = []  # the mesh and the splats are of one
    whole = video.fit_turning
    monkeypatch.setattr(video, "fit_turning", lambda *words: fits[0] if fits else fits.append(whole(*words)) or fits[0])
    filming = filmed("p01", frames=12, scale=0.6, texture=512)
    made = filming.made
    assert made.problem == "" and made.left_out == () and len(made.frames) == 12
    assert filming.overlap() > 0.955 and filming.joints() < 35 and abs(made.fit.stature - 1.66) < 0.03
    assert made.unseen < 0.1 and isinstance(made.thing, RiggedMesh)
    assert made.thing.meta["source"] == "12 pictures of a turn" and made.thing.meta["unseen"] == round(made.unseen, 4)
    true = np.array([filming.frames[int(frame.name.split()[1])].turn for frame in made.frames])
    told = np.array([frame.turn for frame in made.frames])
    assert np.abs((told - true + 180) % 360 - 180).max() < 25 and abs((told[0] + 180) % 360 - 180) < 20
    cameras = {key: camera for key, camera in cameras_of(filming.person.mesh).items() if key[0] == "stride"}
    truth, pictures = (list(drawn(thing, cameras)) for thing in (filming.person.mesh, made.thing))
    level, overlap = compared(truth, pictures)
    assert level > 18.5 and overlap > 0.85
    for name, value in FEW.items():
        monkeypatch.setitem(ViewConfig.__init__.__kwdefaults__, name, value)
    again = reconstruct_frames(made.frames, options=Options(height=1.66, splats=2000, steps=1), form="splats")
    assert 1980 < len(again.thing.splats) <= 2000
