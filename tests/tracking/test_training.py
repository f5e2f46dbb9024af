"""How the network learns: gradients, and that a few steps make it better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.motion.loading import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.learned.frames import INPUTS, OUTPUTS
from glsplat.tracking.learned.network import PoseNetwork
from glsplat.tracking.training.clips import clips_of, unit_of_skeleton
from glsplat.tracking.training.fit import Lesson, TrainingConfig, evaluate, fit, lessons_of, loss
from glsplat.tracking.training.recurrent import Learner, started

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


def test_a_network_that_goes_on_begins_where_it_was(lessons: list[Lesson]) -> None:
    start = fit(lessons, replace(SMALL, steps=3))
    same = fit(lessons, replace(SMALL, steps=1, rate=0.0), start)
    for name, array in same.weights().items():
        np.testing.assert_allclose(array, start.weights()[name], atol=2e-5, err_msg=name)
    x, state = lessons[0].heard[5], start.start()
    np.testing.assert_allclose(same.step(x, state)[0], start.step(x, state)[0], atol=1e-3)


def test_what_is_said_in_training_is_said_at_run_time(lessons: list[Lesson], rng: np.random.Generator) -> None:
    network = PoseNetwork(**started(rng, INPUTS, 12, 16, OUTPUTS))
    heard, state = lessons[0].heard[:50], network.start()
    said = Learner(network.weights()).say(heard[:, None])[:, 0]
    for moment, want in zip(heard, said, strict=True):
        numbers, state = network.step(moment, state)
        np.testing.assert_allclose(numbers, want, atol=1e-4)
