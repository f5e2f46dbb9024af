"""The network's file, arithmetic and training, and that it is fed the same at run time as in training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.learned import network as module
from glsplat.extras.learned.hints import Hints
from glsplat.extras.learned.network import (
    ARRAYS,
    INPUTS,
    OUTPUTS,
    RATE_HZ,
    NetworkOutput,
    PoseNetwork,
    TrackedFrames,
    embedded_network,
    load_network,
    save_network,
)
from glsplat.extras.learned.posture import SteadyPosition
from glsplat.extras.motions.derive import derive, forward_all, resample, truth_from_motion
from glsplat.extras.training.clips import clips_of, disturbed, mirrored, targets_of, unit_of_skeleton
from glsplat.extras.training.fit import (
    MADE,
    Learner,
    Lesson,
    TrainingConfig,
    _seen_from,
    evaluate,
    features,
    fit,
    lessons_of,
    loss,
    shares_of,
    started,
)
from glsplat.extras.training.standing import TALL, stances_of, stood
from glsplat.formats.motion_files import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.solve.body import ANKLES, FEET, PELVIS, SPINE1, SPINE3, WRISTS, Body
from glsplat.tracking.solve.solution import Solution, Targets
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.tracker import Tracker

F32 = NDArray[np.float32]


def small(rng: np.random.Generator, width: int = 5, units: int = 7) -> PoseNetwork:
    shapes = (
        (width, INPUTS), (width,), (3 * units, width), (3 * units,), (3 * units, units), (3 * units,),
        (width, units), (width,), (OUTPUTS, width), (OUTPUTS,),
    )  # fmt: skip
    return PoseNetwork(*[rng.normal(0, 0.5, shape).astype(np.float32) for shape in shapes], note="made up")


def test_a_step_is_the_equations_written_out(rng: np.random.Generator) -> None:
    n = small(rng)
    x, h = rng.normal(size=INPUTS), rng.normal(size=7)

    def sigmoid(v: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1 / (1 + np.exp(-v))

    state = h.astype(np.float32)
    for _ in range(3):
        out, state = n.step(x.astype(np.float32), state)
        front = np.maximum(n.front.astype(float) @ x + n.front_bias, 0)
        gates_in, gates_h = n.cell_in.astype(float) @ front + n.cell_in_bias, n.cell.astype(float) @ h + n.cell_bias
        reset, update = sigmoid(gates_in[:7] + gates_h[:7]), sigmoid(gates_in[7:14] + gates_h[7:14])
        h = (1 - update) * np.tanh(gates_in[14:] + reset * gates_h[14:]) + update * h
        want = n.back.astype(float) @ np.maximum(n.skip.astype(float) @ h + n.skip_bias, 0) + n.back_bias
        np.testing.assert_allclose(out, want, atol=1e-5)
        np.testing.assert_allclose(state, h, atol=1e-6)


def test_numbers_of_any_size_leave_the_state_inside_its_bounds(rng: np.random.Generator) -> None:
    n = small(rng)
    state = n.start()
    for size in (1e3, 1e6, 1e20, 1.0):
        out, state = n.step((rng.normal(size=INPUTS) * size).astype(np.float32), state)
        assert np.isfinite(out).all() and np.abs(state).max() <= 1


def test_a_file_comes_back(tmp_path: Path, rng: np.random.Generator) -> None:
    n = small(rng)
    save_network(tmp_path / "m.npz", n)
    again = load_network(tmp_path / "m.npz")
    assert again.note == "made up"
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(n, name))


def test_broken_files_are_told_in_a_line(tmp_path: Path, rng: np.random.Generator) -> None:
    n, path = small(rng), tmp_path / "m.npz"
    save_network(path, n)
    whole = path.read_bytes()

    def says(words: str) -> None:
        with pytest.raises(FormatError, match=words) as caught:
            load_network(path)
        assert "\n" not in str(caught.value)

    for cut in (0, 10, len(whole) // 2, len(whole) - 5):
        path.write_bytes(whole[:cut])
        says("tracking model is an .npz")
    path.unlink()
    says("cannot read")
    with open(path, "wb") as file:
        np.savez(file, front=n.front)
    says("tracking model needs version")
    save_network(path, replace(n, back_bias=n.back_bias * np.float32(np.nan)))
    says("back_bias is not finite")
    save_network(path, replace(n, back=n.back[:-1]))
    says(r"back is float32 \(46, 5\)")
    save_network(path, replace(n, cell=n.cell.astype(np.float64)))  # type: ignore[arg-type]
    says("cell is float64")
    arrays = {name: getattr(n, name) for name in ARRAYS}
    parts = {"version": np.array(module.VERSION), "rate": np.array(RATE_HZ), "sha256": np.array(module._hash(arrays))}
    with open(path, "wb") as file:
        np.savez(file, **(parts | arrays | {"front_bias": n.front_bias + 1}))
    says("do not fit its checksum")
    with open(path, "wb") as file:
        np.savez(file, **(parts | arrays | {"version": np.array(99)}))
    says("version 99")
    with open(path, "wb") as file:
        np.savez(file, **(parts | arrays | {"front": np.array([{}], dtype=object)}))
    says("tracking model is an .npz of numbers")


def test_the_embedded_network_is_whole_and_small() -> None:
    n = embedded_network()
    assert "mocap.cs.cmu.edu" in n.note
    assert sum(getattr(n, name).nbytes for name in ARRAYS) < 3e6


class Listening(PoseNetwork):
    """A network that keeps what it is told."""

    heard: ClassVar[list[F32]] = []

    def step(self, inputs: F32, state: F32) -> tuple[F32, F32]:
        self.heard.append(inputs.copy())
        return super().step(inputs, state)


def targets_of_motion(skeleton: Skeleton, rate: float) -> list[Targets]:
    """What a solver is given for the embedded walk, without filters."""
    kept: list[Targets] = []

    class Keeping(AnalyticSolver):
        def solve(self, targets: Targets, dt: float) -> Solution:
            kept.append(targets)
            return super().solve(targets, dt)

    motion = load_motion("wave-and-turn", skeleton)
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, rate)
    tracker = Tracker(skeleton, config=TrackerConfig.raw(), solver=Keeping(Body.of(skeleton)))
    for sample in derive(skeleton, truth, fingers=False):
        tracker.update(sample)
    return kept


@pytest.mark.parametrize("rate", [30.0, 60.0, 90.0])
def test_training_and_run_time_see_the_same(skeleton: Skeleton, rng: np.random.Generator, rate: float) -> None:
    body, n = Body.of(skeleton), small(rng)
    listening = Listening(*[getattr(n, name) for name in ARRAYS])
    listening.heard.clear()
    hints = Hints(body, listening)
    for targets in targets_of_motion(skeleton, rate):
        hints.update(targets, 1 / rate)
    motion = load_motion("wave-and-turn", skeleton)
    clip = clips_of("somebody", motion, skeleton, (1.0,))[0]
    want = features(clip.seen, unit_of_skeleton(skeleton))
    heard = np.array(listening.heard)
    count = min(len(want), len(heard))
    assert count >= len(want) - 2
    np.testing.assert_allclose(heard[:count], want[:count], atol=2e-3)


def test_targets_say_where_the_body_is(skeleton: Skeleton) -> None:
    motion = load_motion("walk", skeleton)
    clip = clips_of("somebody", motion, skeleton, (1.0,))[0]
    unit = unit_of_skeleton(skeleton)
    guess = NetworkOutput.of(targets_of(clip, unit), unit)
    for i in (0, 7, len(clip.points) - 2):
        c, s = np.cos(clip.seen.yaw[i]), np.sin(clip.seen.yaw[i])
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        ground = clip.seen.eye[i] * [1, 0, 1]
        np.testing.assert_allclose(guess.points[i] @ turn.T + ground, clip.points[i], atol=1e-5)
        np.testing.assert_allclose(guess.ahead[i] @ turn.T + ground, clip.points[i + 1, 3:], atol=1e-5)
        np.testing.assert_allclose(turn @ guess.pelvis[i], clip.pelvis[i][:, [0, 2]], atol=1e-5)
        np.testing.assert_allclose(turn @ guess.chest[i], clip.chest[i][:, [0, 2]], atol=1e-5)


def test_devices_that_are_off_do_not_move_the_body(skeleton: Skeleton, rng: np.random.Generator) -> None:
    clip = clips_of("somebody", load_motion("wave-and-turn", skeleton), skeleton, (1.0,))[0]
    unit = unit_of_skeleton(skeleton)
    truth = targets_of(clip, unit)
    np.testing.assert_allclose(_seen_from(truth, clip.seen, clip.seen, unit), truth, atol=1e-6)
    for _ in range(4):
        odd: TrackedFrames = disturbed(clip.seen, rng)
        guess = NetworkOutput.of(_seen_from(truth, clip.seen, odd, unit), unit)
        c, s = np.cos(odd.yaw), np.sin(odd.yaw)
        zero, one = np.zeros_like(c), np.ones_like(c)
        turn = np.stack((c, zero, s, zero, one, zero, -s, zero, c), -1).reshape(-1, 3, 3)
        world = np.einsum("tab,tpb->tpa", turn, guess.points) + (odd.eye * [1, 0, 1])[:, None]
        np.testing.assert_allclose(world, clip.points, atol=2e-5)
        np.testing.assert_allclose(turn @ guess.chest, clip.chest[:, :, [0, 2]], atol=2e-5)


def test_a_mirror_image_of_a_mirror_image_is_the_clip(skeleton: Skeleton) -> None:
    clip = clips_of("somebody", load_motion("wave-and-turn", skeleton), skeleton, (1.0,))[0]
    again = mirrored(mirrored(clip))
    for name in ("points", "pelvis", "chest", "contact"):
        np.testing.assert_array_equal(getattr(again, name), getattr(clip, name))
    other = mirrored(clip)
    # the body's left foot is the right one now, on the other side, and its frames are rotations still
    np.testing.assert_allclose(other.points[:, 4] * [-1, 1, 1], clip.points[:, 3])
    np.testing.assert_allclose(np.linalg.det(other.chest), 1, atol=1e-5)


SMALL = TrainingConfig(width=12, units=16, steps=40, batch=8, length=30)


@pytest.fixture(scope="module")
def lessons(skeleton: Skeleton) -> list[Lesson]:
    clips = [c for name in ("walk", "idle") for c in clips_of(name, load_motion(name, skeleton), skeleton, (1.0,))]
    return lessons_of(clips, unit_of_skeleton(skeleton), np.random.default_rng(3))


def test_gradients_are_what_differences_say(rng: np.random.Generator) -> None:
    t, b = 6, 3
    learner = Learner({name: w * 0.7 for name, w in started(rng, INPUTS, 9, 7, OUTPUTS).items()})
    x, y = (rng.standard_normal((t, b, n)).astype(np.float32) for n in (INPUTS, OUTPUTS))
    known = np.ones((t, b), np.float32)
    known[-1, 0] = 0

    def far() -> float:
        said = learner.say(x)
        return loss(said.astype(np.float64), y, known)[0]  # type: ignore[arg-type]

    said = learner.say(x)
    gradient = learner.gradient(loss(said, y, known)[1])
    for name, of in gradient.items():
        weights = learner.weights[name]
        way = rng.standard_normal(weights.shape).astype(np.float32)
        step = 2e-4 / float(np.linalg.norm(way)) ** 0.5  # small, as |x| has a kink
        learner.weights[name] = weights + way * np.float32(step)
        more = far()
        learner.weights[name] = weights - way * np.float32(step)
        less = far()
        learner.weights[name] = weights
        assert (more - less) / (2 * step) == pytest.approx(float((of * way).sum()), rel=0.03, abs=2e-3), name


def test_a_few_steps_are_worth_something_and_the_same_each_time(lessons: list[Lesson], skeleton: Skeleton) -> None:
    clean, unit = [lesson for lesson in lessons if lesson.clean], unit_of_skeleton(skeleton)
    losses: list[float] = []
    short = fit(lessons, replace(SMALL, steps=2))
    long = fit(lessons, SMALL, progress=lambda _, far: losses.append(far))
    again = fit(lessons, SMALL)
    assert len(losses) == SMALL.steps and np.isfinite(losses).all()
    for name, array in long.weights().items():
        np.testing.assert_array_equal(array, again.weights()[name], err_msg=name)
    before, after = evaluate(short, clean, unit), evaluate(long, clean, unit)
    assert after["feet"] < 0.7 * before["feet"] and after["pelvis"] < before["pelvis"]


def test_what_is_said_in_training_is_said_at_run_time(lessons: list[Lesson], rng: np.random.Generator) -> None:
    network = PoseNetwork(**started(rng, INPUTS, 12, 16, OUTPUTS))
    heard, state = lessons[0].heard[:50], network.start()
    said = Learner(network.weights()).say(heard[:, None])[:, 0]
    for moment, want in zip(heard, said, strict=True):
        numbers, state = network.step(moment, state)
        np.testing.assert_allclose(numbers, want, atol=1e-4)


def test_an_upper_body_stands_on_feet_that_stay(skeleton: Skeleton, rng: np.random.Generator) -> None:
    body = Body.of(skeleton)
    stances = stances_of(load_motion("wave-and-turn", skeleton), skeleton)
    assert stances and all(stance.height > TALL * (body.joints[PELVIS][1] - body.ground) for stance in stances)
    waves = load_motion("wave-and-turn", skeleton)
    made = stood(waves, stances, skeleton, rng)
    assert made is not None and made.fps == 30
    at, _ = forward_all(skeleton, made.rotations, made.trans)
    assert np.ptp(at[:, list(FEET)], axis=0).max() < 2e-3 and np.ptp(at[:, list(ANKLES)], axis=0).max() < 0.02
    np.testing.assert_allclose(at[:, list(FEET), 1] - body.ground, body.sole, atol=2e-3)
    assert np.ptp(at[:, PELVIS, [0, 2]], axis=0).max() > 0.01  # it sways
    # arms and spine are the other's
    theirs, _ = forward_all(skeleton, *resample(waves.rotations, waves.trans, waves.fps, 30.0))
    for joint in (*WRISTS, SPINE3):
        ours, other = (np.linalg.norm(p[:, joint] - p[:, SPINE1], axis=-1) for p in (at, theirs[: len(at)]))
        np.testing.assert_allclose(ours, other, atol=1e-6)


def test_a_steady_place_trembles_less_and_is_not_behind(rng: np.random.Generator) -> None:
    steady, dt = SteadyPosition(), 1 / 72
    walks = [(1.4 * i * dt, 0.9, 0.0) for i in range(200)]
    shown = [steady.update(place, dt) for place in walks]
    assert abs(shown[-1][0] - walks[-1][0]) < 1e-3
    steady.reset()
    trembles = rng.normal(0, 0.002, (400, 3))
    shown = np.array([steady.update((x, y, z), dt) for x, y, z in trembles.tolist()])
    jerk = [np.linalg.norm(np.diff(p, n=3, axis=0), axis=-1).mean() for p in (shown, trembles)]
    assert jerk[0] < 0.5 * jerk[1]


def test_a_network_that_goes_on_begins_where_it_was(lessons: list[Lesson]) -> None:
    start = fit(lessons, replace(SMALL, steps=3))
    same = fit(lessons, replace(SMALL, steps=1, rate=0.0), start)
    for name, array in same.weights().items():
        np.testing.assert_allclose(array, start.weights()[name], atol=2e-5, err_msg=name)
    x, state = lessons[0].heard[5], start.start()
    np.testing.assert_allclose(same.step(x, state)[0], start.step(x, state)[0], atol=1e-3)


def test_clips_made_of_several_have_their_share(skeleton: Skeleton) -> None:
    walk = load_motion("walk", skeleton)
    clips = [*clips_of("a", walk, skeleton), *clips_of("b", walk, skeleton, made=True)]
    assert [clip.made for clip in clips].count(True) == 2
    share = shares_of(clips)
    assert share.sum() == pytest.approx(1)
    assert sum(s for s, clip in zip(share, clips, strict=True) if clip.made) == pytest.approx(MADE)


def test_who_would_fall_is_left_out(skeleton: Skeleton, rng: np.random.Generator) -> None:
    walk = load_motion("walk", skeleton)
    stances = stances_of(load_motion("wave-and-turn", skeleton), skeleton)
    rotations = walk.rotations.copy()
    rotations[:, PELVIS] = (1.5, 0.0, 0.0)  # lies on the belly
    assert stood(replace(walk, rotations=rotations), stances, skeleton, rng) is None
    assert stood(walk, [], skeleton, rng) is None
