"""What leaving out hidden splats costs is found by looking: cones that hide too much are seen to fail."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.evaluate.knobs import base_config, settings_of
from glsplat.evaluate.sections.hidden import Search, hidden, hidden_cost, with_hidden
from glsplat.evaluate.subjects import Subject
from glsplat.gl.context import Context
from glsplat.splats import Splats
from tests.scenes import camera, cloud

pytest.importorskip("flip_evaluator")
pytestmark = [pytest.mark.gl, pytest.mark.usefixtures("gl")]

QUICK = Search(sizes=(48,), frames=3, moments=1, around=4, elevations=(0.0,), size=48)


def front_and_back(cosine: int) -> Splats:
    """Two large discs back to back, each to be seen only from its own side: axis +-z, smallest cosine / 127."""
    return Splats.create(
        [[0, 0, 0.05], [0, 0, -0.05]],
        [[1.0, 0, 0, 0]] * 2,
        [[0.5, 0.5, 0.001]] * 2,
        [1.0, 1.0],
        rgb=[[1, 0, 0], [0, 0, 1]],
        cones=np.array([[0, 0, 127, cosine], [0, 0, -127, cosine]], np.int8),
    )


def test_good_cones_cost_little_and_bad_ones_are_found(context: Context) -> None:
    good, bad = (Subject(f"discs {c}", front_and_back(c), 48) for c in (-70, 126))
    plain = Subject("plain", cloud(20), 48)
    given = Subject("given", front_and_back(0), 48, cameras=(camera(48),))
    assert with_hidden([plain, good, given, bad]) == [good, bad]
    done: list[float] = []
    rows, pictures = hidden(context, [good, bad], QUICK, done.append)
    assert sum(done) == pytest.approx(hidden_cost([good, bad], QUICK))
    first, second = rows
    assert first["worst"]["pictures"] == 4 and first["price"][0]["drawn"] == 0.5
    # the far disc shines through the last hundredth of the near one
    assert first["worst"]["psnr"] > 40 > 25 > second["worst"]["psnr"]
    assert "degrees" in second["worst"]["where"] and pictures["discs 126"].shape == (48, 96, 4)
    left, complete = np.split(pictures["discs 126"], 2, axis=1)
    assert complete.max() > 0.5 and np.abs(left - complete).max() > 0.5


def test_the_knob_is_there_with_cones_only(context: Context) -> None:
    base = base_config(context)
    labels = [s.label for s in settings_of(Subject("a", front_and_back(0), 32), base) if s.knob == "hidden splats"]
    assert labels == ["drawn", "margin -0.1", "margin 0", "margin 0.1", "margin 0.2"]
    assert "hidden splats" not in {s.knob for s in settings_of(Subject("b", cloud(20), 32), base)}
