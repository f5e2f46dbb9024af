"""Waist, feet and a device's own body beside head and hands: what they are worth, and what bad ones do."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError, PoseError
from glsplat.extras.evaluate.tracking_score import TrackingScore, score
from glsplat.extras.motions.derive import MOUNTS, Disturbance, TrueMotion, derive, disturb, truth_from_motion
from glsplat.formats.motion_files import load_motion
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Calibration, Sample, Tracker, TrackerConfig, calibrate
from glsplat.tracking.sample import BODY_JOINTS, TRACKERS
from glsplat.tracking.solve.body import ANKLES, FEET, HEAD, KNEES, PELVIS, Body
from glsplat.tracking.solvers import SOLVERS, SolverName
from tests.tracking.moves import DT, Run, Track

NAN, INF = math.nan, math.inf
CLIPS = ["cmu_02_01.amc", "cmu_131_03.bvh"]  # walks; dances with wide steps and a kneel


def zero_pose(skeleton: Skeleton, seconds: float = 2.0) -> TrueMotion:
    frames = round(72 * seconds)
    return truth_from_motion(skeleton, np.zeros((frames, 55, 3)), np.zeros((frames, 3)), 72.0, 72.0)


def truth_of(skeleton: Skeleton, name: str, seconds: float = 8.0) -> TrueMotion:
    motion = load_motion(name, skeleton)
    count = min(len(motion), round(seconds * motion.fps))
    return truth_from_motion(skeleton, motion.rotations[:count], motion.trans[:count], motion.fps, 72.0)


def scored(
    skeleton: Skeleton,
    truth: TrueMotion,
    samples: list[Sample],
    calibration: Calibration | None = None,
    solver: SolverName = SOLVERS[0],
) -> TrackingScore:
    tracker = Tracker(skeleton, calibration, solver=solver)
    poses = [tracker.update(sample) for sample in samples][-len(truth.times) :]
    joints = np.array([tracker.joints(pose) for pose in poses])
    rotations = np.array([pose.rotations for pose in poses])
    return score(joints, truth.positions, 72.0, Body.of(skeleton).sole, rotations, truth.rotations)


@cache
def fitted(skeleton: Skeleton, trackers: tuple[str, ...]) -> Calibration:
    """Two seconds of standing with them on."""
    return calibrate(derive(skeleton, zero_pose(skeleton), trackers=trackers), skeleton)


def after_standing(skeleton: Skeleton, truth: TrueMotion, trackers: tuple[str, ...]) -> list[Sample]:
    """A second of standing in one place, then, after a gap, the motion: nobody calibrated anything."""
    standing = derive(skeleton, zero_pose(skeleton, 1.0), trackers=trackers)
    return [replace(s, t=s.t - 3.0) for s in standing] + derive(skeleton, truth, trackers=trackers)


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize(
    ("solver", "legs", "by_waist", "by_feet"), [("analytic", 8, 0.8, 0.35), ("learned", 7, 0.9, 0.55)]
)  # the learned legs are nearer without trackers, the pelvis over tracked feet not always
def test_captured_legs_come_back(
    skeleton: Skeleton, shared_data: Path, clip: str, solver: SolverName, legs: float, by_waist: float, by_feet: float
) -> None:
    truth = truth_of(skeleton, str(shared_data / "mocap" / clip), 5.0)
    both = ("waist", "feet")
    plain = scored(skeleton, truth, derive(skeleton, truth), solver=solver)
    samples = derive(skeleton, truth, trackers=both)
    tracked = scored(skeleton, truth, samples, fitted(skeleton, both), solver=solver)
    shaken = disturb(samples, Disturbance(noise_mm=3, noise_deg=1))
    noisy = scored(skeleton, truth, shaken, fitted(skeleton, both), solver=solver)
    learned = scored(skeleton, truth, after_standing(skeleton, truth, both), solver=solver)
    own = scored(skeleton, truth, derive(skeleton, truth, trackers=("body",)), solver=solver)
    waist, feet = (
        scored(skeleton, truth, derive(skeleton, truth, trackers=one), fitted(skeleton, one), solver=solver)
        for one in (("waist",), ("feet",))
    )
    assert plain.lower > legs
    assert tracked.lower < 1.3 and tracked.root < 0.5 and tracked.upper < plain.upper
    assert noisy.lower < 1.6 and own.lower < 0.8
    assert learned.lower < 0.45 * plain.lower
    assert waist.lower < by_waist * plain.lower and waist.root < 0.5
    assert feet.lower < by_feet * plain.lower
    for s in (tracked, learned, own, waist, feet):
        assert s.penetration < 0.1 and s.hands < 0.7


@pytest.mark.parametrize("trackers", [("waist", "feet"), ("body",)])
def test_embedded_motions_come_back(skeleton: Skeleton, trackers: tuple[str, ...]) -> None:
    truth = truth_of(skeleton, "walk")
    plain = scored(skeleton, truth, derive(skeleton, truth))
    tracked = scored(skeleton, truth, derive(skeleton, truth, trackers=trackers), fitted(skeleton, trackers))
    assert tracked.lower < 1.3 < 0.5 * plain.lower and tracked.root < 0.5


def test_samples_without_them_give_the_same_bytes(skeleton: Skeleton) -> None:
    truth = truth_of(skeleton, "walk", 2.0)
    plain = derive(skeleton, truth)
    empty = [Sample.from_json({**s.to_json(), "waist": None, "body": {}, "left_foot": None}) for s in plain]
    known = fitted(skeleton, ("waist", "feet"))
    bare = replace(known, waist=None, left_foot=None, right_foot=None)
    one, two = Tracker(skeleton, bare), Tracker(skeleton, known)
    three = Tracker(skeleton, head_only=True)
    for a, b in zip(plain, empty, strict=True):
        first, second = one.update(a), two.update(b)
        assert first.rotations.tobytes() == second.rotations.tobytes() and one.flags == two.flags
        assert first.trans.tobytes() == second.trans.tobytes()
        three.update(replace(a, waist=(0.0,) * 7))
        assert "waist_lost" not in three.flags


def test_a_calibration_learns_how_they_are_mounted(skeleton: Skeleton, tmp_path: Path) -> None:
    """Against the mounts that ``derive`` gave them: the joint in the tracker's frame is the inverse of those."""
    found = fitted(skeleton, ("waist", "feet"))
    for mount, (offset, vector) in zip(found.mounts, MOUNTS, strict=True):
        turn = rotation_matrices(np.array(vector))
        np.testing.assert_allclose(mount[:3], -turn.T @ np.array(offset), atol=0.003)
        x, y, z, w = mount[3:]
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        np.testing.assert_allclose(np.eye(3) + 2 * w * k + 2 * k @ k, turn.T, atol=0.01)
    path = tmp_path / "me.json"
    found.save(path)
    assert Calibration.load(path) == found
    assert set(TRACKERS) <= set(json.loads(path.read_text()))
    Calibration().save(path)
    assert not set(TRACKERS) & set(json.loads(path.read_text()))


