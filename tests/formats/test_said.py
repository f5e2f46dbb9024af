"""save() says what it loses, and what was never drawn is not drawn out of any file."""

from __future__ import annotations

import io
import logging
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat.formats import FORMATS, losses
from tests.scenes import limb

WRITTEN = [known.name for known in FORMATS if known.save]
PARTS: dict[str, Any] = {
    "means": [[0.0, 0, 0], [0.5, 0, 0]],
    "quats": [[1.0, 0, 0, 0]] * 2,
    "scales": [[0.1, 0.1, 0.1]] * 2,
    "opacities": [0.9, 0.8],
    "sh": np.zeros((2, 1, 3)),
}
BROKEN = [(name, value) for name in PARTS for value in (np.nan, np.inf, -np.inf)] + [("quats", 0.0)]


def seen(splats: glsplat.Splats) -> int:
    """How many the renderer draws and anybody sees."""
    return int((splats.finite() & splats.quats.any(axis=1) & (splats.opacities > 0)).sum())


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize(("part", "value"), BROKEN)
def test_what_is_never_drawn_is_not_drawn_out_of_a_file(name: str, part: str, value: float) -> None:
    parts = {key: np.array(array, np.float32) for key, array in PARTS.items()}
    parts[part][0] = value
    splats = glsplat.Splats(**parts)
    assert seen(splats) == 1
    file, said = io.BytesIO(), []
    glsplat.save(splats, file, format=name, say=said.append)
    file.seek(0)
    again = glsplat.load(file, format=name)
    assert isinstance(again, glsplat.Splats) and seen(again) == 1
    kept = len(again) == 2 and all(
        np.array_equal(np.isfinite(a), np.isfinite(b)) for a, b in zip(splats.arrays, again.arrays, strict=True)
    )
    assert kept or any("never drawn" in one or "none is drawn" in one for one in said), said


def test_save_says_it_in_the_log_unless_somebody_listens(caplog: pytest.LogCaptureFixture) -> None:
    avatar = limb()
    for name in WRITTEN:
        file, told = io.BytesIO(), []
        caplog.clear()
        with caplog.at_level(logging.WARNING, "glsplat.formats"):
            glsplat.save(avatar, file, format=name)
        expected = list(losses(avatar, file, format=name))
        assert [record.getMessage() for record in caplog.records] == [f"<BytesIO>: {one}" for one in expected], name
        assert all("\n" not in one for one in expected)
        caplog.clear()
        glsplat.save(avatar, io.BytesIO(), format=name, say=told.append)
        assert told == expected and not caplog.records
    assert any("rig" in one for one in losses(avatar, "a.ply"))


@pytest.mark.parametrize("thing", [glsplat.Item(limb()), glsplat.Scene([glsplat.Item(limb())]), None, 5, "a.ply"])
def test_what_is_no_scene_is_refused_in_one_line(thing: Any) -> None:
    file = io.BytesIO()
    for call in (lambda: glsplat.save(thing, file, format="ply"), lambda: list(losses(thing, "a.glb"))):
        with pytest.raises(glsplat.GlsplatError, match="Splats or Avatar or RiggedMesh, not") as caught:
            call()
        assert "\n" not in str(caught.value)
    assert not file.getvalue()
