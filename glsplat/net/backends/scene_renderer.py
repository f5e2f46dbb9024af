"""SceneRenderer: draws one scene and the people in it for each client. A client alone is a room of one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.errors import GlsplatError, PoseError
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import RenderJob
from glsplat.net.backends.extent import FigureBounds
from glsplat.net.codec.encoded import GRID_SIDE, DepthGrid, grid_of
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.renderer import Prepared, Renderer
from glsplat.renderer.checks import checked_pose
from glsplat.renderer.levels import Selector
from glsplat.scene import Item, Rigged, Scene, is_rigged
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

_FULL_SHARE_PIXELS = 2 * 2048 * 2048  # of a picture whose full cost others may use; in proportion for smaller ones
_ONE_PERSON = 0.5  # limit for one person, as a share of the limit for all others
_MIN_SPLAT_PIXELS = 64  # covered pixels of each splat and view that are granted in any picture: four blocks
_MIN_ALPHA = 0.1  # of a point that has a depth: the depth of a partly covered pixel is better than an interpolated one


def depth_grids(renderer: Renderer, views: Sequence[Camera], pose: Pose | None = None) -> tuple[DepthGrid, ...]:
    """Return a grid for each view, in its units, of the coarsest level of detail.

    Depth at the picture's own size would take as long as the picture itself (docs/vr.md). Changes the renderer's size,
    selector, step and statistics.
    """
    renderer.selector, renderer.step = Selector(), None
    renderer.resize(GRID_SIDE, GRID_SIDE)
    images, depths = renderer.render([_spread(view) for view in views], pose, depth=True)
    alpha = images[..., 3] / (255 if images.dtype == np.uint8 else 1)
    there = (alpha > _MIN_ALPHA) & (depths > 0)
    return tuple(map(grid_of, np.divide(1, depths, out=np.full(depths.shape, np.nan), where=there)))


def _spread(view: Camera) -> Camera:
    """Return the camera whose pixels are centred at the grid's points; the outermost lie on the picture's rim."""
    width, height = (GRID_SIDE - 1) / view.width, (GRID_SIDE - 1) / view.height
    k = np.array([[width, 0, 0.5], [0, height, 0.5], [0, 0, 1]]) @ view.K
    return replace(view, K=k, width=GRID_SIDE, height=GRID_SIDE)


log: logging.Logger = logging.getLogger("glsplat.net")

_PLACE_SIGMAS = 2.0  # standard deviations of a splat that count for the box of an avatar

_MAX_VIEWERS = 64  # whose levels of detail are remembered

_PEOPLE, _HEADS = 1 << 64, 1 << 65
"""Layers of people, above those of the scene's own items: of everything, and of heads for pictures that hide none. Each
higher layer is of the headless pictures of one person."""

_FEET = ("left_ankle", "left_foot", "right_ankle", "right_foot")


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """The items of one person.

    The head of an avatar of splats is a separate item, so that nothing is posed twice. A mesh has an item with its head
    and one without.
    """

    figure: Rigged
    headless_figure: Rigged
    whole: tuple[Item, ...]
    headless: tuple[Item, ...]  # shown in pictures that hide the person's own head
    split: bool  # ``headless`` lacks the head; False: no picture has needed that yet

    @property
    def items(self) -> tuple[Item, ...]:
        """All items, each once."""
        return tuple(dict.fromkeys(self.whole + self.headless))

    @property
    def splats(self) -> int:
        """Splats of the finest level of detail; 0 of a mesh."""
        contents = (item.content for item in self.whole)
        return sum(len(content.splats) for content in contents if isinstance(content, Avatar))

    def set_layers(self, own: int, visible: bool) -> None:
        """Set the layers of the items, ``own`` being the person's layer; none unless they are ``visible``."""
        for item in self.items:
            if item not in self.whole:
                layers = own
            else:
                layers = _PEOPLE if item in self.headless else (-1 << 65) & ~own
            item.layers = layers if visible else 0


