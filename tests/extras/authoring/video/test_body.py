"""The fit of a turning person recovers shape and poses from rough turns."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import BETAS, open_body
from glsplat.extras.authoring.fit import prior
from glsplat.extras.authoring.fit.landmarks import LANDMARK_COUNT, landmarks
from glsplat.extras.authoring.fit.solver import BodySolver, KnownShape
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.video.body import fit_turning, key_views
from tests.extras.authoring.made_up import posed_view, slope_error


def blank(**facing: float | str) -> View:
    return View(np.ones((80, 40), bool), np.zeros((LANDMARK_COUNT, 2)), np.ones(LANDMARK_COUNT), 100.0, **facing)


@pytest.mark.parametrize(
    ("side", "turn", "left", "front"),
    [
        ("front", 0.0, (1, 0, 0), (0, 0, -1)),
        ("right", 90.0, (0, 0, 1), (1, 0, 0)),
        ("back", 180.0, (-1, 0, 0), (0, 0, 1)),
        ("left", -90.0, (0, 0, -1), (-1, 0, 0)),
    ],
)
def test_a_side_is_a_turn(side: str, turn: float, left: tuple[int, ...], front: tuple[int, ...]) -> None:
    view = blank(turn=turn)
    assert view.side == side and blank(side=side).turn == turn
    assert (view.facing == blank(side=side).facing).all()
    assert (view.facing == np.stack([left, (0, -1, 0), front], axis=1)).all()
    assert blank(turn=turn + 40).side == blank(turn=turn - 40 + 360).side == side
    assert np.allclose(np.linalg.det(blank(turn=turn + 33).facing), 1)


def test_derivatives_with_a_known_shape(rng: np.random.Generator) -> None:
    known = KnownShape(rng.normal(0, 1, BETAS), prior.MEAN + 0.1, 0.7)
    solver = BodySolver(open_body(), landmarks(), [posed_view(turn=57.0)[0]], None, known)
    assert (solver.betas == known.betas).all() and (solver.angles(0) == known.angles).all()
    assert slope_error(solver, rng) < 1e-5
    assert solver.camera_height(0) != 0.7  # it is asked for, not set


def test_key_views_are_from_all_around() -> None:
    turns = [170.0, 10.0, 104.0, 355.0, 80.0, 190.0, 260.0]
    assert [turns[key] for key in key_views(turns, 4)] == [355, 80, 170, 260]


@pytest.mark.check
def test_a_turning_person_is_fitted() -> None:
    turns = np.arange(0, 360, 60.0)
    off = np.array([0, 9, -8, 4, -10, 8.0])
    scenes = [posed_view(turn=float(turn), told=float(turn + more)) for turn, more in zip(turns, off, strict=True)]
    size, grows = open_body().stature
    stature = float(size + grows @ scenes[0][2].betas)
    fit = fit_turning([view for view, *_ in scenes], stature)
    assert min(seen.overlap for seen in fit.views) > 0.96 and abs(fit.stature / stature - 1) < 0.01
    for seen, (_, posed, _) in zip(fit.views, scenes, strict=True):
        away = (seen.joints - seen.joints[0]) - (posed.joints - posed.joints[0])
        assert np.linalg.norm(away, axis=1)[1:22].mean() < 0.03
        there = seen.root.T @ posed.frames[0]
        assert abs(np.degrees(np.arctan2(there[0, 2], there[2, 2]))) < 5
