"""The fit finds a body again whose pictures were made from it, and says so where it does not."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.fit import body_fit
from glsplat.extras.authoring.fit.body_fit import BodyFit, fit_body
from glsplat.extras.authoring.fit.landmarks import landmarks
from glsplat.extras.authoring.fit.offsets import offset_directions
from glsplat.extras.authoring.fit.solver import BodySolver
from glsplat.extras.authoring.fit.view import View
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.made_up import FOCAL, SIZE, made, posed_view, slope_error


@lru_cache(maxsize=1)
def plain() -> tuple[View, np.ndarray, float, BodyFit]:
    view, joints, stature = made()
    return view, joints, stature, fit_body([view], stature)


def errors(found: np.ndarray, joints: np.ndarray) -> float:
    """Millimetres, the pelvis held, mean over the body's joints."""
    return float(np.linalg.norm((found - found[0]) - (joints - joints[0]), axis=1)[1:22].mean() * 1000)


def test_derivatives_of_all_equations(rng: np.random.Generator) -> None:
    solver = BodySolver(open_body(), landmarks(), [made()[0], made("back")[0]], None)
    assert slope_error(solver, rng) < 1e-5


def test_a_made_up_person_is_found_again() -> None:
    _, joints, stature, fit = plain()
    assert fit.problem == "" and fit.views[0].overlap > 0.97 and fit.views[0].landmark_error < 0.5
    assert errors(fit.views[0].joints, joints) < 30 and abs(fit.stature / stature - 1) < 0.02
    assert fit.rest.shape == fit.views[0].vertices.shape == open_body().vertices.shape


def test_cloth_of_one_outline_stands_off_to_the_sides_more_than_before_and_behind() -> None:
    body = open_body()
    directions = offset_directions(body, body.vertices)
    thin, thick = (body_fit._hung(body, np.full(len(directions), metres), directions) for metres in (0.01, 0.1))
    belly = np.isin(body.part, [JOINT_NAMES.index(name) for name in ("spine1", "spine2")])
    ahead, aside = (belly & (np.abs(directions[:, axis]) > 0.9) for axis in (2, 0))
    assert ahead.any() and aside.any() and (thin == 0.01).all()
    assert np.median(thick[ahead]) < 0.06 < 0.065 < np.median(thick[aside]) < 0.1
    assert (thick[body.part == JOINT_NAMES.index("left_wrist")] == 0.1).all()


def test_the_end_of_a_picture_is_no_outline() -> None:
    """Soles are 2 cm thicker than those of the bare body, and the picture ends within them."""
    view, posed, _ = posed_view()
    below = len(view.mask) - int(np.flatnonzero(view.mask.any(axis=1))[-1]) - 3  # rows, cut off above as well
    mask = cv2.dilate(view.mask.astype(np.uint8), np.ones((9, 9), np.uint8))[below:-below] > 0
    cut = View(mask, view.landmarks - [0, below], view.visibility, FOCAL)
    rim = body_fit._rim(open_body(), posed, cut, None)
    ends = rim.pixels + rim.normals * rim.gaps[:, None]
    assert len(ends) > 200 and ends[:, 1].max() < len(mask) - 1


def test_the_pose_that_fits_best_with_clothes_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    view, _, _, fit = plain()
    posed, dressed = {"a": 3.0, "b": 1.0, "c": 4.5}, {"a": 4.0, "b": 5.0, "c": 6.0}

    def with_clothes(start: body_fit._Posed, *_: object) -> tuple[BodyFit, float]:
        return replace(fit, problem=str(start.solver)), dressed[str(start.solver)]

    monkeypatch.setattr(body_fit, "stances_of", lambda *_: list(posed))
    monkeypatch.setattr(body_fit, "_posed_from", lambda stance, *_: body_fit._Posed(stance, posed[stance]))
    monkeypatch.setattr(body_fit, "_dressed", with_clothes)
    assert fit_body([view]).problem == "a"


def test_one_wrong_landmark_and_a_hidden_hand() -> None:
    view, joints, stature, fit = plain()
    marks, sure = view.landmarks.copy(), view.visibility.copy()
    marks[25] += (60, -40)  # the left knee
    marks[[16, 18, 20, 22]] += (25, 25)
    sure[[16, 18, 20, 22]] = 0.1
    wrong = fit_body([View(view.mask, marks, sure, FOCAL)], stature)
    assert errors(wrong.views[0].joints, joints) < errors(fit.views[0].joints, joints) + 20


def test_landmarks_of_a_network_that_took_front_for_back() -> None:
    view, _, stature, fit = plain()
    marks = view.landmarks.copy()
    table = landmarks()
    arms = np.isin(table.numbers, range(11, 23))
    marks[table.numbers[arms]] = view.landmarks[table.numbers[table.mirror_rows[arms]]]
    swapped = fit_body([View(view.mask, marks, view.visibility, FOCAL)], stature)
    assert errors(swapped.views[0].joints, fit.views[0].joints) < 1


@pytest.mark.check
def test_front_and_back_share_a_shape() -> None:
    front, joints, stature = made()
    back, behind, _ = made("back")
    fit = fit_body([front, back], stature)
    assert fit.problem == "" and errors(fit.views[1].joints, behind) < 40 and errors(fit.views[0].joints, joints) < 40
    assert fit.views[1].overlap > 0.96


def test_what_is_no_person_is_said() -> None:
    view, _, stature, _ = plain()
    block = np.zeros(SIZE, bool)
    block[60:420, 40:280] = True
    fit = fit_body([View(block, view.landmarks, view.visibility, FOCAL)], stature)
    assert "covers" in fit.problem and "front picture" in fit.problem
