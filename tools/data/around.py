"""Fits the body of an embedded person once more, from all around: so that nothing shows through its clothes.

A fit sees the upper and lower sides of arms that are stretched sideways, and a crotch, hardly ever, and what is behind
a gap there has mostly the same colour: it has no reason to close it. One sees it as soon as somebody moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.extras.authoring.optimize.splat_fit import FitConfig, fitted
from glsplat.extras.authoring.optimize.target_pictures import ViewConfig, pictures_of
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import strongest_joint

__all__ = ["fitted_around"]

_STEPS, _SLOWER = 300, 0.6  # and by how much slower than a first fit: most of a body is right
_VIEWS = ViewConfig(body=30, poses=60, each=2, up=(-75, -40, 0, 40, 75), spread=45.0)


def fitted_around(
    avatar: Avatar,
    mesh: RiggedMesh,
    progress: Callable[[str, float], None] | None = None,
    views: ViewConfig = _VIEWS,
    steps: int = _STEPS,
) -> Avatar:
    """The avatar with the splats of its body, as many as before, fitted to the mesh; those of its head as they are.

    It has neither levels nor cones afterwards. Deterministic.
    """
    bare = replace(avatar, levels=(), splats=replace(avatar.splats, cones=None, cones_psnr=None, surface=None))
    still = [one for one in pictures_of(mesh, 1, views, progress) if one.pose is None or not one.pose.expression]
    usual = FitConfig()
    rates = {name: _SLOWER * getattr(usual, name) for name in ("mean_rate", "scale_rate", "turn_rate", "opacity_rate")}
    fit = FitConfig(steps=steps, recycled=0.0, thrift=0.0, colour_rate=_SLOWER * usual.colour_rate, **rates)
    made = fitted(bare, still, 1, fit, progress)
    head = np.array([name.startswith(HEAD) for name in avatar.skeleton.names])
    kept = head[strongest_joint(avatar.skin.joints, avatar.skin.weights)]

    def mixed(new: NDArray[np.float32], old: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(kept.reshape(-1, *[1] * (new.ndim - 1)), old, new)

    new, old = made.splats, bare.splats
    splats = replace(
        old,
        means=mixed(new.means, old.means),
        quats=mixed(new.quats, old.quats),
        scales=mixed(new.scales, old.scales),
        opacities=mixed(new.opacities, old.opacities),
        sh=mixed(new.sh, old.sh),
    )
    return replace(bare, splats=splats)
