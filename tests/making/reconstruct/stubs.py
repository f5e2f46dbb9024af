"""Reconstructors that need no work: they note what they are given and hand back the embedded avatar, or fail."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.making.fit.fit import fit_body
from glsplat.making.fit.view import View

__all__ = ["Detailed", "Plain", "small_avatar"]


def small_avatar(count: int = 200) -> Avatar:
    """A few splats of the embedded person, without notes."""
    avatar = default_avatar()
    keep = np.zeros(len(avatar.splats), bool)
    keep[:: len(keep) // count] = True
    return replace(avatar, splats=avatar.splats.take(keep), skin=avatar.skin.take(keep), meta={})


@dataclass
class Plain:
    """Does what the protocol says and no more."""

    result: Any = field(default_factory=small_avatar)
    calls: list[tuple[Any, Any, Any]] = field(default_factory=list)

    def reconstruct(self, pictures: Any, masks: Any, options: Any) -> Any:
        self.calls.append((pictures, masks, options))
        options.progress("standing in", 0.5)
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


@dataclass
class Made:
    """What the built-in reconstructor tells beside the avatar."""

    avatar: Avatar
    fit: Any = None
    mesh: Any = None
    unseen: float = 0.43
    problem: str = ""


@dataclass
class Detailed(Plain):
    """Tells more, as the built-in one does; with ``fitted`` from a real fit."""

    problem: str = ""
    fitted: bool = False

    def make(self, pictures: Any, masks: Any, options: Any) -> Made:
        self.calls.append((pictures, masks, options))
        fit = None
        if self.fitted:
            views = []
            for side, picture in pictures.items():
                body = picture.person.body
                focal = picture.focal or 1.2 * max(picture.rgb.shape)
                views.append(View(masks[side], body.points, body.visible, focal, side=side))
            fit = fit_body(views, options.height)
        return Made(self.result, fit, problem=self.problem)
