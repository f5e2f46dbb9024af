"""A size that is found while the session runs, and feet that no hand moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError, PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Calibration, Sample, Tracker, calibrate
from glsplat.tracking.calibration import found_size
from glsplat.tracking.finding import POSTURE, Finder
from glsplat.tracking.solve.body import FEET, TURNS_AT, Body
from glsplat.tracking.solve.quat import rotate, sub, to_quat
from glsplat.tracking.solvers import SolverName
from tests.tracking.moves import Stage, Track, seconds
from tools.data.sizes import found, persons

RATE = 30


def scales(body: Body, size: float, low: float, begins: float, hangs: bool = True, bow: float = 0.0) -> list[float]:
    """Of somebody ``size`` times the avatar who is ``low`` of that lower for ``begins`` seconds, then stands for 10."""
    finder, out = Finder(body, 1.0), []
    rng = np.random.default_rng(2)
    turn = to_quat((bow, 0.0, 0.0))
    bowed = sub(TURNS_AT, rotate(turn, TURNS_AT))
    for t in seconds(begins + 10, 1 / RATE):
        down = low * min(max((begins - t) / 0.8, 0.0), 1.0)
        height = (POSTURE - down) * size * body.eye_height + rng.normal(0, 0.003) + bowed[1]
        eye = (0.02 * np.sin(t), height, 0.1)
        wrist = (0.2, height * (0.54 if hangs and not down else 0.75), 0.15 if hangs else 0.4)
        out.append(finder.update(eye, turn, [wrist], 1 / RATE))
    return out


@pytest.mark.parametrize("size", [0.8, 0.9, 1.0, 1.1])
@pytest.mark.parametrize(("low", "begins"), [(0.0, 0.0), (0.25, 4.0), (0.2, 4.0)], ids=["stands", "sits", "crouches"])
def test_a_size_is_found_within_ten_seconds_of_standing(body: Body, size: float, low: float, begins: float) -> None:
    of_time = scales(body, size, low, begins)
    assert of_time[-1] == pytest.approx(size, rel=0.03)
    assert abs(of_time[90] / size - 1) < abs(1 / size - 1) + 0.01  # after 3 s no worse than without
    assert np.abs(np.diff(of_time)).max() * RATE < 0.16  # a second; nothing jerks
    assert np.abs(np.diff(of_time, 2)).max() < 2e-3


def test_a_head_that_is_bowed_is_no_smaller_person(body: Body) -> None:
    assert scales(body, 0.9, 0.0, 0.0, bow=0.8)[-1] == pytest.approx(scales(body, 0.9, 0.0, 0.0)[-1], abs=0.01)


def test_who_may_sit_on_a_chair_stays_as_large_as_the_avatar(body: Body) -> None:
    low = 0.74 * body.eye_height  # 1.28 m, hands ahead of the chest, for half a minute
    finder = Finder(body, 1.0)
    for _ in range(30 * RATE):
        scale = finder.update((0.0, low, 0.0), (1.0, 0.0, 0.0, 0.0), [(0.2, low - 0.35, 0.3)], 1 / RATE)
    assert scale == 1.0
    for step in range(3 * RATE):  # whoever walks at that height stands
        scale = finder.update((step / RATE, low, 0.0), (1.0, 0.0, 0.0, 0.0), [], 1 / RATE)
    assert scale < 0.85


def test_arms_that_were_stretched_count_a_quarter(stage: Stage) -> None:
    body, size, long = stage.body, 0.9, 1.1
    finder = Finder(body, 1.0)
    span = long * size * body.arm_span()
    eyes = POSTURE * size * body.eye_height
    for _ in range(10 * RATE):
        hands = [(side * span / 2, 0.85 * eyes, 0.0) for side in (1, -1)]
        scale = finder.update((0.0, eyes, 0.1), (1.0, 0.0, 0.0, 0.0), hands, 1 / RATE)
    assert scale == pytest.approx(size * (0.75 + 0.25 * long), rel=0.02)
    assert finder.arm_span == pytest.approx(span, abs=0.02)
    for _ in range(6 * RATE):  # a quarter, also where nothing new is believed
        finder.update((0.0, 0.7 * eyes, 0.1), (1.0, 0.0, 0.0, 0.0), [(0.2, 0.4 * eyes, 0.3)], 1 / RATE)
    assert finder.scale == pytest.approx(scale, rel=0.005)


def test_a_tracker_finds_it_and_forgets_it_for_the_next_user(skeleton: Skeleton, stage: Stage) -> None:
    tracker = Tracker(skeleton, Calibration(automatic=True))
    height = POSTURE * 0.9 * stage.body.eye_height
    for t in seconds(5.0, 1 / RATE):
        tracker.update(stage.sample(t, head=(0.0, height, 0.1)))
    found = tracker.calibration
    assert found.scale == pytest.approx(0.9, abs=0.02) and found.automatic
    assert found.eye_height == pytest.approx(height, abs=0.02)
    tracker.reset()
    assert tracker.calibration == Calibration(automatic=True)
    tracker.update(stage.sample(0.0, head=(0.0, height, 0.1)))
    assert tracker.calibration.scale == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("solver", ["learned", "analytic"])
def test_who_is_taller_does_not_begin_on_tiptoe(skeleton: Skeleton, stage: Stage, solver: SolverName) -> None:
    tracker = Tracker(skeleton, Calibration(automatic=True), solver=solver)
    height = 1.04 * stage.body.eye_height  # that the avatar reaches on its toes alone
    ankles = [skeleton.names.index(f"{side}_ankle") for side in ("left", "right")]
    for t in seconds(2.0, 1 / RATE):
        bones = tracker.update(stage.sample(t, head=(0.0, height, 0.1))).bones(skeleton)[ankles]
        places = np.einsum("nij,nj->ni", bones[:, :3, :3], skeleton.joints[ankles]) + bones[:, :3, 3]
        assert (places[:, 1] < skeleton.joints[ankles, 1] + 0.025).all()


def test_who_once_looked_too_tall_is_not_kept_so(body: Body) -> None:
    finder = Finder(body, 1.0)
    scale = finder.update((0.0, 1.3 * body.eye_height, 0.0), (1.0, 0.0, 0.0, 0.0), [], 1 / RATE)  # a headset held up
    assert scale > 1.3
    for _ in range(6 * RATE):
        scale = finder.update((0.0, POSTURE * body.eye_height, 0.0), (1.0, 0.0, 0.0, 0.0), [], 1 / RATE)
    assert scale == pytest.approx(1.0, abs=0.02)


def test_an_explicit_calibration_wins_and_its_file_keeps_what_is_found(
    skeleton: Skeleton, stage: Stage, tmp_path: Path
) -> None:
    still = [stage.sample(t, head=(0.0, 1.4, 0.1)) for t in seconds(6.0, 1 / RATE)]
    known = calibrate(still, skeleton)
    assert known.found == pytest.approx(known.scale / POSTURE, rel=0.02)
    known.save(tmp_path / "me.json")
    assert Calibration.load(tmp_path / "me.json") == known
    tracker = Tracker(skeleton, known)
    for sample in still:
        tracker.update(sample)
    assert tracker.calibration == known


def test_a_size_is_found_in_a_recording_of_who_does_not_stand_still(skeleton: Skeleton, stage: Stage) -> None:
    eyes = POSTURE * 0.85 * stage.body.eye_height
    places = [(t, (0.8 * t, eyes + 0.02 * np.sin(12 * t), 0.1)) for t in seconds(4.0, 1 / RATE)]
    walks = [stage.sample(t, head=head, left=None, right=None) for t, head in places]
    with pytest.raises(PoseError, match="the head moved"):
        calibrate(walks, skeleton)
    assert found_size(walks, skeleton).scale == pytest.approx(0.85, rel=0.03)
    nobody = found_size([Sample(t, None) for t in seconds(1.0)], skeleton)
    assert nobody.scale == 1.0 and nobody.eye_height is None


def test_the_file_of_a_calibration_says_that_it_is_automatic(tmp_path: Path) -> None:
    path = tmp_path / "me.json"
    for known in (Calibration(scale=0.9, automatic=True), Calibration(scale=0.9)):
        known.save(path)
        assert Calibration.load(path) == known
    path.write_text('{"scale": 1, "automatic": 1}')
    with pytest.raises(FormatError, match="automatic"):
        Calibration.load(path)
    path.write_text('{"scale": 1, "found": 7}')
    with pytest.raises(FormatError, match="scale needs"):
        Calibration.load(path)


@pytest.mark.parametrize("size", [1.0, 0.9])
def test_a_hand_raised_beside_a_still_head_moves_no_foot(
    skeleton: Skeleton, stage: Stage, track: Track, size: float
) -> None:
    """Whoever has the avatar's size, and whoever is smaller and never calibrated."""
    samples = []
    eye = (0.0, POSTURE * size * stage.body.eye_height, 0.1)
    for t in seconds(8.0, 1 / RATE):
        up = 0.5 - 0.5 * np.cos(np.pi * np.clip(t - 5, 0, 2))
        left = tuple(size * v for v in (0.25 + 0.3 * up, 1.07 + 0.8 * up, 0.15 + 0.1 * up))
        samples.append(stage.sample(t, head=eye, left=left, right=tuple(size * v for v in (-0.25, 1.07, 0.15))))
    run = track(samples, solver="learned", calibration=Calibration(automatic=True))
    known = 1 if size == 1 else 4  # seconds until the size is
    feet = run.joints[known * RATE :, list(FEET)]
    assert np.ptp(feet, axis=0).max() < 0.01


@pytest.mark.check
@pytest.mark.shared
def test_sizes_of_captured_people(shared_data: Path) -> None:
    """02 and 14 stand, 16 walks; none of them calibrates."""
    folder = shared_data / "mocap_cmu"
    clips = [path for subject in ("02", "16", "14_0") for path in folder.glob(f"cmu_{subject}*.npz")]
    results = found(persons(clips))
    sessions = [one for some in results.values() for one in some]
    assert len({one.subject for one in sessions}) == 3 and len(results) == 5
    assert max(abs(one.off) for one in sessions) < 0.03
    assert max(one.worse for one in sessions) < 0.01