@pytest.mark.parametrize("bad", [[0] * 6, [0] * 7, [3, 0, 0, 0, 0, 0, 1], ["a"] * 7, 5, {}, [None] * 7, [1e999] * 7])
def test_a_calibration_with_a_bad_mount_is_refused(tmp_path: Path, bad: Any) -> None:
    path = tmp_path / "me.json"
    path.write_text(json.dumps({"scale": 1, "waist": bad}))
    with pytest.raises(FormatError, match=r"me\.json.*waist"):
        Calibration.load(path)


@pytest.mark.parametrize("scale", [0.7, 1.2])
def test_users_of_other_sizes(skeleton: Skeleton, scale: float) -> None:
    """The whole room scaled: what comes back is the scaled body."""
    truth = truth_of(skeleton, "walk", 2.0)
    trackers = ("waist", "feet")

    def scaled(s: Sample) -> Sample:
        poses = {k: tuple(v * scale for v in p[:3]) + p[3:] for k in ("head", "left", "right", *TRACKERS)
                 if (p := getattr(s, k)) is not None}  # fmt: skip
        return Sample(s.t, **poses)

    me = calibrate([scaled(s) for s in derive(skeleton, zero_pose(skeleton), trackers=trackers)], skeleton)
    assert me.scale == pytest.approx(scale, abs=0.005)
    tracker = Tracker(skeleton, me)
    joints = np.array([tracker.joints(tracker.update(scaled(s))) for s in derive(skeleton, truth, trackers=trackers)])
    off = np.linalg.norm(joints[:, [PELVIS, *ANKLES]] - scale * truth.positions[:, [PELVIS, *ANKLES]], axis=2)
    assert off.mean() < 0.012


