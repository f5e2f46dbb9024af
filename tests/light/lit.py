"""Things that know their surface, made in code, for tests of light."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from glsplat.avatar import Avatar
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.splats import Splats

Thing = TypeVar("Thing", Splats, Avatar)


def random_surface(count: int, seed: int = 0, shaded: bool = True) -> Surface:
    """Normals all around, occlusion and shades of any size; every tenth splat has none."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[::10] = 0
    return Surface.of(normals, rng.uniform(0.2, 1, count), rng.uniform(0.3, 2, (count, 3)) if shaded else None)


def surfaced(thing: Thing, seed: int = 0, shaded: bool = True) -> Thing:
    """The same with such a surface."""
    if isinstance(thing, Avatar):
        return replace(thing, splats=surfaced(thing.splats, seed, shaded))
    return replace(thing, surface=random_surface(len(thing), seed, shaded))


def random_light(seed: int = 0, sun: bool = True) -> Light:
    """All nine coefficients in three colours, and perhaps a sun."""
    rng = np.random.default_rng(seed)
    ambient = rng.normal(0, 0.3, (9, 3))
    ambient[0] = rng.uniform(1, 2, 3)
    way = rng.normal(size=3)
    return Light(ambient, way / np.linalg.norm(way), rng.uniform(0.5, 3, 3)) if sun else Light(ambient)
