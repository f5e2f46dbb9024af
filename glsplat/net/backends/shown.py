"""What clients may be shown: the scene, or one of the avatars offered beside it; each whole, or without parts of it.

Every one of them has a renderer of its own on one context, made when it is first asked for, so that clients who look at
different ones do not undo each other's work, and a server of one thing makes one renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.formats.scene_file import SceneFile
from glsplat.net.messages import RenderRequest
from glsplat.passes.kept import Kept
from glsplat.passes.views import checked_pose
from glsplat.renderer import Renderer
from glsplat.scene import Figure, Item, Scene, Shown, is_figure
from glsplat.skinning.extent import Extent
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import Skin

__all__ = ["KEPT", "Stand", "Stands"]

KEPT = 4
"""Renderers at most: the default avatar with and without its head, and two others."""

_KEPT_BYTES = 2**29  # of the GPU's memory, by those that are not in use

Key = tuple[str, tuple[str, ...]]


class Stand:
    """One thing that is shown, and what draws it. ``make`` makes the renderer."""

    def __init__(self, scene: Scene, hide: tuple[str, ...], make: Callable[[Scene], Renderer]) -> None:
        self._source = self._item = SceneFile.of(scene).avatar
        self._extent: Extent | None = None
        self.scene = scene
        if hide:
            self._item = _without(self._source, hide)
            self.scene = Scene(self._item if item is self._source else item for item in scene)
        self.renderer = make(self.scene)

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return sum(self.renderer.nbytes().values())

    def follow(self) -> None:
        """Put what stands in for the scene's avatar where that is now."""
        if self._item is not self._source:
            assert self._item is not None and self._source is not None
            self._item.pose, self._item.transform = self._source.pose, self._source.transform

    def box(self, pose: Pose | None) -> tuple[float, ...] | None:
        """x, y, z lowest and highest, metres, of the one avatar in ``pose`` (None: as it stands); None without one."""
        item = self._item
        if item is None:
            return None
        avatar = item.content
        assert is_figure(avatar)
        if self._extent is None:
            self._extent = _extent(avatar)
        posed = checked_pose(item.pose if pose is None else pose, len(avatar.skeleton), "avatar")
        bones = item.transform[:3, :3] @ posed.bones(avatar.skeleton)
        bones[:, :, 3] += item.transform[:3, 3]
        box = self._extent.box(bones)
        return None if box is None else tuple(box.ravel().tolist())

    def release(self) -> None:
        """Delete what draws it."""
        self.renderer.release()


class Stands:
    """The stand of each request. Those used last are kept; the others are made anew when they are asked for."""

    def __init__(self, scene: Shown, avatars: Mapping[str, Figure], make: Callable[[Scene], Renderer]) -> None:
        self._scene, self._avatars, self._make = Scene.of(scene), avatars, make
        self._kept: Kept[Key, Stand] = Kept(KEPT, _KEPT_BYTES)

    def __len__(self) -> int:
        return len(self._kept)

    def of(self, request: RenderRequest) -> Stand:
        """What ``request`` asks to see. Raises GlsplatError where that has no such part."""
        return self.get(request.avatar, request.hide)

    def get(self, name: str = "", hide: tuple[str, ...] = ()) -> Stand:
        """One of the avatars by its name, the scene by any other, without the parts ``hide``."""
        shown = name if name in self._avatars else ""
        return self._kept.get((shown, hide), lambda: self._stand(shown, hide))

    def release(self) -> None:
        """Delete all."""
        self._kept.release()

    def _stand(self, name: str, hide: tuple[str, ...]) -> Stand:
        return Stand(Scene.of(self._avatars[name]) if name else self._scene, hide, self._make)


def _without(item: Item | None, parts: tuple[str, ...]) -> Item:
    """The same avatar in the same place without what follows ``parts``, which are names of joints."""
    if item is None or not is_figure(item.content):
        raise GlsplatError("parts can be left out of one avatar, this scene has none or several")
    avatar: Figure = item.content
    for part in parts:
        avatar = avatar.without(part)
    return Item(avatar, pose=item.pose, transform=item.transform, name=item.name)


def _extent(figure: Figure) -> Extent:
    if isinstance(figure, Avatar):
        return Extent.of(figure.splats, figure.skin)
    used = np.unique(figure.faces)
    skin = Skin.create(figure.joints[used], figure.weights[used], len(figure.skeleton))
    return Extent.of_points(figure.vertices[used], skin)
