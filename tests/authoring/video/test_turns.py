"""Which way people face, from networks that are off by some degrees and now and then take a back for a front."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from glsplat.authoring.fit.view import apart
from glsplat.authoring.networks.person import LANDMARKS
from glsplat.authoring.video.turns import facings


def person(turn: float, face: float | None = None) -> Any:
    """What the networks would say of somebody who has turned by so many degrees."""
    world = np.zeros((33, 3))
    for name, half in (("shoulder", 0.18), ("hip", 0.12)):
        across = half * np.array([np.cos(np.radians(turn)), 0.0, np.sin(np.radians(turn))])
        world[LANDMARKS.index(f"left_{name}")], world[LANDMARKS.index(f"right_{name}")] = across, -across
    presence = float(apart(turn, 0) < 75) if face is None else face
    return SimpleNamespace(body=SimpleNamespace(world=world), face=SimpleNamespace(presence=presence))


def off(found: np.ndarray, turns: np.ndarray) -> np.ndarray:
    return np.abs((found - turns + 180) % 360 - 180)


@pytest.mark.parametrize("whole", [1.0, -1.0, 2.5, -0.6])
@pytest.mark.parametrize("start", [0.0, 140.0])
def test_noise_and_mistakes_are_put_right(rng: np.random.Generator, whole: float, start: float) -> None:
    turns = start + np.arange(30) * 360 * whole / 30 + rng.normal(0, 3, 30)
    said = turns + rng.normal(0, 8, 30)
    people = [person(turn, float(apart(true, 0) < 75)) for turn, true in zip(said, turns, strict=True)]
    for index in (3, 12, 20):  # a back for a front
        people[index] = person(180 - said[index], 0.5)
    people[8] = person(float(rng.uniform(0, 360)), 0.5)
    assert off(facings(people, in_order=True), turns).max() < 25


def test_hair_before_a_face() -> None:
    """The face is not found in the front, where the body network takes it for a back; those beside it know better."""
    turns = np.arange(-60, 61, 12.0)
    people = [person(180 - turn, 0.0) if abs(turn) < 20 else person(turn) for turn in turns]
    assert off(facings(people, in_order=True), turns).max() < 20


def test_pictures_in_no_order() -> None:
    turns = np.array([200.0, 10, 300, 95, 150, 40, 260, 330])
    found = facings([person(turn) for turn in turns], in_order=False)
    assert off(found, turns).max() < 5 and (found >= 0).all() and (found < 360).all()
    mirrored = person(180.0, 1.0)  # a face is seen: this is a front
    assert apart(float(facings([mirrored], in_order=False)[0]), 0) < 10
