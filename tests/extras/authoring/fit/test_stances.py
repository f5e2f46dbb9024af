"""Arms that lie over the trunk are found on the side where they are, and say nothing of the trunk's outline."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import BETAS, open_body
from glsplat.extras.authoring.body.segments import arm_layers, forearms
from glsplat.extras.authoring.fit.body_fit import BodyFit, fit_body, fit_clothes
from glsplat.extras.authoring.fit.kinematics import PLACE, PosedBody
from glsplat.extras.authoring.fit.limbs import LIMBS, before_trunk, distance_to_arms, hidden_arms, limb_uncertainty
from glsplat.extras.authoring.fit.offsets import offset_directions
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.prior import HINGES
from glsplat.extras.authoring.fit.solver import BodySolver
from glsplat.extras.authoring.fit.stances import stances_of, trusted_world
from glsplat.extras.authoring.fit.view import View
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.made_up import FOCAL, posed_view

ARMS = [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in ("elbow", "wrist")]

BELLY = {("left_shoulder", 2): -1.15, ("left_shoulder", 1): -0.2, ("left_elbow", 1): -1.5}
OVER = BELLY | {("left_shoulder", 1): -0.6}  # all of the forearm is before the trunk
CROSSED = OVER | {("left_shoulder", 0): 0.8, ("left_elbow", 1): -2.0}
CROSSED |= {
    (joint.replace("left", "right"), axis): -angle if axis else angle for (joint, axis), angle in CROSSED.items()
}
# the hand lies on the small of the back
BACK = {("left_shoulder", 2): -1.3, ("left_shoulder", 1): 0.9, ("left_shoulder", 0): 1.5, ("left_elbow", 1): -1.4}
DOWN = {("left_shoulder", 2): -1.4, ("right_shoulder", 2): 1.4, ("left_elbow", 1): -0.1, ("right_elbow", 1): 0.1}


def blind(view: View) -> View:
    """The view without its metres."""
    return View(view.mask, view.landmarks, view.visibility, view.focal, turn=view.turn)


def arms_off(fit: BodyFit, posed: PosedBody) -> float:
    """Millimetres, the pelvis held, mean over elbows and wrists."""
    found = fit.views[0].joints
    return float(np.linalg.norm((found - found[0] - posed.joints + posed.joints[0])[ARMS], axis=1).mean() * 1000)


def surface(posed: PosedBody) -> tuple[np.ndarray, np.ndarray]:
    where = posed.points(open_body().points(np.arange(len(open_body().vertices))))
    return where, where[:, :2] / where[:, 2:] * FOCAL + (160, 240)


def test_a_hand_on_the_belly() -> None:
    view, posed, _ = posed_view(bent=BELLY)
    fit = fit_body([view], 1.7)
    assert fit.problem == "" and fit.views[0].overlap > 0.97
    assert arms_off(fit, posed) < 35  # millimetres; above 150 without metres
    assert set(fit.views[0].uncertainty) == set(LIMBS) and max(fit.views[0].uncertainty.values()) < 0.3


@pytest.mark.check
def test_sleeves_of_crossed_arms_keep_the_shoulders_wide() -> None:
    view, posed, _ = posed_view(bent=CROSSED)
    marks = view.landmarks.copy()
    marks[[13, 14], 1] += 14  # 6.5 cm; a network has the elbows of crossed arms so much too low
    worn = view.mask | (distance_to_arms(open_body(), surface(posed)[1], view.mask.shape) <= 4)
    fit = fit_body([View(worn, marks, view.visibility, FOCAL, world=view.world)], 1.7)

    def width(joints: np.ndarray) -> float:
        left, right = (joints[JOINT_NAMES.index(f"{side}_shoulder")] for side in ("left", "right"))
        return float(np.linalg.norm(left - right))

    assert width(fit.views[0].joints) == pytest.approx(width(posed.joints), abs=0.008)  # 0.013 with others' sleeves


@pytest.mark.parametrize(("bent", "crossed"), [(CROSSED, True), (OVER, False), (DOWN, False), ({}, False)])
def test_only_crossed_arms_are_taken_by_their_sleeves(bent: dict[tuple[str, int], float], crossed: bool) -> None:
    posed, *others = stances_of(posed_view(bent=bent)[0], open_body())
    assert [stance.sleeve > posed.sleeve for stance in others] == [crossed, crossed]


def test_metres_turn_the_person() -> None:
    view, _, _ = posed_view(turn=35, told=0, bent=DOWN)
    read = next(stance for stance in stances_of(view, open_body()) if stance.name == "read")
    assert abs(np.degrees(read.turn)) == pytest.approx(35, abs=9)


def test_without_metres_there_is_one_stance() -> None:
    view = posed_view()[0]
    assert [stance.name for stance in stances_of(blind(view), open_body())] == ["posed"]
    assert [stance.name for stance in stances_of(view, open_body())] == ["posed", "read", "like others"]


def test_metres_that_take_the_front_for_another_side_are_not_believed() -> None:
    view = posed_view()[0]
    assert view.world is not None and trusted_world(view) is view.world and trusted_world(blind(view)) is None
    behind = view.world * (-1.0, 1.0, -1.0)  # the network saw a back
    wrong = View(view.mask, view.landmarks, view.visibility, view.focal, world=behind)
    assert trusted_world(wrong) is None
    assert [stance.name for stance in stances_of(wrong, open_body())] == ["posed", "at ease"]


def test_forearms_that_are_seen_may_not_be_as_deep_as_the_trunk() -> None:
    body, seen = open_body(), np.array([1.0, 0.2])
    before, behind = (surface(posed_view(bent=bent)[1]) for bent in (OVER, BACK))
    vertices, depths = before_trunk(body, *before, FOCAL, (480, 320), seen)
    assert len(vertices) > 10 and (arm_layers(body)[vertices] == 1).all() and forearms(body)[vertices].all()
    assert (before[0][vertices, 2] < depths).mean() > 0.9
    vertices, depths = before_trunk(body, *behind, FOCAL, (480, 320), seen)
    assert (behind[0][vertices, 2] > depths).mean() > 0.9
    assert not len(before_trunk(body, *before, FOCAL, (480, 320), 0 * seen)[0])


def test_an_arm_that_is_too_deep_comes_forward_and_the_body_stays() -> None:
    solver = posed_view(bent=BACK)[2]
    deep = surface(solver.posed(0))
    vertices, depths = before_trunk(open_body(), *deep, FOCAL, (480, 320), np.array([1.0, 0.0]))
    x = solver.x.copy()
    bare = solver._rows(x, True)
    solver.keep_in_front(0, vertices, depths)
    residual, slope = solver._rows(x, True)
    pushed = len(bare[0])
    assert residual[pushed:].max() > 0.1 and (residual[pushed:] >= 0).all()
    step = 1e-6
    moved = np.abs(slope[pushed:]).sum(axis=0) > 0
    assert {solver_name(solver, index) for index in np.flatnonzero(moved)} <= {"left_shoulder", "left_elbow"}
    for index in np.flatnonzero(moved):
        there = x.copy()
        there[index] += step
        change = (solver._rows(there, False)[0] - residual)[pushed:] / step
        assert np.allclose(change, slope[pushed:, index], atol=1e-3 * np.abs(slope[pushed:]).max())


def solver_name(solver: BodySolver, index: int) -> str:
    """The joint of an unknown, or nothing where it is none's."""
    return HINGES.names[index - BETAS - PLACE][0] if index >= BETAS + PLACE else ""


