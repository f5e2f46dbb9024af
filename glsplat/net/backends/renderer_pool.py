"""What clients may be shown: the scene, or one of the avatars offered beside it; each whole, or without parts of it.

Every one of them has a renderer of its own on one context, made when it is first asked for, so that clients who look at
different ones do not undo each other's work, and a server of one thing makes one renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.net.backend import RenderJob
from glsplat.net.backends.figure_bounds import FigureBounds
from glsplat.net.backends.room import LABEL_SIGMAS, RoomRenderer, label_of, selectors
from glsplat.net.labels import Label
from glsplat.renderer import Prepared, Renderer
from glsplat.renderer.checks import checked_pose
from glsplat.renderer.lru_cache import LruCache
from glsplat.scene import Item, Rigged, Scene, SceneLike, is_rigged
from glsplat.scenes.scene_file import SceneFile
from glsplat.skinning.skeleton import Skeleton

__all__ = ["KEPT", "RendererPool", "SceneRenderer"]

KEPT = 4
"""Renderers at most: the default avatar with and without its head, and two others."""

_FEET = ("left_ankle", "left_foot", "right_ankle", "right_foot")

_PLACE_SIGMAS = 2.0  # standard deviations of a splat that the box of an avatar counts

_KEPT_BYTES = 2**29  # of the GPU's memory, by those that are not in use

Key = tuple[str, tuple[str, ...] | None]
"""Name of an avatar and its parts that are left out, or name of a room and None."""


class SceneRenderer:
    """One thing that is shown, and what draws it. ``make`` makes the renderer."""

    def __init__(self, scene: Scene, hide: tuple[str, ...], make: Callable[[Scene], Renderer]) -> None:
        self._source = self._item = SceneFile.of(scene).avatar
        if hide:
            self._item = _without(self._source, hide)
        figure = None if self._item is None or not is_rigged(self._item.content) else self._item.content
        self._bounds = None if figure is None else FigureBounds(figure, _PLACE_SIGMAS)
        self._label_bounds = None if figure is None else FigureBounds(figure, LABEL_SIGMAS, whole=True)
        self._light = scene.light
        items = (self._item if item is self._source and self._item is not None else item for item in scene)
        self.scene: Scene = Scene(items, light=scene.light)  # one of its own: its light is that of the last job
        self.renderer: Renderer = make(self.scene)
        self.selector = selectors()

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return sum(self.renderer.nbytes().values())

    def follow(self, request: RenderJob, seconds: float) -> None:
        """Put what stands in for the scene's avatar where that is now, in the light that was asked for."""
        self.scene.light = request.options.light or self._light
        if self._item is not self._source:
            assert self._item is not None and self._source is not None
            self._item.pose, self._item.transform = self._source.pose, self._source.transform

    def prepare(self, request: RenderJob, max_cost: float) -> Prepared:
        """Prepare the picture of a request that ``follow`` was given, whatever it costs."""
        return self.renderer.prepare(self.views(request), request.pose)

    def views(self, request: RenderJob) -> Sequence[Camera]:
        """As they are asked for: it was made without what its requests hide."""
        return request.cameras

    def labels(self, request: RenderJob) -> list[Label]:
        """The label of the one avatar, if the request has words for it."""
        if not request.label or self._item is None or self._label_bounds is None:
            return []
        pose = self._item.pose if request.pose is None else request.pose
        figure = self._label_bounds.figure
        posed = Item(figure, pose=pose, transform=self._item.transform)
        return [label_of(request.label, posed, figure, self._label_bounds)]

    def places(self, request: RenderJob) -> dict[str, list[float]]:
        """Where the one avatar is, as in Rendered, if the request asks for it and there is one."""
        item = self._item
        if item is None or not request.options.box:
            return {}
        assert self._bounds is not None
        skeleton = self._bounds.figure.skeleton
        posed = checked_pose(item.pose if request.pose is None else request.pose, len(skeleton), "avatar")
        bones = item.transform[:3, :3] @ posed.bones(skeleton)
        bones[:, :, 3] += item.transform[:3, 3]
        found = {"box": self._bounds.box(posed, item.transform), "feet": _feet(skeleton, bones)}
        return {name: array.ravel().tolist() for name, array in found.items() if array is not None}

    def release(self) -> None:
        """Delete what draws it."""
        self.renderer.release()


