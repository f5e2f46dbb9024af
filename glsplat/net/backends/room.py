"""A room as the renderer sees it: a scene with a background, and an item or two a person who is there."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.detail.selector import Selector
from glsplat.errors import PoseError
from glsplat.net.backend import RenderJob
from glsplat.net.backends.labels import Label
from glsplat.renderer import Renderer
from glsplat.scene import Item, Rigged, Scene
from glsplat.scenes.scene_file import SceneFile

if TYPE_CHECKING:
    from glsplat.net.rooms.view import RoomView, VisiblePerson

__all__ = ["RoomRenderer", "label_place"]

_ABOVE = 0.3  # metres from the joint of the head to the middle of the label, of a person of the height ...
_TALL = 1.7  # ... metres

_VIEWERS = 64
"""Whose levels of detail are remembered, of one thing that is shown."""

_ROOM, _HEADS = 1, 2
"""Layers: of all, and of who sees everybody's head. All others are somebody's own."""


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """Somebody's items, of which pictures from their own eyes without a head show others than all other pictures.

    Of splats the head is an item of its own, and nothing is posed twice. A mesh is there with and without.
    """

    figure: Rigged
    items: tuple[Item, ...]
    head: Item | None = None  # not shown without a head
    headless: Item | None = None  # shown only then


class RoomRenderer:
    """What draws one room for all who are in it. ``figure_of`` gives the avatars by name, ``make`` the renderer."""

    def __init__(
        self, background: SceneFile, figure_of: Callable[[str], Rigged], make: Callable[[Scene], Renderer]
    ) -> None:
        self._background, self._figure_of = background, figure_of
        self._people: dict[int, _Shown] = {}
        self.scene: Scene = Scene(background.scene, light=background.scene.light)
        self.renderer: Renderer = make(self.scene)
        self.selector = selectors()

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return sum(self.renderer.nbytes().values())

    def follow(self, job: RenderJob, seconds: float) -> None:
        """Bring everybody to where they are; ``seconds`` is the time of the background's motions.

        The light is the viewer's own, if they sent one.

        Raises GlsplatError where an avatar cannot be had: nobody else is touched.
        """
        view = _view(job)
        self.scene.light = job.options.light or self._background.scene.light
        new = {one.key: _shown(one, self._figure_of(one.avatar)) for one in view.people if one.key not in self._people}
        here = {one.key for one in view.people}
        for gone in [key for key in self._people if key not in here]:
            for item in self._people.pop(gone).items:
                self.scene.remove(item)
        for key, shown in new.items():
            self._people[key] = shown
            for item in shown.items:
                self.scene.add(item)
        for one in view.people:
            for item in self._people[one.key].items:
                item.pose, item.transform, item.opacity = one.pose, one.transform, one.opacity
        self._set_layers(view)
        self._background.pose_at(seconds)

    def views(self, job: RenderJob) -> list[Camera]:
        """The cameras of a request that ``follow`` was given, in the layers of what its viewer sees."""
        view = _view(job)
        keys = [one.key for one in view.people]
        hidden = "head" in job.options.hide and view.viewer in keys
        layers = _ROOM | (_own(keys.index(view.viewer)) if hidden else _HEADS)
        return [replace(camera, layers=layers) for camera in job.cameras]

    def _set_layers(self, view: RoomView) -> None:
        """Who has faded is in none."""
        for place, one in enumerate(view.people):
            shown = self._people[one.key]
            for item in shown.items:
                item.layers = 0 if item.opacity == 0 else _ROOM
            if shown.head is not None and shown.head.layers:
                shown.head.layers = ~(_ROOM | _own(place))
            if shown.headless is not None and shown.headless.layers:
                shown.headless.layers = _own(place)

    def labels(self, job: RenderJob) -> list[Label]:
        """What stands over the heads; over the viewer's own only where that head is seen."""
        view = _view(job)
        headless = "head" in job.options.hide
        people = [one for one in view.people if one.label and not (one.key == view.viewer and headless)]
        return [
            Label(
                one.label,
                label_place(self._people[one.key].items[0], self._people[one.key].figure),
                opacity=one.opacity,
            )
            for one in people
        ]

    def places(self, job: RenderJob) -> dict[str, list[float]]:
        """None: there are several."""
        return {}

    def release(self) -> None:
        """Delete what draws it."""
        self.renderer.release()


def selectors() -> Callable[[int], Selector]:
    """Gives each viewer, by number, the one that it had."""
    return lru_cache(_VIEWERS)(lambda viewer: Selector())


def _own(place: int) -> int:
    """The layer of pictures from the own eyes of who is in that place, without a head."""
    return 4 << place


def _view(job: RenderJob) -> RoomView:
    assert job.room is not None
    return job.room


def label_place(item: Item, figure: Rigged) -> NDArray[np.float64]:
    """[3] in the scene: over the head of a figure as ``item`` poses and places it; over the highest joint of others."""
    skeleton = figure.skeleton
    rest = skeleton.rest[:, :3, 3]
    joint = skeleton.names.index("head") if "head" in skeleton.names else int(rest[:, 1].argmax())
    bones = np.eye(4)[:3] if item.pose is None else item.pose.bones(skeleton)[joint]
    tall = float(rest[:, 1].max() - rest[:, 1].min())
    above = bones @ np.append(rest[joint], 1.0) + (0, _ABOVE * tall / _TALL, 0)
    return np.asarray(item.transform[:3, :3] @ above + item.transform[:3, 3], np.float64)


def _shown(one: VisiblePerson, figure: Rigged) -> _Shown:
    whole = Item(figure, name=one.name)
    if "head" not in figure.skeleton.names:
        return _Shown(figure, (whole,))
    if not isinstance(figure, Avatar):
        with suppress(PoseError):  # it is all head
            headless = Item(figure.without("head"), name=one.name)
            return _Shown(figure, (whole, headless), whole, headless)
        return _Shown(figure, (whole,))
    rest, head = figure.without("head"), figure.only("head")
    if not len(rest.splats) or not len(head.splats):
        return _Shown(figure, (whole,))
    parts = Item(rest, name=one.name), Item(head, name=one.name)
    return _Shown(figure, parts, parts[1])
