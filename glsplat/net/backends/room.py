"""A room as the renderer sees it: a scene with a background, and an item or two a person who is there."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.errors import GlsplatError, PoseError
from glsplat.net.backend import RenderJob
from glsplat.net.backends.budget import others_share
from glsplat.net.backends.figure_bounds import FigureBounds
from glsplat.net.labels import Label
from glsplat.renderer import Prepared, Renderer
from glsplat.renderer.levels import Selector
from glsplat.scene import Item, Rigged, Scene
from glsplat.scenes.scene_file import SceneFile

if TYPE_CHECKING:
    from glsplat.net.room_view import RoomView, VisiblePerson

__all__ = ["LABEL_SIGMAS", "RoomRenderer", "label_of"]

log: logging.Logger = logging.getLogger("glsplat.net")

_ABOVE = 0.3  # metres from the joint of the head to the middle of the label, of a person of the height ...
_TALL = 1.7  # ... metres

LABEL_SIGMAS = 4.0
"""Standard deviations of a splat that its label counts: a fifth more than where all of them have ended, as what is
projected beside the picture comes out a little larger (RenderConfig.max_sigma)."""

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
    bounds: FigureBounds
    items: tuple[Item, ...]
    head: Item | None = None  # not shown without a head
    headless: Item | None = None  # shown only then

    @property
    def splats(self) -> int:
        """Of the finest level of detail; none of a mesh."""
        contents = (item.content for item in self.items)
        return sum(len(content.splats) for content in contents if isinstance(content, Avatar))


class RoomRenderer:
    """What draws one room for all who are in it. ``figure_of`` gives the avatars by name, ``make`` the renderer."""

    def __init__(
        self, background: SceneFile, figure_of: Callable[[str], Rigged], make: Callable[[Scene], Renderer]
    ) -> None:
        self._background, self._figure_of = background, figure_of
        self._people: dict[int, _Shown | None] = {}  # by key; None: their avatar cannot be had
        self._unfit: set[int] = set()  # keys of those whose pose cannot be drawn
        self.scene: Scene = Scene(background.scene, light=background.scene.light)
        self.renderer: Renderer = make(self.scene)
        self.selector = selectors()

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return sum(self.renderer.nbytes().values())

    def follow(self, job: RenderJob, seconds: float) -> None:
        """Bring everybody to where they are; ``seconds`` is the time of the background's motions.

        The light is the viewer's own, if they sent one. Whose avatar cannot be had, or cannot take their pose, is left
        out of the others' pictures.

        Raises GlsplatError where the viewer's own avatar cannot be had: nobody else is touched.
        """
        view = _view(job)
        self.scene.light = job.options.light or self._background.scene.light
        new = {one.key: self._enter(one, view) for one in view.people if self._missing(one.key, view)}
        here = {one.key for one in view.people}
        for gone in [key for key in self._people if key not in here]:
            for item in _items(self._people.pop(gone)):
                self.scene.remove(item)
        for key, shown in new.items():
            self._people[key] = shown
            for item in _items(shown):
                self.scene.add(item)
        self._unfit = {one.key for one in view.people if not self._pose(one, one.key == view.viewer)}
        self._set_layers(view, self._unfit if job.others else here - {view.viewer})
        self._background.pose_at(seconds)

    def prepare(self, job: RenderJob, max_cost: float) -> Prepared:
        """Prepare the picture of a request that ``follow`` was given, of which ``max_cost`` covered pixels are drawn.

        Others who add too much to it (``others_share``) are drawn at their coarsest level of detail, then left out.
        So only the background and the viewer's own avatar can cost more than ``max_cost``.
        """
        view, views, renderer = _view(job), self.views(job), self.renderer
        others = [shown for key, shown in self._people.items() if shown is not None and key != view.viewer]
        if not (others and job.others):
            return renderer.prepare(views)
        share = job.others * others_share(max_cost, views, sum(shown.splats for shown in others))
        each = {one: job.others * others_share(max_cost, views, one.splats, each=True) for one in others if one.splats}
        prepared = renderer.prepare(views)
        posed = renderer.stats.posed
        for reduce in (_coarser, _left_out, _left_out):  # again, should costs have been other than were expected
            if prepared.cost <= min(share, max_cost, *each.values()):
                break
            prepared = renderer.prepare(views, itemised=True)
            costs = {one: sum(prepared.items.get(item, 0) for item in one.items) for one in each}
            room = min(share, max_cost - (prepared.cost - sum(costs.values())))
            if room < 0 or (sum(costs.values()) <= room and all(costs[one] <= each[one] for one in each)):
                break
            reduce(costs, each, room)
            prepared = renderer.prepare(views)
        renderer.stats = replace(renderer.stats, posed=posed)
        return prepared

    def views(self, job: RenderJob) -> list[Camera]:
        """The cameras of a request that ``follow`` was given, in the layers of what its viewer sees."""
        view = _view(job)
        keys = [one.key for one in view.people]
        hidden = "head" in job.options.hide and view.viewer in keys
        layers = _ROOM | (_own(keys.index(view.viewer)) if hidden else _HEADS)
        return [replace(camera, layers=layers) for camera in job.cameras]

    def labels(self, job: RenderJob) -> list[Label]:
        """The labels of all, those that cost too much included; the viewer's own only where that head is seen."""
        view = _view(job)
        headless = "head" in job.options.hide
        people = [one for one in view.people if one.label and not (one.key == view.viewer and headless)]
        return [
            label_of(one.label, shown.items[0], shown.figure, shown.bounds, one.opacity)
            for one in people
            if (shown := self._people[one.key]) is not None and one.key not in self._unfit
        ]

    def places(self, job: RenderJob) -> dict[str, list[float]]:
        """None: there are several."""
        return {}

    def release(self) -> None:
        """Delete what draws it."""
        self.renderer.release()

    def _missing(self, key: int, view: RoomView) -> bool:
        """Whether somebody's avatar has to be had yet; where that failed, only for themselves once more."""
        return key not in self._people or (self._people[key] is None and key == view.viewer)

    def _enter(self, one: VisiblePerson, view: RoomView) -> _Shown | None:
        """What is shown of somebody who is new. Raises what keeps the viewer's own avatar from being had."""
        try:
            return _shown(one, self._figure_of(one.avatar))
        except (GlsplatError, OSError, KeyError) as error:
            if one.key == view.viewer:
                raise
            log.warning("person %d of a room is not shown to the others: %s", one.key, error)
            return None

    def _pose(self, one: VisiblePerson, own: bool) -> bool:
        """Bring somebody to where they are; whether that can be. Raises what keeps the viewer's ``own`` from it."""
        try:
            for item in _items(self._people[one.key]):
                item.pose, item.transform, item.opacity, item.finest = one.pose, one.transform, one.opacity, 0
        except GlsplatError as error:
            if own:
                raise
            if one.key not in self._unfit:
                log.warning("person %d of a room is not shown to the others: %s", one.key, error)
            return False
        return True

    def _set_layers(self, view: RoomView, out: Collection[int]) -> None:
        """Who has faded, or is in ``out``, is in none."""
        for place, one in enumerate(view.people):
            shown = self._people[one.key]
            for item in _items(shown):
                item.layers = 0 if item.opacity == 0 or one.key in out else _ROOM
            if shown is not None and shown.head is not None and shown.head.layers:
                shown.head.layers = ~(_ROOM | _own(place))
            if shown is not None and shown.headless is not None and shown.headless.layers:
                shown.headless.layers = _own(place)


