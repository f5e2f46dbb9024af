"""GpuScene: a scene on the GPU. Items are uploaded once and posed when they move.

The arena is made again when an item is added or removed. A single item has an arena for each recently drawn level of
detail. Several items share an arena with all their levels, each posed once per movement; a picture shows some of them.
So viewers at different distances do not evict each other's levels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import instance
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.config import CULL_PSNR, RenderConfig
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.light.light import Light
from glsplat.meshes import RiggedMesh
from glsplat.renderer.arena import Arena, Part
from glsplat.renderer.checks import checked_pose
from glsplat.renderer.draw import MAX_PULLED
from glsplat.renderer.levels import ItemLevels, Selector
from glsplat.renderer.mesh_pass import MeshBuffers, MeshPass, MeshPassKind
from glsplat.renderer.owned import LruCache
from glsplat.renderer.pipeline import Pipeline, view_state
from glsplat.renderer.skin import Placement
from glsplat.renderer.stage import ItemBuffers
from glsplat.renderer.stats import FrameStats
from glsplat.scene import Item, Scene, is_rigged
from glsplat.shaders import Programs, variant_for
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from glsplat.timing import StageTimer

PASSES = 4
"""Passes of one call that keep records of their own; later passes share the last ones."""

_MAX_ARENAS = 32  # combinations of levels
_MAX_BYTES = 256 * 2**20
"""Bytes of arenas that are not in use; or twice the largest arena, enough for all levels of one item."""

_MAX_SHARED_SPLATS = 2_000_000
"""Splats of an arena that holds several items at all their levels of detail: about 200 MB."""


class GpuScene:
    """Owns the buffers of all items, the arenas and the mesh passes; scene, context and programs are borrowed."""

    def __init__(self, context: Context, programs: Programs, scene: Scene, config: RenderConfig) -> None:
        self.scene = scene
        self._context, self._programs, self._config = context, programs, config
        self._geometry = config.debug.layers == "geometry" or not context.vertex_layers
        self._triangle = config.debug.shape == "triangle" or (config.debug.shape == "auto" and context.software)
        automatic = config.debug.fetch == "auto" and context.software and context.vertex_storage and self._triangle
        self._pulled = config.debug.fetch == "storage" or automatic
        self._samples = config.debug.mesh_samples if context.ctx.max_samples >= config.debug.mesh_samples else 1
        self._levels: dict[Item, ItemLevels] = {}
        self._buffers: dict[tuple[Item, int], ItemBuffers] = {}  # by level
        self._arenas: LruCache[tuple[Part, ...], Arena] = LruCache(_MAX_ARENAS, _MAX_BYTES)
        self._arena: Arena | None = None  # the one in use
        self._arenas_of: tuple[object, ...] = ()  # the items that the arenas hold
        self._meshes: dict[Item, MeshBuffers] = {}
        self._placed_meshes: list[tuple[MeshBuffers, Placement]] = []  # the visible meshes of this frame
        self._meshes_version = 0
        self._mesh_passes: LruCache[tuple[tuple[int, int], int, MeshPassKind, int], MeshPass] = LruCache(
            PASSES, _MAX_BYTES
        )
        self._coarsest = True  # every item in view is drawn at its coarsest level
        self.arenas = 0  # made so far
        self.light: Light | None = None
        self._transform = scene.transform
        try:
            self._read_scene(-1)
            placements = [self._placement(item, None) for item in self._visible]
            self._stage([self._first_level(item) for item in self._visible], placements)
        except BaseException:
            self.release()
            raise

    @property
    def arena(self) -> Arena:
        """The arena in use, with all visible splats."""
        assert self._arena is not None
        return self._arena

    @property
    def splats(self) -> int:
        """Splats of the shown items, drawable or not."""
        return sum(item.count + item.skipped for item in self.arena.shown_items)

    def nbytes(self) -> dict[str, int]:
        """Return GPU bytes: splats (items and arenas), meshes, sh, work (order, records)."""
        return {
            "splats": sum(buffers.nbytes for buffers in self._buffers.values())
            + sum(arena.geometry_nbytes for arena in self._arenas),
            "meshes": sum(mesh.nbytes for mesh in self._meshes.values()) + self._mesh_passes.nbytes,
            "sh": sum(arena.colour_nbytes for arena in self._arenas),
            "work": sum(arena.pipelines.nbytes for arena in self._arenas),
        }

    def update(
        self, views: Sequence[Camera], pose: Pose | None, selector: Selector, timer: StageTimer
    ) -> tuple[list[Camera], FrameStats]:
        """Update buffers and placements for items that were added, removed or moved, and choose levels of detail.

        Return the views in the scene's own space, and the statistics known before drawing. ``pose`` is for the one
        avatar of a scene. Items in none of the views' layers are not shown.
        """
        self._read_scene(views[0].layers)
        views = [view if self._unplaced else view.in_space(self._transform) for view in views]
        if pose is not None:
            instance(pose, Pose, "render", PoseError, "make one of your values first")
            avatars = sum(is_rigged(item.content) for item in (*self._visible, *self._visible_meshes))
            if avatars > 1:
                raise PoseError(f"render() got one pose for {avatars} avatars; set the pose of each item instead")
        placements = [self._placement(item, pose) for item in self._visible]
        levels = [
            max(level, min(item.finest, self._levels_of(item).coarsest))
            for item, level in zip(self._visible, self._choose(placements, views, selector), strict=True)
        ]
        self._stage(levels, placements)
        self._place_meshes(pose)
        if self._placed_meshes or any(placement.bones is not None for placement in placements):
            timer.mark("pose")
        parts = [part for part in enumerate(levels) if self._visible[part[0]] not in self._hidden]
        arena, before = self.arena, self.arena.runs
        if arena.show({part: placements[part[0]] for part in parts}, views[0].position):
            timer.mark("skin")
        skipped = sum(item.skipped for item in arena.shown_items)
        shown, posed = tuple(level for _, level in parts), arena.runs - before
        stats = FrameStats(self.splats, 0, skipped, sorted=False, posed=posed, levels=shown, coarsest=self._coarsest)
        return views, stats

    @property
    def size(self) -> float:
        """Scale of the scene: metres of the cameras' world per metre of the scene."""
        return 1.0 if self._unplaced else float(np.cbrt(np.linalg.det(self._transform[:3, :3])))

    @property
    def _unplaced(self) -> bool:
        return np.array_equal(self._transform, np.eye(4))

    def mesh_pass(
        self, views: Sequence[Camera], ordinal: int, dtype: str, timer: StageTimer, depth: bool = False
    ) -> MeshPass | None:
        """Draw the meshes for these views and return their pass; None without meshes."""
        if not self._placed_meshes:
            return None
        kind = MeshPassKind(self._occluded, self._samples, depth and not self._occluded)
        key = ((views[0].width, views[0].height), len(views), kind, min(ordinal, PASSES - 1))
        made = self._mesh_passes.get(key, lambda: MeshPass(self._context, self._programs, *key[:3], dtype))
        made.run(views, self._placed_meshes, (self._meshes_version, tuple(view_state(view) for view in views)))
        timer.mark("mesh")
        return made

    @property
    def _occluded(self) -> bool:
        """Whether meshes are drawn at the pixel centres: splats are drawn as well, or there is one sample a pixel."""
        return bool(self._placed_meshes) and (self._samples == 1 or self.arena.shown_splats > 0)

    def pipeline(self, views: Sequence[Camera], ordinal: int, depth: bool = False) -> Pipeline:
        """Return the pipeline that draws these views as pass number ``ordinal`` of the call."""
        arena = self.arena
        variant = variant_for(
            len(views),
            self._config,
            stored_degree=arena.degree,
            sh_degree=views[0].sh_degree,
            posed=arena.posed,
            antialias=frozenset(item.splats.antialias for item in arena.items) or frozenset({False}),
            geometry=self._geometry,  # also for one view: it orders the vertices, and a pair has to equal its renders
            triangle=self._triangle,
            pulled=self._pulled and (self._config.debug.fetch == "storage" or arena.shown_splats <= MAX_PULLED),
            depth=depth,
            occluded=self._occluded,
            sampled=self._samples if self._placed_meshes and self._samples > 1 else 0,
            numbered=not self._context.vertex_ids,
            cones=arena.cones is not None,
            lit=self.light is not None and arena.surfaced,
        )
        key = variant, (views[0].width, views[0].height), min(ordinal, PASSES - 1)
        made = arena.pipelines.get(key, lambda: Pipeline(self._context, self._programs, variant, arena, self._config))
        assert isinstance(made, Pipeline)
        return made

    def shade(self, item: Item, factors: NDArray[np.float32] | None) -> None:
        """Set the light factors [N, 3] of a visible mesh's vertices; None: the mesh is not lit."""
        self._meshes[item].shade(factors)
        self._meshes_version += 1

    def add_costs(self, pipeline: Pipeline, costs: dict[Item, int]) -> int:
        """Add a pipeline's cost of each item to ``costs``, if it was counted; return the pipeline's total cost."""
        for index, cost in zip(self.arena.shown, pipeline.item_costs, strict=False):
            item = self._visible[self.arena.parts[index][0]]
            costs[item] = costs.get(item, 0) + cost
        return pipeline.cost or 0

    def release(self) -> None:
        """Delete everything; may be called twice."""
        self._arena = None
        self._arenas.release()
        self._mesh_passes.release()
        meshes, self._meshes, self._placed_meshes = self._meshes, {}, []
        for mesh in meshes.values():
            mesh.release()
        buffers, self._buffers = self._buffers, {}
        for one in buffers.values():
            one.release()

    def _read_scene(self, layers: int) -> None:
        """Read the scene's items, transform and light once a frame, as other threads may change them during it."""
        items, self.light, self._transform = self.scene.items, self.scene.light, self.scene.transform
        if self.light is not None and not self._unplaced:
            self.light = self.light.turned(self._transform[:3, :3].T / self.size)
        self._present = frozenset(items)
        visible = [item for item in items if item.visible]
        self._hidden = frozenset(item for item in visible if not item.layers & layers)  # by their layers
        self._visible = [item for item in visible if not isinstance(item.content, RiggedMesh)]
        self._visible_meshes = [item for item in visible if isinstance(item.content, RiggedMesh)]
        if self._visible_meshes and self._context.state is not None:
            self._context.state.include_meshes()

    def _stage(self, levels: Sequence[int], placements: Sequence[Placement]) -> None:
        """Upload new items, and use an arena that holds the visible ones at these levels of detail.

        Nothing is released before its replacement exists.
        """
        visible, parts = self._visible, self._arena_parts(levels)
        posed = len(visible) != 1 or isinstance(visible[0].content, Avatar) or placements[0].moved
        arenas_of = (posed, *visible)
        if arenas_of != self._arenas_of or self._arena is None:
            made = self._made(parts, posed)
            self._arenas.release()
            self._arenas.most_bytes = max(_MAX_BYTES, 2 * made.nbytes)
            self._arenas_of = arenas_of
            self._arena = self._arenas.get(parts, lambda: made)
        else:
            self._arena = self._arenas.get(parts, lambda: self._made(parts, posed))
        for key in [key for key in self._buffers if key[0] not in self._present]:
            self._buffers.pop(key).release()
        for item in [item for item in self._levels if item not in self._present]:
            del self._levels[item]

    def _arena_parts(self, levels: Sequence[int]) -> tuple[Part, ...]:
        """Return the parts of an arena for these levels; of several items all levels, up to _MAX_SHARED_SPLATS."""
        if len(self._visible) > 1 and not self._fixed:
            of_items = [self._levels_of(item) for item in self._visible]
            together = tuple((i, level) for i, one in enumerate(of_items) for level in range(one.coarsest + 1))
            if sum(of_items[i].splats(level) for i, level in together) <= _MAX_SHARED_SPLATS:
                return together
        return tuple(enumerate(levels))

    def _made(self, parts: Sequence[Part], posed: bool) -> Arena:
        config, levels = self._config, [self._levels_of(item) for item in self._visible]
        if config.cull_hidden is True and levels and not any(one.has_cones for one in levels):
            raise GlsplatError(
                "cull_hidden needs splats with visibility cones, this scene has none; "
                "make them (glsplat avatar cones, glsplat.extras.authoring.finish.cones.with_cones) "
                "or leave cull_hidden off"
            )
        items = [self._buffers_of(self._visible[number], level) for number, level in parts]
        self.arenas += 1
        made = Arena(
            self._context,
            parts,
            items,
            posed=posed,
            degree=min(max((item.splats.sh_degree for item in items), default=0), config.sh_degree),
            signed=config.antialias is None and len({item.splats.antialias for item in items}) > 1,
            culled=[item.splats.cones is not None and _culled(item.splats, config) for item in items],
        )
        self._arenas.most_bytes = max(self._arenas.most_bytes, 2 * made.nbytes)
        return made

    def _levels_of(self, item: Item) -> ItemLevels:
        if item not in self._levels:
            assert not isinstance(item.content, RiggedMesh)
            self._levels[item] = ItemLevels(item.content)
        return self._levels[item]

    def _buffers_of(self, item: Item, level: int) -> ItemBuffers:
        """Return the buffers of an item at a level, uploaded the first time."""
        if (item, level) not in self._buffers:
            content = self._levels_of(item).contents[level]
            context, programs, config = self._context, self._programs, self._config
            if isinstance(content, Avatar):
                joints, skin = len(content.skeleton), content.skin
                if joints > context.max_size:
                    raise ContextError(f"{joints} joints, but a texture of {context.driver} holds {context.max_size}")
                if config.debug.influences:
                    skin = skin.reduced(config.debug.influences).anchored(content.skeleton.parents)
                raw, shapes = config.debug.rotation == "raw", content.shapes
                made = ItemBuffers(context, programs, content.splats, skin, joints, raw, shapes)
            else:
                made = ItemBuffers(context, programs, content)
            self._buffers[item, level] = made
        return self._buffers[item, level]

    def _first_level(self, item: Item) -> int:
        """Return the level before the first view: the configured one, else the one that loads soonest."""
        coarsest = self._levels_of(item).coarsest
        return coarsest if self._config.level == "auto" else min(int(self._config.level), coarsest)

    @property
    def _fixed(self) -> bool:
        """Whether levels do not depend on the view."""
        return self._config.level != "auto" or not any(self._first_level(item) for item in self._visible)

    def _choose(self, placements: Sequence[Placement], views: Sequence[Camera], selector: Selector) -> list[int]:
        """Return the level of each visible item for these views."""
        self._coarsest = True
        if self._fixed:
            return [self._first_level(item) for item in self._visible]
        items = zip(map(self._levels_of, self._visible), placements, strict=True)
        seen = [
            (one.number, one.densities, one.density(views, None if at.unmoved else at.transform, at.bones))
            for one, at in items
        ]
        levels = selector.choose(seen, self._config.lod_bias)
        self._coarsest = selector.coarsest
        return levels

    def _place_meshes(self, pose: Pose | None) -> None:
        """Upload and place the visible meshes; release those that left the scene."""
        placed = []
        for item in self._visible_meshes:
            if item not in self._hidden:
                if item not in self._meshes:
                    assert isinstance(item.content, RiggedMesh)
                    self._meshes[item] = MeshBuffers(self._context, item.content, self._config.debug.mesh_anisotropy)
                placed.append((self._meshes[item], self._placement(item, pose)))
        same = len(placed) == len(self._placed_meshes) and all(
            mesh is old and placement.same(before)
            for (mesh, placement), (old, before) in zip(placed, self._placed_meshes, strict=True)
        )
        self._meshes_version += not same
        self._placed_meshes = placed
        for gone in [item for item in self._meshes if item not in self._present]:
            self._meshes.pop(gone).release()

    def _placement(self, item: Item, pose: Pose | None) -> Placement:
        bones = weights = None
        if not isinstance(item.content, Splats):
            skeleton = item.content.skeleton
            wanted = pose if pose is not None and is_rigged(item.content) else item.pose
            posed = checked_pose(wanted, len(skeleton), "mesh" if isinstance(item.content, RiggedMesh) else "avatar")
            bones = posed.bones(skeleton)
            if isinstance(item.content, Avatar):
                weights = item.content.weights(posed)
        return Placement(item.transform, bones, item.opacity, weights)


def _culled(splats: Splats, config: RenderConfig) -> bool:
    """Return whether splats hidden by their cones are left out."""
    if config.cull_hidden == "auto":
        return splats.cones_psnr is not None and splats.cones_psnr >= CULL_PSNR
    return config.cull_hidden
