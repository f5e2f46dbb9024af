"""The light of a photograph, found again on a body that was lit by a lamp whose place is known."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.authoring.paint.light import Light, find_light

DOUBTS = 1.5, 0.7


def seen_under(lamp: tuple[float, float, float], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals that a camera on -z sees, and colours of cloths under a lamp, with noise."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(4000, 3))
    normals[:, 2] = -np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    albedo = rng.uniform(0.1, 0.8, (30, 3))[rng.integers(0, 30, 4000)] * rng.lognormal(0, 0.1, (4000, 3))
    way = np.array(lamp) / np.linalg.norm(lamp)
    light = Light(way, np.array([0.0, -1, 0]), 1.7)
    return normals, albedo * light.shade(normals)[:, None]


@pytest.mark.parametrize("lamp", [(-0.85, -0.55, -0.6), (0.85, -0.55, -0.6), (0.1, -0.9, -0.6)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_lamp_from_aside_is_found(lamp: tuple[float, float, float], seed: int) -> None:
    normals, colours = seen_under(lamp, seed)
    up, towards = np.array([0.0, -1, 0]), np.array([0.0, 0, -1])
    found = find_light(normals, colours, np.ones(4000), up, towards, DOUBTS)
    angle = np.degrees(np.arccos(found.direction @ np.array(lamp) / np.linalg.norm(lamp)))
    assert angle < 15 and 1.0 < found.strength < 2.6
    usual = find_light(normals, colours, np.ones(4000), up, towards)
    assert found.direction[0] * lamp[0] >= usual.direction[0] * lamp[0] - 0.02  # more doubt leans no less
