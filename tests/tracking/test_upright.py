"""The pelvis of somebody upright: at rest where it is at rest, below who crouches, and no say near the ground."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.learned.solver import LearnedSolver
from glsplat.tracking.learned.upright import SHARE, SINKS, Upright
from glsplat.tracking.solve.body import HEAD, NECK, PELVIS, Body
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, about, add, length, mul, rotate, sub, yaw_quat
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solvers import embedded_network


@pytest.fixture
def body(skeleton: Skeleton) -> Body:
    return Body.of(skeleton)


def eye_of(body: Body, head: Quat = IDENTITY) -> Vec:
    """Of a head that turns where it is at rest."""
    return add(sub(body.joints[HEAD], (0.0, body.ground, 0.0)), rotate(head, body.eye))


@pytest.mark.parametrize("yaw", [0.0, 2.0, -1.0])
def test_at_rest_it_is_the_pelvis_at_rest_whichever_way_it_faces(body: Body, yaw: float) -> None:
    head = yaw_quat(yaw)
    place = Upright(body).place(eye_of(body, head), head, yaw)
    off = rotate(head, sub(body.joints[PELVIS], body.joints[HEAD]))
    want = add(sub(body.joints[HEAD], (0.0, body.ground, 0.0)), off)
    np.testing.assert_allclose(place, want, atol=1e-9)


@pytest.mark.parametrize("down", [0.0, 0.5, 1.0])
def test_it_is_as_far_from_the_neck_as_ever_and_sinks_with_the_head(body: Body, down: float) -> None:
    upright, head = Upright(body), about((1.0, 0.0, 0.0), down)
    skull = sub(eye_of(body, head), rotate(head, body.eye))
    for lower in (0.0, 0.1, 0.2):
        eye = add(eye_of(body, head), (0.0, -lower, 0.0))
        place = upright.place(eye, head, 0.0)
        neck = add(sub(skull, (0.0, lower, 0.0)), rotate(head, sub(body.joints[NECK], body.joints[HEAD])))
        assert length(sub(place, neck)) == pytest.approx(length(sub(body.joints[NECK], body.joints[PELVIS])))
        level = upright.place(eye_of(body, head), head, 0.0)
        assert (SINKS[1] - 0.1) * lower <= level[1] - place[1] <= 1.15 * lower


def test_near_the_ground_it_has_no_say_and_comes_in_gradually(body: Body) -> None:
    upright = Upright(body)
    heights = [(0.0, part * body.eye_height, 0.0) for part in np.linspace(0.5, 1.1, 121).tolist()]
    shares = np.array([upright.share(eye) for eye in heights])
    assert shares[0] == 0.0 and shares[-1] == SHARE
    assert (np.diff(shares) >= 0).all() and np.diff(shares).max() < 0.02


def test_the_drawn_pelvis_is_nearer_to_it_than_without(body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody who stands and looks about: the third opinion pulls the pelvis, the eyes stay where they are."""

    def pelvis() -> list[tuple[Vec, Vec]]:
        solver, out = LearnedSolver(body, embedded_network()), []
        for i in range(90):
            head = mul(yaw_quat(0.6 * np.sin(i / 15)), about((1.0, 0.0, 0.0), 0.2))
            targets = Targets(eye_of(body, head), head)
            out.append((solver.solve(targets, 1 / 30).pelvis, solver.upright.place(targets.eye, head, 0.0)))
        return out

    with_it = pelvis()
    monkeypatch.setattr("glsplat.tracking.learned.upright.SHARE", 0.0)
    without = pelvis()
    apart = [np.mean([length(sub(at, goal)) for at, goal in rows[30:]]) for rows in (with_it, without)]
    assert apart[0] < 0.9 * apart[1]