def test_what_is_found_is_flagged_when_it_is_lost(skeleton: Skeleton) -> None:
    tracker = Tracker(skeleton)
    samples = derive(skeleton, truth_of(skeleton, "walk", 1.0), trackers=("waist", "feet"))
    tracker.update(replace(samples[0], waist=None, right_foot=None))
    assert not any(name in flag for flag in tracker.flags for name in ("waist", "foot_lost"))
    tracker.update(samples[1])
    tracker.update(replace(samples[2], waist=None, left_foot=(NAN,) * 7))
    assert {"waist_lost", "left_foot_lost"} <= set(tracker.flags) and "right_foot_lost" not in tracker.flags


def test_the_wire_form() -> None:
    pose = [0.1, 1.0, 0.2, 0.0, 0.0, 0.0, 1.0]
    wire = {"t": 1.0, "head": pose, "left": None, "right": None, "waist": pose, "left_foot": pose,
            "body": {"hips": pose[:3], "left-foot-ball": pose}}  # fmt: skip
    sample = Sample.from_json(wire)
    assert sample.waist == tuple(pose) and sample.right_foot is None
    assert sample.body == {"hips": tuple(pose[:3]), "left-foot-ball": tuple(pose)}
    assert sample.to_json() == wire
    more = Sample.from_json({**wire, "body": {**wire["body"], "chest": "?", "hips": None}, "chest": 5})  # type: ignore[dict-item]
    assert more.body == {"left-foot-ball": tuple(pose)}


@pytest.mark.parametrize(
    "bad",
    [
        {"waist": [1, 2, 3]},
        {"left_foot": "x"},
        {"right_foot": [None] * 7},
        {"body": []},
        {"body": "hips"},
        {"body": {"hips": [1, 2]}},
        {"body": {"hips": ["1", "2", "3"]}},
        {"body": {f"j{i}": None for i in range(300)}},
    ],
    ids=str,
)
def test_malformed_trackers_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(PoseError, match=r'"(waist|left_foot|right_foot|body)'):
        Sample.from_json({"head": [0, 1.6, 0, 0, 0, 0, 1], **bad})


Spoil = Callable[[Sample, int, np.random.Generator], Sample]