class SceneRenderer:
    """Draws one scene with its people for all its viewers.

    In a room, ``file`` is the scenery and ``figure_of`` returns the avatars of people by name. Without ``figure_of``
    each client views the scene alone and drives its one avatar, if it has one. ``make`` makes the renderer.
    """

    def __init__(
        self, file: SceneFile, make: Callable[[Scene], Renderer], figure_of: Callable[[str], Rigged] | None = None
    ) -> None:
        self._file = file
        self._driven = file.avatar if figure_of is None else None
        self._figure_of = figure_of or self._driven_figure
        self._people: dict[int, _Shown | None] = {}  # by key; None: their avatar cannot be loaded
        self._unfit: set[int] = set()  # keys of people whose pose cannot be drawn
        self._place_bounds = lru_cache(2)(partial(FigureBounds, sigmas=_PLACE_SIGMAS))
        items = (item for item in file.scene if item is not self._driven)
        self.scene: Scene = Scene(items, light=file.scene.light)
        self._view = RoomView("", 0, 0, ())  # of the job that ``follow`` was given
        if self._driven is not None:
            self._replace(0, _shown(self._driven.name, self._driven_figure(""), split=False))
        self.renderer: Renderer = make(self.scene)
        # each viewer, by number, keeps its levels of detail
        self.selector: Callable[[int], Selector] = lru_cache(_MAX_VIEWERS)(lambda viewer: Selector())

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return sum(self.renderer.nbytes().values())

    def follow(self, job: RenderJob, seconds: float) -> None:
        """Update the scene, its people and its light for a job; ``seconds`` is the time of the scene's motions.

        People whose avatar cannot be loaded or posed are left out of the others' pictures. Raises GlsplatError where
        that is the viewer's own avatar, or where it has no head to hide, or nothing else.
        """
        self._file.pose_at(seconds)
        transform = self._file.scene.transform
        self.scene.transform = transform if job.to_user is None else job.to_user @ transform
        self.scene.light = job.options.light or self._file.scene.light
        self._view = view = self._view_of(job)
        if job.room is None and _hides_head(job) and not view.people:
            raise PoseError("parts can be left out of one avatar, this scene has none or several")
        new = {one.key: self._enter(one, job, view) for one in view.people if self._is_missing(one.key, job, view)}
        here = {one.key for one in view.people}
        for gone in self._people.keys() - here:
            self._replace(gone, None)
            del self._people[gone]
        for key, shown in new.items():
            self._replace(key, shown)
        self._unfit = {one.key for one in view.people if not self._pose(one, one.key == view.viewer)}
        self._set_layers(view, self._unfit if job.others else here - {view.viewer})

    def prepare(self, job: RenderJob, max_cost: float) -> Prepared:
        """Prepare the picture of a job after ``follow``, for at most ``max_cost`` covered pixels.

        Other people who add too much to it (``others_share``) are drawn at their coarsest level of detail, then left
        out. So only the scene and the viewer's own avatar can cost more than ``max_cost``.
        """
        view, views, renderer = self._view, self.views(job), self.renderer
        others = [shown for key, shown in self._people.items() if shown is not None and key != view.viewer]
        if not (others and job.others):
            return renderer.prepare(views, None if view.people else job.pose)
        share = job.others * others_share(max_cost, views, sum(shown.splats for shown in others))
        each = {one: job.others * others_share(max_cost, views, one.splats, each=True) for one in others if one.splats}
        prepared = renderer.prepare(views)
        posed = renderer.stats.posed
        for reduce in (_coarser, _left_out, _left_out):  # twice, as costs may differ from the expected ones
            if prepared.cost <= min(share, max_cost, *each.values()):
                break
            prepared = renderer.prepare(views, itemised=True)
            costs = {one: sum(prepared.items.get(item, 0) for item in one.items) for one in each}
            allowance = min(share, max_cost - (prepared.cost - sum(costs.values())))
            if allowance < 0 or (sum(costs.values()) <= allowance and all(costs[one] <= each[one] for one in each)):
                break
            reduce(costs, each, allowance)
            prepared = renderer.prepare(views)
        renderer.stats = replace(renderer.stats, posed=posed)
        return prepared

    def views(self, job: RenderJob) -> list[Camera]:
        """Return the cameras of a job after ``follow``, with the layers that its viewer sees."""
        view = self._view
        keys = [one.key for one in view.people]
        hidden = _hides_head(job) and view.viewer in keys
        people = _PEOPLE | (_own(keys.index(view.viewer)) if hidden else _HEADS)
        return [replace(camera, layers=camera.layers | people) for camera in job.cameras]

    def places(self, job: RenderJob) -> dict[str, list[float]]:
        """Return ``Rendered.places`` of a client's one avatar, if the job requests it."""
        view = self._view
        if job.room is not None or not (job.options.box and view.people):
            return {}
        (one,), shown = view.people, self._people[view.viewer]
        assert shown is not None
        skeleton = shown.figure.skeleton
        pose = checked_pose(one.pose, len(skeleton), "avatar")
        transform = self.scene.transform @ one.transform
        box = self._place_bounds(shown.headless_figure if _hides_head(job) else shown.figure).box(pose, transform)
        found = {"box": box, "feet": _feet(skeleton, pose, transform)}
        return {name: array.ravel().tolist() for name, array in found.items() if array is not None}

    def release(self) -> None:
        """Release the renderer."""
        self.renderer.release()

    def _view_of(self, job: RenderJob) -> RoomView:
        """Return the people in the picture: for a client alone its one avatar, posed by the job or the scene."""
        if job.room is not None:
            return job.room
        one = self._driven
        if one is None:
            return RoomView("", 0, 0, ())
        pose = one.pose if job.pose is None else job.pose
        person = VisiblePerson(0, one.name, job.avatar, pose, one.transform, one.opacity)
        return RoomView("", 0, 0, (person,))

    def _driven_figure(self, name: str) -> Rigged:
        """Return the avatar that a client alone drives."""
        assert self._driven is not None and is_rigged(self._driven.content)
        return self._driven.content

    def _is_missing(self, key: int, job: RenderJob, view: RoomView) -> bool:
        """Return whether a person's items have to be made; after a failure only for the viewer again."""
        if key not in self._people:
            return True
        shown, own = self._people[key], key == view.viewer
        return own and (shown is None or (_hides_head(job) and not shown.split))

    def _enter(self, one: VisiblePerson, job: RenderJob, view: RoomView) -> _Shown | None:
        """Make the items of a person, None where that fails. Raises the error of the viewer's own avatar."""
        own = one.key == view.viewer
        try:
            figure = self._figure_of(one.avatar)
            if own and _hides_head(job):
                return _shown(one.name, figure, split=True)
            try:  # most people of a room hide their own heads: make their items once
                return _shown(one.name, figure, split=job.room is not None)
            except PoseError:  # there is no head, or nothing else
                return _shown(one.name, figure, split=False)
        except (GlsplatError, OSError, KeyError) as error:
            if own:
                raise
            log.warning("person %d of a room is not shown to the others: %s", one.key, error)
            return None

    def _replace(self, key: int, shown: _Shown | None) -> None:
        """Replace a person's items in the scene."""
        for item in _items(self._people.get(key)):
            self.scene.remove(item)
        for item in _items(shown):
            self.scene.add(item)
        self._people[key] = shown

    def _pose(self, one: VisiblePerson, own: bool) -> bool:
        """Pose and place a person; return whether that succeeded. Raises the error of the viewer's ``own`` avatar."""
        finest = 0 if self._driven is None else self._driven.finest
        try:
            for item in _items(self._people[one.key]):
                item.pose, item.transform, item.opacity, item.finest = one.pose, one.transform, one.opacity, finest
        except GlsplatError as error:
            if own:
                raise
            if one.key not in self._unfit:
                log.warning("person %d of a room is not shown to the others: %s", one.key, error)
            return False
        return True

    def _set_layers(self, view: RoomView, out: Collection[int]) -> None:
        """Set the layers of all people; none for people who have faded, or whose key is in ``out``."""
        for index, one in enumerate(view.people):
            shown = self._people[one.key]
            if shown is not None:
                shown.set_layers(_own(index), one.opacity > 0 and one.key not in out)


