"""Merge avatars that were made from several surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glsplat.avatar import Avatar
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats


def merge_avatars(avatar: Avatar, other: Avatar) -> Avatar:
    """Return both avatars in one, on the first one's skeleton; without levels and cones.

    The second may have no shapes.
    """
    pair = [avatar.splats, other.splats]
    keys = ("means", "quats", "scales", "opacities", "sh")
    splats = Splats.create(*(np.concatenate([getattr(s, k) for s in pair]) for k in keys), antialias=pair[0].antialias)
    skins = [avatar.skin, other.skin]
    skin = Skin(
        np.concatenate([one.joints for one in skins]).astype(skins[0].joints.dtype),
        np.concatenate([one.weights for one in skins]),
    )
    shapes = avatar.shapes
    if shapes is not None:
        both = [shapes] if other.shapes is None else [shapes, other.shapes]
        assert all(one.names == shapes.names for one in both)
        shapes = Shapes.create(
            shapes.names,
            len(splats),
            splats=np.concatenate([one.rows + at for one, at in zip(both, (0, len(avatar.splats)), strict=False)]),
            targets=np.concatenate([one.targets for one in both]),
            moves=np.concatenate([one.metres for one in both]),
            bends=np.concatenate([one.bends for one in both]) * BEND,
            limits=shapes.limits,
        )
    return replace(avatar, splats=splats, skin=skin, shapes=shapes, levels=())