def test_hidden_arms() -> None:
    for bent, least, most in ((BELLY, 0.0, 0.25), (BACK, 0.5, 1.0), (DOWN, 0.0, 0.2)):
        posed = posed_view(bent=bent)[1]
        left, right = hidden_arms(open_body(), *surface(posed), FOCAL, (480, 320))
        assert least <= left <= most and right < 0.2, bent


def test_what_is_held_dresses_no_hip() -> None:
    """A ball between the hand and the hip."""
    body, bent = open_body(), {("left_shoulder", 2): -1.35, ("left_elbow", 1): -0.2}
    view, posed, _ = posed_view(bent=bent)
    _, pixels = surface(posed)
    hand = pixels[body.part == JOINT_NAMES.index("left_wrist")].mean(axis=0)
    side = pixels[(arm_layers(body) == 0) & (np.abs(pixels[:, 1] - hand[1]) < 6)][:, 0].max()
    y, x = np.mgrid[: view.mask.shape[0], : view.mask.shape[1]] + 0.5
    ball = (x - side - 6) ** 2 + ((y - hand[1]) * 0.6) ** 2 < 8**2
    bare, _ = body.shaped(posed.betas)
    plain, held = (
        fit_clothes(body, bare, [posed], [View(mask, view.landmarks, view.visibility, FOCAL)])
        for mask in (view.mask, view.mask | ball)
    )
    near = (arm_layers(body) == 0) & (np.linalg.norm(pixels - (side, hand[1]), axis=1) < 20)
    assert near.sum() > 20 and np.abs(held - plain)[near].max() < 0.012  # metres; 0.065 where a ball is cloth


def test_cloth_between_an_arm_and_the_trunk_is_the_trunks() -> None:
    """Three centimetres of cloth about the waist of somebody whose arms hang close beside it."""
    body = open_body()
    view, posed, _ = posed_view(bent=DOWN | {("left_shoulder", 2): -1.47, ("right_shoulder", 2): 1.47})
    bare, _ = body.shaped(posed.betas)
    waist = (arm_layers(body) == 0) & body.skin & (np.abs(body.vertices[:, 1] - 0.1) < 0.12)
    cloth = 0.03 * waist[:, None] * offset_directions(body, bare)
    where = posed.points(body.points(np.arange(len(bare)), cloth))
    worn = projected_mask(where[:, :2] / where[:, 2:] * FOCAL + (160, 240), body.faces, view.mask.shape)
    offsets = fit_clothes(body, bare, [posed], [View(view.mask | worn, view.landmarks, view.visibility, FOCAL)])
    flank = waist & (np.abs(body.vertices[:, 0]) > 0.9 * np.abs(body.vertices[waist, 0]).max())
    assert flank.sum() > 10 and 0.013 < np.median(offsets[flank]) < 0.035  # 0.010 where it is nobody's


def test_doubts_by_limb() -> None:
    view, _, _ = posed_view(bent=DOWN)
    dim = view.visibility.copy()
    dim[[14, 16]] = 0.9, 0.2  # the right elbow and wrist
    found = limb_uncertainty(View(view.mask, view.landmarks, dim, FOCAL), (0.1, 0.0))
    assert found == pytest.approx({"head": 0, "left arm": 0.1, "right arm": 0.8, "left leg": 0, "right leg": 0})


@pytest.mark.check
def test_legs_that_are_not_seen_are_a_problem() -> None:
    view, _, _ = posed_view()
    sure = view.visibility.copy()
    sure[27:33] = 0.1
    assert (
        fit_body([View(view.mask, view.landmarks, sure, FOCAL)]).problem == "the legs are not seen in the front picture"
    )