def others_share(max_cost: float, views: Sequence[Camera], splats: int, each: bool = False) -> float:
    """Return the covered pixels that a room's other people, of that many ``splats``, may add to a viewer's picture.

    The limit is for all of them, or for ``each``. A person whose eyes nearly touch the viewer's needs four fifths of
    the limit for one, a circle of eight people two fifths of the limit for all (docs/protocol.md, section 5). So only
    people who crowd others reach a limit.
    """
    pixels = sum(view.width * view.height for view in views)
    share = (_ONE_PERSON if each else 1.0) * max_cost * pixels / _FULL_SHARE_PIXELS
    return max(share, float(_MIN_SPLAT_PIXELS * len(views) * splats))


def _hides_head(job: RenderJob) -> bool:
    return "head" in job.options.hide


def _own(index: int) -> int:
    """Return the layer of the headless pictures from the eyes of the person at ``index`` of the view."""
    return 1 << (66 + index)


def _items(shown: _Shown | None) -> tuple[Item, ...]:
    return () if shown is None else shown.items


def _shown(name: str, figure: Rigged, split: bool) -> _Shown:
    """Return the items of a person called ``name``, with the head ``split`` off. Raises PoseError without a head."""
    whole = Item(figure, name=name)
    if not split:
        return _Shown(figure, figure, (whole,), (whole,), split)
    rest = figure.without("head")
    if not isinstance(figure, Avatar) or not isinstance(rest, Avatar):
        return _Shown(figure, rest, (whole,), (Item(rest, name=name),), split)
    parts = [Item(part, name=name) for part in (rest, figure.only("head"))]
    return _Shown(figure, rest, tuple(parts), tuple(parts[:1]), split)


