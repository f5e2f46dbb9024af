"""What avatars cost, and avatars with another number of splats."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.extras.evaluate.costs import costs
from glsplat.extras.evaluate.frames import WARM_UP
from glsplat.extras.evaluate.selftest.driver import resampled
from glsplat.gl.context import Context
from tests.net.legacy.test_legacy import thinned
from tests.scene.people import boxes
from tests.scenes import limb

pytestmark = [pytest.mark.gl, pytest.mark.usefixtures("gl")]

pytest.importorskip("flip_evaluator")


def test_more_and_fewer_splats_cover_the_same_area() -> None:
    avatar = limb(600)
    for count in (100, 600, 1000, 3000):
        other = resampled(avatar, count)
        assert len(other.splats) == len(other.skin) == count
        area = (other.splats.scales[:, 0] * other.splats.scales[:, 1]).sum()
        assert area == pytest.approx((avatar.splats.scales[:, 0] * avatar.splats.scales[:, 1]).sum(), rel=0.25)
        np.testing.assert_allclose(other.splats.means.mean(axis=0), avatar.splats.means.mean(axis=0), atol=0.15)
    assert (resampled(avatar, 900).splats.means == resampled(avatar, 900).splats.means).all()


def test_rows(context: Context) -> None:
    """A row an avatar and size, of what each holds; interleaved, and nothing is left on the context."""
    told: list[None] = []
    figures = {"splats": thinned(default_avatar(), 100), "mesh": boxes()}
    with context:
        rows = costs(context, figures, sizes=(32, 48), frames=3, tick=lambda: told.append(None))
    by_size = {(row["method"], row["size"]): row["bytes"] for row in rows}
    assert list(by_size) == [("splats", 32), ("mesh", 32), ("splats", 48), ("mesh", 48)]
    assert len(told) == 2 * 2 * (WARM_UP + 3)
    for row in rows:
        figure = figures[row["method"]]
        expected = ("triangles", len(figure.faces)) if row["method"] == "mesh" else ("splats", len(figure.splats))
        assert (row["kind"], row["count"]) == expected and row["bytes"] > 1000
        assert row["pair_ms"] > 0 and row["two_ms"] > 0 and row["in_turn_ms"] > 0
        assert row["gain"] == pytest.approx(row["two_ms"] / row["pair_ms"], abs=1e-3) and "paper" not in row
    assert by_size["mesh", 48] > by_size["mesh", 32]  # its targets grow, a splat's records do not
