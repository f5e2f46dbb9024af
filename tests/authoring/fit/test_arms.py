"""What is known of how people hold their arms and where they look, and what the fit makes of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.face import face_turn
from glsplat.authoring.fit.landmarks import landmarks
from glsplat.authoring.fit.prior import HINGES, MEAN, POSED, SPREAD, PosePrior
from glsplat.authoring.fit.solver import BodySolver
from glsplat.authoring.fit.standing.arms import ArmMixture, arm_mixture
from glsplat.authoring.fit.standing.stances import stances_of
from glsplat.authoring.fit.view import View
from glsplat.authoring.networks.people import find_person
from glsplat.errors import FormatError
from glsplat.rotations import rotation_matrices
from tests.authoring.captures import capture, needs_networks
from tests.authoring.made_up import FOCAL, posed_view, slope_error
from tests.authoring.poses import standing
from tools.data.arms import HELD_BACK, arms_of, learned, with_others, write_mixture

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


def test_the_mixture_is_one() -> None:
    mixture = arm_mixture()
    assert mixture.shares.sum() == pytest.approx(1) and len(mixture.shares) == 9
    assert (np.linalg.eigvalsh(mixture.spreads) > 0.01).all()
    steps = np.linalg.cholesky(mixture.spreads)
    assert np.allclose(mixture.factors @ steps, np.eye(4))
    hanging, behind_the_head = np.array([[0.0, 0.0, -1.4, -0.3]]), np.array([[2.0, 2.0, 1.5, -0.1]])
    assert np.logaddexp.reduce(mixture.levels(hanging)[0]) > np.logaddexp.reduce(mixture.levels(behind_the_head)[0]) + 8


def test_two_kinds_are_learned_apart(rng: np.random.Generator, tmp_path: Path) -> None:
    kinds = np.array([[0.0, 0.0, -1.4, -0.2], [0.5, -0.5, -0.8, -2.0]])
    arms = np.concatenate([rng.normal(mean, 0.1, (count, 4)) for mean, count in zip(kinds, (300, 100), strict=True)])
    found = learned(arms, 2)
    order = np.argsort(-found.shares)
    assert np.allclose(found.shares[order], (0.75, 0.25), atol=0.01)
    assert np.allclose(found.means[order], kinds, atol=0.03)
    write_mixture(with_others(found), tmp_path / "arms.json", "made up")
    rows = json.loads((tmp_path / "arms.json").read_text())["kinds"]
    assert [row["share"] for row in rows] == pytest.approx([0.525, 0.3, 0.175], abs=0.01)


@pytest.mark.shared
def test_people_it_was_not_learned_from_are_likelier(shared_data: Path) -> None:
    clips = [path for subject in HELD_BACK for path in sorted((shared_data / "mocap_cmu").glob(f"cmu_{subject}_*.npz"))]
    arms = np.concatenate([arms_of(path) for path in clips])
    assert len(arms) > 500

    def alone(mean: np.ndarray, spread: np.ndarray) -> float:
        return float((-0.5 * (((arms - mean) / spread) ** 2).sum(axis=1) - np.log(spread).sum()).mean())

    mixed = float(np.logaddexp.reduce(arm_mixture().levels(arms), axis=1).mean())
    assert mixed > 0.5 > alone(MEAN[LEFT], np.array([0.45, 0.45, 0.5, 0.5])) > alone(MEAN[LEFT], SPREAD[LEFT])


def test_each_arm_is_of_the_kind_that_it_is_most_like() -> None:
    mixture = arm_mixture()
    stance = PosePrior("like others", MEAN, SPREAD, arms=mixture)
    angles = MEAN.copy()
    angles[LEFT], angles[RIGHT] = mixture.means[0], mixture.means[2] * (1, -1, -1, -1)
    mean, factor = stance.about(angles)
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
        assert level == pytest.approx(off @ np.linalg.inv(mixture.spreads[kind]) @ off)
    assert (POSED.about(angles)[0] == MEAN).all()


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


def test_a_view_keeps_the_face() -> None:
    view = posed_view()[0]
    seen = View(view.mask, view.landmarks, view.visibility, FOCAL, face=-12.0)
    assert view.face is None and seen.smaller(200.0).face == -12.0
    with pytest.raises(FormatError, match="a face's turn needs degrees, not nan"):
        View(view.mask, view.landmarks, view.visibility, FOCAL, face=float("nan"))


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize("pose", ["turned by 30", "turned by 45, a hand on the belly", "crossed"])
def test_the_turn_of_faces(pose: str) -> None:
    """Of made-up people that nothing was chosen by, within degrees; and with the picture's middle elsewhere."""
    needs_networks()
    body = open_body()
    for name in ("p18", "p20"):
        person = capture(name)
        taken = standing(person, pose)
        front = person.camera.viewmat[:3, :3] @ person.mesh.skeleton.forward(taken.rotations, taken.trans)[0, :3, 2]
        read = find_person(person.shown(taken))
        focal, middle = float(person.camera.K[0, 0]), person.camera.width / 2
        turn = face_turn(body, read.face, focal, middle)
        assert turn == pytest.approx(float(np.degrees(np.arctan2(front[0], -front[2]))), abs=6)
        aside = face_turn(body, read.face, focal, middle - focal * np.tan(np.radians(10)))
        assert turn is not None and aside is not None and turn - aside == pytest.approx(10, abs=0.6)
        assert face_turn(body, replace(read.face, presence=0.5), focal, middle) is None
