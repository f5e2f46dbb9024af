"""Fit an avatar to the mesh that it was made from."""

from __future__ import annotations

from collections.abc import Callable

from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.compiled import available
from glsplat.extras.authoring.optimize.refine import RefineConfig, refine
from glsplat.meshes import RiggedMesh

STEPS = 900
"""About a minute on two cores for 40,000 splats, drawing included."""


def fitted_to_mesh(
    avatar: Avatar,
    mesh: RiggedMesh,
    seed: int = 0,
    steps: int = STEPS,
    progress: Callable[[str, float], None] | None = None,
) -> Avatar:
    """Return the avatar with all parameters of its splats fitted to pictures of ``mesh``; SH degree 0. Deterministic.

    Without numba ``refine`` fits it, in at most 450 steps: each takes a second and a half.
    """
    if not available():
        return refine(avatar, mesh, seed, RefineConfig(steps=min(steps, RefineConfig().steps)), progress)
    from glsplat.extras.authoring.optimize.splat_fit import FitConfig, fitted
    from glsplat.extras.authoring.optimize.target_pictures import pictures_of

    return fitted(avatar, pictures_of(mesh, seed, progress=progress), seed, FitConfig(steps=steps), progress)