def selectors() -> Callable[[int], Selector]:
    """Gives each viewer, by number, the one that it had."""
    return lru_cache(_VIEWERS)(lambda viewer: Selector())


def label_of(text: str, item: Item, figure: Rigged, bounds: FigureBounds, opacity: float = 1.0) -> Label:
    """The label of a figure as ``item`` poses and places it: over its head, or over the highest joint of others.

    As the splats of a body lie several deep, it fades later than each of them does.
    """
    skeleton = figure.skeleton
    rest = skeleton.rest[:, :3, 3]
    joint = skeleton.names.index("head") if "head" in skeleton.names else int(rest[:, 1].argmax())
    bones = np.eye(4)[:3] if item.pose is None else item.pose.bones(skeleton)[joint]
    tall = float(rest[:, 1].max() - rest[:, 1].min())
    above = bones @ np.append(rest[joint], 1.0) + (0, _ABOVE * tall / _TALL, 0)
    place = np.asarray(item.transform[:3, :3] @ above + item.transform[:3, 3], np.float64)
    return Label(text, place, opacity=1 - (1 - opacity) ** 8, box=partial(bounds.box, item.pose, item.transform))


def _own(place: int) -> int:
    """The layer of pictures from the own eyes of who is in that place, without a head."""
    return 4 << place


def _view(job: RenderJob) -> RoomView:
    assert job.room is not None
    return job.room


def _items(shown: _Shown | None) -> tuple[Item, ...]:
    return () if shown is None else shown.items


def _coarser(costs: Mapping[_Shown, int], each: Mapping[_Shown, float], room: float) -> None:
    """Draw those at their coarsest level of detail who cost more than they would, if all took as much at most."""
    left = most = room
    for number, cost in enumerate(sorted(costs.values())):  # what the others leave is shared by those who take more
        most = left / (len(costs) - number)
        left -= min(cost, most)
    for one, cost in costs.items():
        if cost > min(most, each[one]):
            for item in one.items:
                item.finest = len(item.content.levels)  # type: ignore[union-attr]  # no meshes: they have no cost here


def _left_out(costs: Mapping[_Shown, int], each: Mapping[_Shown, float], room: float) -> None:
    """Leave out those who cost more than one may, then those who cost most, until the others fit into ``room``."""
    total = sum(costs.values())
    for one, cost in sorted(costs.items(), key=lambda pair: -pair[1]):
        if total > room or cost > each[one]:
            total -= cost
            for item in one.items:
                item.layers = 0


def _shown(one: VisiblePerson, figure: Rigged) -> _Shown:
    whole, bounds = Item(figure, name=one.name), FigureBounds(figure, LABEL_SIGMAS, whole=True)
    if "head" not in figure.skeleton.names:
        return _Shown(figure, bounds, (whole,))
    if not isinstance(figure, Avatar):
        with suppress(PoseError):  # it is all head
            headless = Item(figure.without("head"), name=one.name)
            return _Shown(figure, bounds, (whole, headless), whole, headless)
        return _Shown(figure, bounds, (whole,))
    rest, head = figure.without("head"), figure.only("head")
    if not len(rest.splats) or not len(head.splats):
        return _Shown(figure, bounds, (whole,))
    parts = Item(rest, name=one.name), Item(head, name=one.name)
    return _Shown(figure, bounds, parts, parts[1])
