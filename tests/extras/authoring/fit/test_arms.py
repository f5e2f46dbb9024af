"""Priors of arms and of where people look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.fit.face import face_turn
from glsplat.extras.authoring.fit.landmarks import landmarks
from glsplat.extras.authoring.fit.prior import HINGES, MEAN, POSED, SPREAD, ArmMixture, PosePrior, arm_mixture
from glsplat.extras.authoring.fit.solver import BodySolver
from glsplat.extras.authoring.fit.stances import stances_of
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import find_person
from glsplat.rotations import rotation_matrices
from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import capture, needs_networks
from tests.extras.authoring.made_up import FOCAL, posed_view, slope_error

LEFT = [HINGES.names.index(name) for name in (*(("left_shoulder", k) for k in range(3)), ("left_elbow", 1))]
RIGHT = [HINGES.names.index((HINGES.names[k][0].replace("left", "right"), HINGES.names[k][1])) for k in LEFT]


def test_arms_are_known_by_their_bones(rng: np.random.Generator) -> None:
    arms = rng.normal((0.1, -0.3, -1.0, -1.2), 0.3, (20, 4))
    frames = rotation_matrices(arms[:, :3])
    bent = rotation_matrices(np.column_stack([np.zeros(20), arms[:, 3], np.zeros(20)]))
    upper, fore = frames[..., 0], (frames @ bent)[..., 0]
    assert np.allclose(ArmMixture.angles_of(upper * 0.3, fore * 0.25), arms, atol=1e-6)
    straight = ArmMixture.angles_of(upper, upper)
    assert np.allclose(straight[:, 3], 0, atol=1e-6) and np.allclose(rotation_matrices(straight[:, :3])[..., 0], upper)


def test_each_arm_is_of_the_kind_that_it_is_most_like() -> None:
    mixture = arm_mixture()
    stance = PosePrior("like others", MEAN, SPREAD, arms=mixture)
    angles = MEAN.copy()
    angles[LEFT], angles[RIGHT] = mixture.means[0], mixture.means[2] * (1, -1, -1, -1)
    mean, factor = stance.near(angles)
    assert np.allclose(mean[LEFT], mixture.means[0]) and np.allclose(mean[RIGHT], mixture.means[2] * (1, -1, -1, -1))
    others = np.setdiff1d(np.arange(len(MEAN)), [*LEFT, *RIGHT])
    assert np.allclose(mean[others], MEAN[others]) and np.allclose(
        factor[others][:, others], np.diag(1 / SPREAD[others])
    )
    off = np.array([0.1, -0.2, 0.3, 0.2])
    for columns, signs in ((LEFT, np.ones(4)), (RIGHT, np.array([1.0, -1, -1, -1]))):
        moved = angles.copy()
        moved[columns] += off * signs
        level = ((factor @ (moved - mean)) ** 2).sum() - ((factor @ (angles - mean)) ** 2).sum()
        kind = 0 if columns is LEFT else 2
        assert level == pytest.approx(off @ np.linalg.inv(mixture.covariances[kind]) @ off)
    assert (POSED.near(angles)[0] == MEAN).all()


def test_derivatives_of_arms(rng: np.random.Generator) -> None:
    view = posed_view()[0]
    seen = View(view.mask, view.landmarks, view.visibility, FOCAL, world=view.world)
    for stance in stances_of(seen, open_body()):
        solver = BodySolver(open_body(), landmarks(), [seen], None, stance=stance)
        assert slope_error(solver, rng) < 1e-5, stance.name


def turns(turn: float, face: float | None, told: float = 0.0) -> list[float]:
    """Degrees from what is told that somebody who has turned is taken to be turned by, a number each stance."""
    view = posed_view(turn=turn, told=told, bent={("left_shoulder", 2): -1.4, ("right_shoulder", 2): 1.4})[0]
    seen = View(view.mask, view.landmarks, view.visibility, FOCAL, turn=told, world=view.world, face=face)
    return [-float(np.degrees(stance.turn)) for stance in stances_of(seen, open_body())]


def test_a_face_puts_right_where_the_person_is_turned() -> None:
    straight, turned = turns(6, None), turns(32, None)
    assert straight[0] == turned[0] == 0 and straight[1] == straight[2] and turned[1] == turned[2]
    metres, far = straight[1], turned[1]
    assert turns(6, metres - 8)[1] == pytest.approx(metres - 4)  # between both
    assert turns(6, metres + 40)[1] == metres  # a head that looks aside
    assert turns(32, far + 8)[1] == pytest.approx(far + 8)  # nobody looks past the camera
    assert turns(32, far - 8)[1] == pytest.approx(far - 4)
    about = turns(6, metres - 8, told=10)[1]
    assert about == pytest.approx(metres - 10 - 4, abs=1.5)  # turns are from what the view says


@pytest.mark.check
@pytest.mark.shared
def test_the_turn_of_a_face() -> None:
    """Within six degrees, and relative to the camera's principal point."""
    needs_networks()
    body, person = open_body(), capture("p18")
    turned = np.zeros_like(person.pose)  # arms hang
    for joint, turn in (
        ("pelvis", (0, np.pi / 6, 0)),
        ("left_shoulder", (0, 0, -1.4)),
        ("right_shoulder", (0, 0, 1.4)),
    ):
        turned[person.mesh.skeleton.names.index(joint)] = turn
    taken = Pose(turned, person.trans)
    front = person.camera.viewmat[:3, :3] @ person.mesh.skeleton.forward(taken.rotations, taken.trans)[0, :3, 2]
    read = find_person(person.shown(taken))
    focal, middle = float(person.camera.K[0, 0]), person.camera.width / 2
    found = face_turn(body, read.face, focal, middle)
    assert found == pytest.approx(float(np.degrees(np.arctan2(front[0], -front[2]))), abs=6)
    aside = face_turn(body, read.face, focal, middle - focal * np.tan(np.radians(10)))
    assert found is not None and aside is not None and found - aside == pytest.approx(10, abs=0.6)
    assert face_turn(body, replace(read.face, presence=0.5), focal, middle) is None