class RendererPool:
    """The stand of each request. Those used last are kept; the others are made anew when they are asked for.

    ``avatars`` and ``rooms`` are by name; what stands in a room is its background.
    """

    def __init__(
        self,
        scene: SceneLike,
        avatars: Mapping[str, Rigged],
        make: Callable[[Scene], Renderer],
        rooms: Mapping[str, SceneFile] | None = None,
    ) -> None:
        self._scene, self._avatars, self._make, self._rooms = Scene.of(scene), avatars, make, rooms or {}
        self._kept: LruCache[Key, SceneRenderer | RoomRenderer] = LruCache(KEPT + len(self._rooms), _KEPT_BYTES)

    def __len__(self) -> int:
        return len(self._kept)

    def of(self, request: RenderJob) -> SceneRenderer | RoomRenderer:
        """What ``request`` asks to see. Raises GlsplatError where that has no such part."""
        if request.room is None:
            return self.get(request.avatar, request.options.hide)
        background = self._rooms[request.room.room]
        return self._kept.get((request.room.room, None), lambda: RoomRenderer(background, self._figure, self._make))

    def get(self, name: str = "", hide: tuple[str, ...] = ()) -> SceneRenderer | RoomRenderer:
        """One of the avatars by its name, the scene by any other, without the parts ``hide``."""
        shown = name if name in self._avatars else ""
        return self._kept.get((shown, hide), lambda: self._renderer_of(shown, hide))

    @staticmethod
    def write(
        one: SceneRenderer | RoomRenderer, request: RenderJob, images: NDArray[np.uint8]
    ) -> tuple[int, int, int, int]:
        """Write the words of a request into its images [V, H, W, 4]; the box of what changed, which may be empty."""
        labels = one.labels(request)
        if not labels and not request.notice:
            return 0, 0, 0, 0
        from glsplat.net.backends.lettering import draw_labels  # here: OpenCV is of use to few, and slow to load

        return draw_labels(images, request.cameras, labels, request.notice)

    def release(self) -> None:
        """Delete all."""
        self._kept.release()

    def _figure(self, name: str) -> Rigged:
        """An avatar by its name, or the scene's one."""
        if name in self._avatars:
            return self._avatars[name]
        item = SceneFile.of(self._scene).avatar
        if item is None or not is_rigged(item.content):
            raise GlsplatError(f'there is no avatar "{name}" for the people of a room')
        return item.content

    def _renderer_of(self, name: str, hide: tuple[str, ...]) -> SceneRenderer:
        scene = Scene([Item(self._avatars[name])], light=self._scene.light) if name else self._scene
        return SceneRenderer(scene, hide, self._make)


def _without(item: Item | None, parts: tuple[str, ...]) -> Item:
    """The same avatar in the same place without what follows ``parts``, which are names of joints."""
    if item is None or not is_rigged(item.content):
        raise GlsplatError("parts can be left out of one avatar, this scene has none or several")
    avatar: Rigged = item.content
    for part in parts:
        avatar = avatar.without(part)
    return Item(avatar, pose=item.pose, transform=item.transform, name=item.name)


def _feet(skeleton: Skeleton, bones: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """[4, 3] metres, where it stands by ``bones`` [J, 3, 4]; None where the skeleton has no such joints."""
    if not set(_FEET) <= set(skeleton.names):
        return None
    joints = [skeleton.names.index(name) for name in _FEET]
    turned: NDArray[np.float64] = np.einsum("nij,nj->ni", bones[joints, :, :3], skeleton.joints[joints])
    return turned + bones[joints, :, 3]
