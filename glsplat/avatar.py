"""Avatar: splats with a skeleton and a skin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen_mapping, instance, listed
from glsplat.errors import FormatError
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Level, Levels, Splats, checked_levels

__all__ = ["Avatar", "splats_of"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Avatar:
    """Canonical Gaussians with a rig and metadata.

    The Gaussians are in the zero pose, or in the bind pose of ``skeleton.inverse_bind`` if that differs. Raises
    FormatError if the parts do not fit each other.

    >>> splats = glsplat.Splats.create([[0, 1, 0]], [[1, 0, 0, 0]], [[0.1, 0.1, 0.1]], [0.9], rgb=[[1, 0, 0]])
    >>> skeleton = glsplat.Skeleton.from_joints(["hip", "knee"], [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    >>> glsplat.Avatar(splats, skeleton, glsplat.Skin([[0, 1]], [[0.75, 0.25]]))
    Avatar(1 splats, 2 joints, 2 a splat)
    """

    splats: Splats
    skeleton: Skeleton
    skin: Skin
    meta: Mapping[str, Any] = field(default_factory=dict)  # asset.extras.glsplat: version, source, licence, ...
    levels: tuple[Level[Avatar], ...] = ()  # coarser avatars on the same skeleton, finest first
    shapes: Shapes | None = None  # facial expressions; a level has the same names, or None for a still face

    def __post_init__(self) -> None:
        for name, kind in (("splats", Splats), ("skeleton", Skeleton), ("skin", Skin), ("meta", Mapping)):
            instance(getattr(self, name), kind, f"an avatar's {name}")
        if len(self.skin) != len(self.splats):
            raise FormatError(f"an avatar needs one skin row a splat, not {len(self.skin)} for {len(self.splats)}")
        instance(self.shapes, (Shapes, NoneType), "an avatar's shapes")
        if self.shapes is not None and self.shapes.splats != len(self.splats):
            raise FormatError(f"shapes of {self.shapes.splats} splats are not of the avatar's {len(self.splats)}")
        if len(self.skin) and int(self.skin.joints.max()) >= len(self.skeleton):
            raise FormatError(f"the skin names joint {self.skin.joints.max()} of {len(self.skeleton)}")
        object.__setattr__(self, "skin", self.skin.anchored(self.skeleton.parents))
        object.__setattr__(self, "meta", frozen_mapping(self.meta))
        self._check_levels()

    def weights(self, pose: Pose) -> NDArray[np.float64] | None:
        """Return the clamped weights [T] of the shapes in a pose; None if all are 0 or there are no shapes."""
        return None if self.shapes is None else self.shapes.weights(pose.expression)

    def without(self, joint: str) -> Avatar:
        """Return the avatar without the splats that mostly follow ``joint`` or its descendants: a first-person view.

        Removed splats have a weight above one half there. Raises PoseError if there is no such joint.

        >>> person = glsplat.default_avatar()
        >>> person.without("head")
        Avatar(25672 splats, 55 joints, 4 a splat, 52 shapes, 3 levels)
        """
        return self._part(joint, False)

    def only(self, joint: str) -> Avatar:
        """Return the avatar of the splats that ``without(joint)`` removes, on the same skeleton.

        >>> glsplat.default_avatar().only("head")
        Avatar(14328 splats, 55 joints, 4 a splat, 52 shapes, 3 levels)
        """
        return self._part(joint, True)

    def _part(self, joint: str, there: bool) -> Avatar:
        """Return the splats that mostly follow ``joint`` or its descendants (``there``), or all others."""
        share = (self.skin.weights * self.skeleton.under(joint)[self.skin.joints]).sum(axis=1)
        keep = (share > 0.5) == there
        levels: list[Level[Avatar]] = []
        count = int(keep.sum())
        for level in self.levels:
            rest = level.content._part(joint, there)
            if 0 < len(rest.splats) < count:
                levels.append(replace(level, content=rest))
                count = len(rest.splats)
        shapes = None if self.shapes is None else self.shapes.take(keep)
        splats, skin = self.splats.take(keep), self.skin.take(keep)
        return replace(self, splats=splats, skin=skin, shapes=shapes, levels=tuple(levels))

    def _check_levels(self) -> None:
        if self.splats.levels:
            raise FormatError("levels belong to the avatar, not to its splats")
        found = self.levels if isinstance(self.levels, Levels) else listed(self.levels, "levels")
        sizes = [
            len(self.splats),
            *(len(one.content.splats) for one in found if isinstance(getattr(one, "content", None), Avatar)),
        ]
        object.__setattr__(self, "levels", checked_levels(found, self, self.splats.arrays, sizes) if found else ())
        for i, level in enumerate(self.levels):
            if not level.content.skeleton.same(self.skeleton):
                raise FormatError(f"level {i + 1}: another skeleton than the avatar's")
            if level.content.shapes is not None and (
                self.shapes is None or level.content.shapes.names != self.shapes.names
            ):
                raise FormatError(f"level {i + 1}: its shapes need the avatar's names, in their order")
            if level.content.levels:
                raise FormatError(f"level {i + 1}: a level has no levels of its own")

    def _repr_png_(self) -> bytes | None:
        """Return a picture for notebooks; None where no OpenGL context can be made."""
        picture: bytes | None = import_module("glsplat.renderer.thumbnail").thumbnail(self)  # which imports this module
        return picture

    def __repr__(self) -> str:
        levels = f", {len(self.levels)} levels" if self.levels else ""
        shapes = f", {len(self.shapes)} shapes" if self.shapes is not None else ""
        parts = f"{len(self.splats)} splats, {len(self.skeleton)} joints, {self.skin.influences} a splat"
        return f"Avatar({parts}{shapes}{levels})"


def splats_of(scene: Splats | Avatar) -> Splats:
    """Return the splats of an avatar, or the splats themselves."""
    return scene.splats if isinstance(scene, Avatar) else scene