def _feet(skeleton: Skeleton, pose: Pose, transform: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the joints of both feet [4, 3] in metres; None where the skeleton lacks them."""
    if not set(_FEET) <= set(skeleton.names):
        return None
    joints = [skeleton.names.index(name) for name in _FEET]
    bones = transform[:3, :3] @ pose.bones(skeleton)[joints]
    turned: NDArray[np.float64] = np.einsum("nij,nj->ni", bones[:, :, :3], skeleton.joints[joints])
    return turned + bones[:, :, 3] + transform[:3, 3]


def _coarser(costs: Mapping[_Shown, int], each: Mapping[_Shown, float], allowance: float) -> None:
    """Draw people at their coarsest level of detail if they cost more than a fair share of ``allowance``."""
    left = most = allowance
    for number, cost in enumerate(sorted(costs.values())):  # costlier people share the rest of cheaper ones
        most = left / (len(costs) - number)
        left -= min(cost, most)
    for one, cost in costs.items():
        if cost > min(most, each[one]):
            for item in one.items:
                item.finest = len(item.content.levels)  # type: ignore[union-attr]  # meshes have no cost


def _left_out(costs: Mapping[_Shown, int], each: Mapping[_Shown, float], allowance: float) -> None:
    """Leave out people above their own limit, then the most costly ones, until the others fit into ``allowance``."""
    total = sum(costs.values())
    for one, cost in sorted(costs.items(), key=lambda pair: -pair[1]):
        if total > allowance or cost > each[one]:
            total -= cost
            for item in one.items:
                item.layers = 0