def swapped(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    return replace(s, left_foot=s.right_foot, right_foot=s.left_foot) if i % 100 > 50 else s


def cycled(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    return replace(s, waist=s.left_foot, left_foot=s.right_foot, right_foot=s.waist) if i % 100 > 50 else s


def lost(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    gone: dict[str, Any] = {name: None for k, name in enumerate((*TRACKERS, "body")) if (i + 17 * k) % 60 < 30}
    return replace(s, **gone)


def far(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    if i % 40 < 20:
        return s
    away = tuple(rng.normal(0, (0.3, 3.0, 1e3)[i // 40 % 3], 3))
    moved: dict[str, Any] = {
        name: tuple(a + b for a, b in zip(pose[:3], away, strict=True)) + pose[3:]
        for name in TRACKERS
        if (pose := getattr(s, name)) is not None
    }
    return replace(s, **moved)


def upside_down(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    if i % 80 < 40:
        return s
    x, y, z, qx, qy, qz, qw = s.waist or (0.0,) * 7
    turned: dict[str, Any] = {"waist": (x, y, z, qw, -qz, qy, -qx)}
    x, y, z, qx, qy, qz, qw = s.left_foot or (0.0,) * 7
    return replace(s, **turned, left_foot=(x, y, z, qw, -qz, qy, -qx))


def not_numbers(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    bad: list[Any] = [(NAN,) * 7, (INF, *(0.0,) * 6), (0.0,) * 7, (1e300,) * 7, None, "abc", (1, 2), {}, 5]
    body: Any = [{"hips": bad[i % 9], "left-foot-ball": bad[i % 7]}, 5, {}, s.body, None, [1]][i // 3 % 6]
    return replace(s, waist=bad[i // 5 % 9], left_foot=bad[i // 7 % 9], right_foot=bad[i // 4 % 9], body=body)


def under_the_floor(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    sunk: dict[str, Any] = {}
    for name in TRACKERS:
        pose = getattr(s, name)
        sunk[name] = None if pose is None else (pose[0], pose[1] - 0.4 * (1 + math.sin(0.05 * i)), *pose[2:])
    return replace(s, **sunk)


def noise(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    anything: dict[str, Any] = {name: tuple(rng.normal(0, 1, 7)) for name in TRACKERS if rng.random() < 0.7}
    body = {name: tuple(rng.normal(0, 1, 3)) for name in BODY_JOINTS if rng.random() < 0.8}
    return replace(s, **anything, body=body if rng.random() < 0.5 else s.body)


def collapsed(s: Sample, i: int, rng: np.random.Generator) -> Sample:
    place = (0.0, (1.0, 0.0, -3.0)[i // 50 % 3], 0.0)
    return replace(s, waist=None, left_foot=None, right_foot=None, body=dict.fromkeys(BODY_JOINTS, place))


SPOILS = [swapped, cycled, lost, far, upside_down, not_numbers, under_the_floor, noise, collapsed]


def promised(result: Run, body: Body) -> None:
    """The pelvis at 14 m/s, feet at 10 m/s over it, soles on the floor: TrackerConfig's defaults."""
    config = TrackerConfig()
    assert np.isfinite(result.joints).all()
    calm = np.array([not {"teleport", "gap", "clock"} & set(flags) for flags in result.flags[1:]])
    pelvis = np.linalg.norm(np.diff(result.joints[:, PELVIS], axis=0), axis=1)
    assert (pelvis[calm] < 1.02 * config.root_speed * DT + 1e-6).all()
    feet = np.linalg.norm(np.diff(result.joints[:, list(FEET)], axis=0), axis=2).max(1)
    assert (feet - pelvis < 1.02 * config.foot_speed * DT + 1e-6)[calm].all()
    assert result.joints[:, [*FEET, *ANKLES, *KNEES], 1].min() > body.sole - 0.01


CASES = [(spoil, True) for spoil in SPOILS] + [(spoil, False) for spoil in (cycled, lost, noise)]


@pytest.mark.parametrize(("spoil", "calibrated"), CASES)
def test_bad_trackers_break_no_promise(
    skeleton: Skeleton, body: Body, track: Track, spoil: Spoil, calibrated: bool
) -> None:
    rng = np.random.default_rng(7)
    trackers = ("waist", "feet", "body")
    samples = derive(skeleton, truth_of(skeleton, "wave-and-turn", 3.0), trackers=trackers)
    spoilt = [spoil(sample, i, rng) for i, sample in enumerate(samples)]
    calibration = fitted(skeleton, ("waist", "feet")) if calibrated else None
    result = track(spoilt, fastest=46.0, calibration=calibration)
    promised(result, body)
    again = track(spoilt[:90], fastest=46.0, calibration=calibration)  # later samples change nothing before them
    assert again.rotations.tobytes() == result.rotations[:90].tobytes()


def test_one_that_is_lost_and_found_again_does_not_jump(skeleton: Skeleton, track: Track) -> None:
    trackers = ("waist", "feet")
    samples = derive(skeleton, truth_of(skeleton, "wave-and-turn", 4.0), trackers=trackers)
    calibration = fitted(skeleton, trackers)
    whole = track(samples, calibration=calibration)
    for name, joint in (("waist", PELVIS), ("left_foot", ANKLES[0])):
        gone = [replace(s, **{name: None}) if 1 < s.t < 2.5 else s for s in samples]  # type: ignore[arg-type]
        holed = track(gone, calibration=calibration)
        speeds = [np.linalg.norm(np.diff(run.joints[:, joint], axis=0), axis=1) / DT for run in (whole, holed)]
        assert speeds[1].max() < speeds[0].max() + 3.5
        back = np.linalg.norm(whole.joints[-50:, joint] - holed.joints[-50:, joint], axis=1)
        assert back.max() < 0.01


def test_feet_that_are_lifted_off_the_floor_stay_there(skeleton: Skeleton, track: Track) -> None:
    """Somebody who stands on one leg: a headset alone knows nothing of it."""
    zero = zero_pose(skeleton, 3.0)
    samples = derive(skeleton, zero, trackers=("waist", "feet"))
    calibration = fitted(skeleton, ("waist", "feet"))

    def lifted(s: Sample) -> Sample:
        x, y, z, *turn = s.left_foot or (0.0,) * 7
        up = 0.3 * min(1.0, max(0.0, s.t - 0.5))
        return replace(s, left_foot=(x, y + up, z + up, *turn))  # type: ignore[arg-type]

    result = track([lifted(s) for s in samples], calibration=calibration)
    left, right = result.joints[-1, list(ANKLES)] - zero.positions[-1, list(ANKLES)]
    np.testing.assert_allclose(left, (0, 0.3, 0.3), atol=0.015)
    np.testing.assert_allclose(right, 0, atol=0.015)
    assert "airborne" not in result.flags[-1] and "head_out_of_reach" not in result.flags[-1]


def test_the_head_stays_exact(skeleton: Skeleton, track: Track) -> None:
    truth = truth_of(skeleton, "walk", 3.0)
    trackers = ("waist", "feet")
    config = TrackerConfig.raw()
    samples = derive(skeleton, truth, trackers=trackers)
    result = track(samples, config=config, calibration=fitted(skeleton, trackers))
    np.testing.assert_allclose(result.joints[:, HEAD], truth.positions[:, HEAD], atol=1e-4)
    off = np.linalg.norm(result.joints[:, PELVIS] - truth.positions[:, PELVIS], axis=1)
    assert off.mean() < 0.003 and off.max() < 0.01
    off = np.linalg.norm(result.joints[:, list(ANKLES)] - truth.positions[:, list(ANKLES)], axis=2)
    assert off.mean() < 0.004 and off.max() < 0.02  # a leg all but straight stays some millimetres short


def test_a_body_that_walks_and_kneels_is_read_without_its_axes(skeleton: Skeleton) -> None:
    """Places alone tell pelvis and feet, whatever the axes of a runtime's joints are."""
    truth = truth_of(skeleton, "wave-and-turn", 1.0)
    samples = derive(skeleton, truth, trackers=("body",))
    rng = np.random.default_rng(2)
    turned = [replace(s, body={n: (*p[:3], *rng.normal(size=4)) for n, p in s.body.items()}) for s in samples]
    one, two = Tracker(skeleton), Tracker(skeleton)
    for a, b in zip(samples, turned, strict=True):
        np.testing.assert_array_equal(one.update(a).rotations, two.update(b).rotations)
