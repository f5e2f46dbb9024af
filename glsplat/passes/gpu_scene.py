"""GpuScene: a scene on the GPU. Items are uploaded once and posed when they move.

The arena is made anew when one comes or goes. Clients who look from near and from afar at items with levels of detail
do not undo each other's work: of a single item there is an arena for each level that was drawn lately, of several one
that holds all levels, of which a picture shows some, each posed once a movement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.config import CULL_PSNR, RenderConfig
from glsplat.detail.selector import Selector
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.light.light import Light
from glsplat.meshes import RiggedMesh
from glsplat.passes.arena import Arena
from glsplat.passes.drawable import PASSES, Drawable, Part
from glsplat.passes.frame.draw import PULLED
from glsplat.passes.frame.pipeline import Pipeline, view_state
from glsplat.passes.item.buffers import ItemBuffers, Placement
from glsplat.passes.item.levels import LevelBuffers
from glsplat.passes.item.mesh_pass import MeshItem, MeshPass, MeshPassKind
from glsplat.passes.lru_cache import LruCache
from glsplat.passes.stats import FrameStats
from glsplat.passes.views import checked_pose
from glsplat.scene import Item, Scene, is_rigged
from glsplat.shaders import Programs, variant_for
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from glsplat.timing import StageTimer

__all__ = ["GpuScene"]

_KEPT = 32
"""Choices of levels that are kept at most."""

_KEPT_BYTES = 256 * 2**20
"""What of them is not in use may take, or twice the largest: all levels of one thing are that much."""


_MOST_SPLATS = 2_000_000
"""Of several items, at all their levels of detail, that are held side by side: some 200 MB."""


class GpuScene:
    """Owns the buffers of all items, the arena and the pipelines; scene, context and programs are borrowed."""

    def __init__(self, context: Context, programs: Programs, scene: Scene, config: RenderConfig) -> None:
        self.scene = scene
        self._context, self._programs, self._config = context, programs, config
        self._geometry = config.layers == "geometry" or not context.vertex_layers
        self._triangle = config.shape == "triangle" or (config.shape == "auto" and context.software)
        automatic = config.fetch == "auto" and context.software and context.vertex_storage and self._triangle
        self._pulled = config.fetch == "storage" or automatic
        self._items: dict[int, tuple[Item, LevelBuffers]] = {}  # by id(); the item is kept, so the id stays its own
        self._meshes: dict[int, tuple[Item, MeshItem]] = {}
        self._standing: list[tuple[MeshItem, Placement]] = []  # the visible meshes of this frame
        self._standing_version = 0
        self._grounds: LruCache[tuple[tuple[int, int], int, MeshPassKind, int], MeshPass] = LruCache(
            PASSES, _KEPT_BYTES
        )
        self._samples = config.mesh_samples if context.ctx.max_samples >= config.mesh_samples else 1
        self._drawables: LruCache[tuple[Part, ...], Drawable] = LruCache(_KEPT, _KEPT_BYTES)
        self._drawable: Drawable | None = None  # the one in use
        self._shown: tuple[object, ...] = ()  # what the drawables are made of
        self._coarsest = True  # nothing in view may be drawn with a coarser level than it was
        self._unseen: frozenset[int] = frozenset()  # visible items in none of the views' layers, by id()
        self.arenas = 0  # made so far
        self._present: tuple[Item, ...] = ()  # of the scene as the frame's beginning finds it: other threads change it
        self.light: Light | None = None  # of the scene, likewise
        self._transform = scene.transform  # likewise
        self._visible: list[Item] = []  # the visible splat items among them, in order
        self._visible_meshes: list[Item] = []
        try:
            self._look(-1)
            places = [self._placement(item, None) for item in self._visible]
            self._stage(self._visible, [self._at_first(item) for item in self._visible], places)
        except BaseException:
            self.release()
            raise

    @property
    def arena(self) -> Arena:
        """All visible splats."""
        assert self._drawable is not None
        return self._drawable.arena

    @property
    def splats(self) -> int:
        """Splats of what is shown, drawable or not."""
        return sum(item.count + item.skipped for item in self._shown_items)

    @property
    def _shown_items(self) -> list[ItemBuffers]:
        return [self.arena.items[index] for index in self.arena.shown]

    def nbytes(self) -> dict[str, int]:
        """GPU bytes: splats (items and arena), sh, work (keys, order, records)."""
        drawables = list(self._drawables)
        arenas = [drawable.arena for drawable in drawables]
        return {
            "splats": sum(levels.nbytes for _, levels in self._items.values()) + sum(a.nbytes for a in arenas),
            "meshes": sum(mesh.buffers.nbytes for _, mesh in self._meshes.values()) + self._grounds.nbytes,
            "sh": sum(arena.colour_nbytes for arena in arenas),
            "work": sum(drawable.pipelines.nbytes for drawable in drawables),
        }

    def update(self, views: Sequence[Camera], pose: Pose | None, selector: Selector, timer: StageTimer) -> FrameStats:
        """Follow the scene: what came, went, moved, and how near it is looked at. Gives what is known before drawing.

        ``pose`` is for the one avatar of a scene, if there is one. Items in none of the views' layers are not shown.
        """
        self._look(views[0].layers)
        visible = self._visible
        if pose is not None:
            if not isinstance(pose, Pose):
                raise PoseError(
                    f"render needs a glsplat.Pose, not {type(pose).__name__}; make one of your values first"
                )
            avatars = sum(is_rigged(item.content) for item in (*visible, *self._visible_meshes))
            if avatars > 1:
                raise PoseError(f"render() got one pose for {avatars} avatars; set the pose of each item instead")
        places = [self._placement(item, pose) for item in visible]
        levels = [
            max(level, min(item.finest, self._levels_of(item).coarsest))
            for item, level in zip(visible, self._choose(visible, places, views, selector), strict=True)
        ]
        self._stage(visible, levels, places)
        self._stand(pose)
        if self._standing or any(place.bones is not None for place in places):
            timer.mark("pose")
        assert self._drawable is not None
        parts = [part for part in enumerate(levels) if id(visible[part[0]]) not in self._unseen]
        arena, before = self.arena, self.arena.runs
        eye = views[0].position
        if arena.place({self._drawable.parts.index(part): places[part[0]] for part in parts}, eye):
            timer.mark("skin")
        skipped = sum(item.skipped for item in self._shown_items)
        of_shown, posed = tuple(level for _, level in parts), arena.runs - before
        return FrameStats(self.splats, 0, skipped, sorted=False, posed=posed, levels=of_shown, coarsest=self._coarsest)

    def ground(
        self, views: Sequence[Camera], ordinal: int, dtype: str, timer: StageTimer, depth: bool = False
    ) -> MeshPass | None:
        """The meshes under these views, drawn; None without any."""
        if not self._standing:
            return None
        kind = MeshPassKind(self._occluded, self._samples, depth and not self._occluded)
        key = ((views[0].width, views[0].height), len(views), kind, min(ordinal, PASSES - 1))
        ground = self._grounds.get(key, lambda: MeshPass(self._context, self._programs, *key[:3], dtype))
        ground.run(views, self._standing, (self._standing_version, tuple(view_state(view) for view in views)))
        timer.mark("mesh")
        return ground

    @property
    def _occluded(self) -> bool:
        """Whether meshes are wanted at the pixel centres: splats are drawn as well, or there are no other samples."""
        return bool(self._standing) and (self._samples == 1 or any(item.count for item in self._shown_items))

    @staticmethod
    def shared(ordinal: int) -> bool:
        """Whether other passes of one call may be drawn by the same pipeline as pass number ``ordinal``."""
        return ordinal >= PASSES - 1

    def pipeline(self, views: Sequence[Camera], ordinal: int, depth: bool = False) -> Pipeline:
        """What draws these views, as pass number ``ordinal`` of the call."""
        variant = variant_for(
            len(views),
            self._config,
            stored_degree=self.arena.degree,
            sh_degree=views[0].sh_degree,
            posed=self.arena.posed,
            antialias=frozenset(item.splats.antialias for item in self.arena.items) or frozenset({False}),
            geometry=self._geometry,
            triangle=self._triangle,
            pulled=self._pulled and (self._config.fetch == "storage" or self.arena.shown_splats <= PULLED),
            depth=depth,
            occluded=self._occluded,
            sampled=self._samples if self._standing and self._samples > 1 else 0,
            numbered=not self._context.vertex_ids,
            cones=self.arena.cones is not None,
            lit=self.light is not None and self.arena.surfaced,
        )
        assert self._drawable is not None
        parts = (self._context, self._programs, variant, self.arena, self._config)
        return self._drawable.pipeline(variant, (views[0].width, views[0].height), ordinal, lambda: Pipeline(*parts))

    def add_costs(self, pipeline: Pipeline, costs: dict[Item, int]) -> int:
        """Add what a pipeline has counted of each item that it shows, if it has; returns what it has counted of all."""
        assert self._drawable is not None
        for index, cost in zip(self.arena.shown, pipeline.item_costs, strict=False):
            item = self._visible[self._drawable.parts[index][0]]
            costs[item] = costs.get(item, 0) + cost
        return pipeline.cost or 0

    def release(self) -> None:
        """Delete everything; may be called twice."""
        self._drawable = None
        self._drawables.release()
        self._grounds.release()
        meshes, self._meshes, self._standing = self._meshes, {}, []
        for _, mesh in meshes.values():
            mesh.release()
        items, self._items = self._items, {}
        for _, levels in items.values():
            levels.release()

    def _look(self, layers: int) -> None:
        """Which items there are, and which of them are visible and in the views' layers, once a frame."""
        self._present, self.light, self._transform = self.scene.items, self.scene.light, self.scene.transform
        visible = [item for item in self._present if item.visible]
        self._unseen = frozenset(id(item) for item in visible if not item.layers & layers)
        self._visible = [item for item in visible if not isinstance(item.content, RiggedMesh)]
        self._visible_meshes = [item for item in visible if isinstance(item.content, RiggedMesh)]

    def _stage(self, visible: Sequence[Item], levels: Sequence[int], places: Sequence[Placement]) -> None:
        """Buffers for what is new, an arena that holds what is visible at these levels of detail.

        Nothing of what stands is given up before what replaces it is there.
        """
        parts = self._with_others(visible, levels)
        posed = len(visible) != 1 or isinstance(visible[0].content, Avatar) or places[0].moved
        shown = (posed, *map(id, visible))
        if shown != self._shown or self._drawable is None:
            made = self._made(visible, parts, posed)
            self._drawables.release()
            self._drawables.most_bytes = max(_KEPT_BYTES, 2 * made.nbytes)
            self._shown = shown
            self._drawable = self._drawables.get(parts, lambda: made)
        else:
            self._drawable = self._drawables.get(parts, lambda: self._made(visible, parts, posed))
        present = {id(item) for item in self._present}
        for gone in [key for key in self._items if key not in present]:
            self._items.pop(gone)[1].release()

    def _with_others(self, visible: Sequence[Item], levels: Sequence[int]) -> tuple[Part, ...]:
        """What an arena that shows these levels holds: of several items all levels, if that is not too much."""
        if len(visible) > 1 and not self._fixed(visible):
            of_items = [self._levels_of(item) for item in visible]
            together = tuple((i, level) for i, one in enumerate(of_items) for level in range(one.coarsest + 1))
            if sum(of_items[i].count(level) for i, level in together) <= _MOST_SPLATS:
                return together
        return tuple(enumerate(levels))

    def _made(self, visible: Sequence[Item], parts: Sequence[Part], posed: bool) -> Drawable:
        staged = [self._levels_of(item) for item in visible]
        if self._config.cull_hidden is True and staged and not any(one.has_cones for one in staged):
            raise GlsplatError(
                "cull_hidden needs splats with visibility cones, this scene has none; "
                "make them (glsplat avatar cones, glsplat.extras.authoring.cones.with_cones) or leave cull_hidden off"
            )
        buffers = [staged[i].get(level) for i, level in parts]
        self.arenas += 1
        made = Drawable(self._arena_of(buffers, posed, [i for i, _ in parts]), tuple(parts))
        self._drawables.most_bytes = max(self._drawables.most_bytes, 2 * made.nbytes)
        return made

    def _levels_of(self, item: Item) -> LevelBuffers:
        if id(item) not in self._items:
            content = item.content
            assert not isinstance(content, RiggedMesh)
            self._items[id(item)] = item, LevelBuffers(content, self._buffers_of)
        return self._items[id(item)][1]

    def _at_first(self, item: Item) -> int:
        """The level before anybody has looked: what was asked for, else the one that is loaded soonest."""
        coarsest = len(item.content.levels) if not isinstance(item.content, RiggedMesh) else 0
        return coarsest if self._config.level == "auto" else min(int(self._config.level), coarsest)

    def _fixed(self, visible: Sequence[Item]) -> bool:
        """Whether levels do not depend on the view."""
        return self._config.level != "auto" or not any(self._at_first(item) for item in visible)

    def _choose(
        self, visible: Sequence[Item], places: Sequence[Placement], views: Sequence[Camera], selector: Selector
    ) -> list[int]:
        """The level of each visible item for what is looked at."""
        self._coarsest = True
        if self._fixed(visible):
            return [self._at_first(item) for item in visible]
        things = zip(map(self._levels_of, visible), places, strict=True)
        seen = [(thing.number, thing.densities, thing.density(place, views)) for thing, place in things]
        levels = selector.choose(seen, self._config.lod_bias)
        self._coarsest = selector.coarsest
        return levels

    def _stand(self, pose: Pose | None) -> None:
        """Where the visible meshes are; what is gone is released."""
        standing = []
        for item in self._visible_meshes:
            if id(item) not in self._unseen:
                if id(item) not in self._meshes:
                    assert isinstance(item.content, RiggedMesh)
                    self._meshes[id(item)] = item, MeshItem(self._context, item.content, self._config.mesh_anisotropy)
                standing.append((self._meshes[id(item)][1], self._placement(item, pose)))
        same = len(standing) == len(self._standing) and all(
            mesh is old and place.same(before)
            for (mesh, place), (old, before) in zip(standing, self._standing, strict=True)
        )
        if not same:
            self._standing_version += 1
        self._standing = standing
        present = {id(item) for item in self._present}
        for gone in [key for key in self._meshes if key not in present]:
            self._meshes.pop(gone)[1].release()

    def _buffers_of(self, content: Splats | Avatar) -> ItemBuffers:
        context, config = self._context, self._config
        splats = content.splats if isinstance(content, Avatar) else content
        skin, shapes, joints = None, None, 0
        if isinstance(content, Avatar):
            skin, shapes, joints = content.skin, content.shapes, len(content.skeleton)
            if config.influences:
                skin = skin.reduced(config.influences).anchored(content.skeleton.parents)
            if joints > context.max_size:
                raise ContextError(f"{joints} joints, but a texture of {context.driver} holds {context.max_size}")
        return ItemBuffers(context, self._programs, splats, skin, joints, config.rotation == "raw", shapes)

    def _arena_of(self, buffers: Sequence[ItemBuffers], posed: bool, kinds: Sequence[int]) -> Arena:
        config = self._config
        degree = min(max((item.splats.sh_degree for item in buffers), default=0), config.sh_degree)
        mixed = config.antialias is None and len({item.splats.antialias for item in buffers}) > 1
        culled = [item.splats.cones is not None and _culled(item.splats, config) for item in buffers]
        return Arena(self._context, buffers, posed=posed, degree=degree, signed=mixed, culled=culled, kinds=kinds)

    def _placement(self, item: Item, pose: Pose | None) -> Placement:
        transform = self._transform @ item.transform
        linear = transform[:3, :3]
        size = 1.0 if np.array_equal(transform, np.eye(4)) else float(np.cbrt(np.linalg.det(linear)))
        bones = weights = None
        if not isinstance(item.content, Splats):
            skeleton = item.content.skeleton
            wanted = pose if pose is not None and is_rigged(item.content) else item.pose
            posed = checked_pose(wanted, len(skeleton), "avatar")
            bones = posed.bones(skeleton)
            if isinstance(item.content, Avatar):
                weights = item.content.weights(posed)
        return Placement(linear / size, transform[:3, 3], size, bones, item.opacity, weights)


def _culled(splats: Splats, config: RenderConfig) -> bool:
    """Whether what the cones of these splats hide is left out."""
    if config.cull_hidden == "auto":
        return splats.cones_psnr is not None and splats.cones_psnr >= CULL_PSNR
    return config.cull_hidden
