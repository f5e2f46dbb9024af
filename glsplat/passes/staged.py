"""Staged: a scene on the GPU. Items are uploaded once and posed when they move.

The arena is made anew when one comes or goes.

Pipelines (order, records) are kept by variant, size and place in the call, so that clients of several sizes that take
turns, or several passes of one frame, do not overwrite each other's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.passes.arena import Arena
from glsplat.passes.frame.pipeline import Pipeline, view_state
from glsplat.passes.item.buffers import ItemBuffers, Placement
from glsplat.passes.item.ground import Ground, GroundKind, MeshItem
from glsplat.passes.kept import Kept
from glsplat.passes.views import checked_pose
from glsplat.scene import Item, Scene, is_figure
from glsplat.shaders import Programs, Variant, variant_for
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from glsplat.timing import StageTimer

__all__ = ["Staged"]

_PASSES = 4
"""Passes of one call that keep records of their own; later ones share the last place."""

_KEPT = 8
"""Pipelines that are kept at most."""

_KEPT_BYTES = 256 * 2**20
"""What pipelines other than the one in use may take."""

Key = tuple[Variant, tuple[int, int], int]


class Staged:
    """Owns the buffers of all items, the arena and the pipelines; scene, context and programs are borrowed."""

    def __init__(
        self, context: Context, programs: Programs, scene: Scene, config: RenderConfig, geometry: bool, triangle: bool
    ) -> None:
        self.scene = scene
        self._context, self._programs, self._config = context, programs, config
        self._geometry, self._triangle = geometry, triangle
        automatic = config.fetch == "auto" and context.software and context.vertex_storage and triangle
        self._pulled = config.fetch == "storage" or automatic
        self._items: dict[int, tuple[Item, ItemBuffers]] = {}  # by id(); the item is kept, so the id stays its own
        self._meshes: dict[int, tuple[Item, MeshItem]] = {}
        self._standing: list[tuple[MeshItem, Placement]] = []  # the visible meshes of this frame
        self._standing_version = 0
        self._grounds: Kept[tuple[tuple[int, int], int, GroundKind, int], Ground] = Kept(_PASSES, _KEPT_BYTES)
        self._samples = config.mesh_samples if context.ctx.max_samples >= config.mesh_samples else 1
        self._arena: Arena | None = None
        self._pipelines: Kept[Key, Pipeline] = Kept(_KEPT, _KEPT_BYTES)
        self.arenas = 0  # made so far
        try:
            self._stage()
        except BaseException:
            self.release()
            raise

    @property
    def arena(self) -> Arena:
        """All visible splats."""
        assert self._arena is not None
        return self._arena

    @property
    def splats(self) -> int:
        """Splats of the visible items, drawable or not."""
        return sum(item.count + item.skipped for item in self.arena.items)

    @property
    def skipped(self) -> int:
        """Splats that were never uploaded: not finite, or without a rotation."""
        return sum(item.skipped for item in self.arena.items)

    def nbytes(self) -> dict[str, int]:
        """GPU bytes: splats (items and arena), sh, work (keys, order, records)."""
        return {
            "splats": sum(buffers.nbytes for _, buffers in self._items.values()) + self.arena.nbytes,
            "meshes": sum(mesh.buffers.nbytes for _, mesh in self._meshes.values()) + self._grounds.nbytes,
            "sh": self.arena.colour_nbytes,
            "work": self._pipelines.nbytes,
        }

    def update(self, pose: Pose | None, timer: StageTimer) -> None:
        """Follow the scene: what came, went, moved. ``pose`` is for the one avatar of a scene, if there is one."""
        items = self._stage()
        if pose is not None:
            avatars = len(self.scene.figures)
            if avatars > 1:
                raise PoseError(f"render() got one pose for {avatars} avatars; set the pose of each item instead")
        places = [self._placement(item, pose) for item in items]
        self._stand(pose)
        if self._standing or any(place.bones is not None for place in places):
            timer.mark("pose")
        if self.arena.place(places):
            timer.mark("skin")

    def ground(
        self, views: Sequence[Camera], ordinal: int, dtype: str, timer: StageTimer, depth: bool = False
    ) -> Ground | None:
        """The meshes under these views, drawn; None without any."""
        if not self._standing:
            return None
        kind = GroundKind(self._occluded, self._samples, depth and not self._occluded)
        key = ((views[0].width, views[0].height), len(views), kind, min(ordinal, _PASSES - 1))
        ground = self._grounds.get(key, lambda: Ground(self._context, self._programs, *key[:3], dtype))
        ground.run(views, self._standing, (self._standing_version, tuple(view_state(view) for view in views)))
        timer.mark("mesh")
        return ground

    @property
    def _occluded(self) -> bool:
        """Whether meshes are wanted at the pixel centres: splats are drawn as well, or there are no other samples."""
        return bool(self._standing) and (self._samples == 1 or any(item.count for item in self.arena.items))

    @staticmethod
    def shared(ordinal: int) -> bool:
        """Whether other passes of one call may be drawn by the same pipeline as pass number ``ordinal``."""
        return ordinal >= _PASSES - 1

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
            pulled=self._pulled,
            depth=depth,
            occluded=self._occluded,
            sampled=self._samples if self._standing and self._samples > 1 else 0,
            numbered=not self._context.vertex_ids,
        )
        key = (variant, (views[0].width, views[0].height), min(ordinal, _PASSES - 1))
        parts = (self._context, self._programs, variant, self.arena, self._config)
        return self._pipelines.get(key, lambda: Pipeline(*parts))

    def release(self) -> None:
        """Delete everything; may be called twice."""
        self._pipelines.release()
        self._grounds.release()
        meshes, self._meshes, self._standing = self._meshes, {}, []
        for _, mesh in meshes.values():
            mesh.release()
        (arena, self._arena), (items, self._items) = (self._arena, None), (self._items, {})
        if arena is not None:
            arena.release()
        for _, buffers in items.values():
            buffers.release()

    def _stage(self) -> list[Item]:
        """Buffers for what is new, an arena for what is visible; the visible splat items in order.

        Nothing of what stands is given up before what replaces it is there.
        """
        for item in self.scene:
            if id(item) not in self._items and item.visible and not isinstance(item.content, RiggedMesh):
                self._items[id(item)] = item, self._buffers_of(item)
        visible = [item for item in self.scene if item.visible and not isinstance(item.content, RiggedMesh)]
        buffers = [self._items[id(item)][1] for item in visible]
        posed = len(visible) != 1 or isinstance(visible[0].content, Avatar) or _moved(visible[0])
        if self._arena is None or self._arena.items != tuple(buffers) or self._arena.posed != posed:
            arena = self._arena_of(buffers, posed)
            self._pipelines.release()  # they draw the old one
            old, self._arena = self._arena, arena
            if old is not None:
                old.release()
            self.arenas += 1
        present = {id(item) for item in self.scene}
        for gone in [key for key in self._items if key not in present]:
            self._items.pop(gone)[1].release()
        return visible

    def _stand(self, pose: Pose | None) -> None:
        """Where the visible meshes are; what is gone is released."""
        standing = []
        for item in self.scene:
            if item.visible and isinstance(item.content, RiggedMesh):
                if id(item) not in self._meshes:
                    self._meshes[id(item)] = item, MeshItem(self._context, item.content, self._config.mesh_anisotropy)
                standing.append((self._meshes[id(item)][1], self._placement(item, pose)))
        same = len(standing) == len(self._standing) and all(
            mesh is old and place.same(before)
            for (mesh, place), (old, before) in zip(standing, self._standing, strict=True)
        )
        if not same:
            self._standing_version += 1
        self._standing = standing
        present = {id(item) for item in self.scene}
        for gone in [key for key in self._meshes if key not in present]:
            self._meshes.pop(gone)[1].release()

    def _buffers_of(self, item: Item) -> ItemBuffers:
        content, context, config = item.content, self._context, self._config
        splats = content.splats if isinstance(content, Avatar) else content
        assert isinstance(splats, Splats)
        skin, joints = None, 0
        if isinstance(content, Avatar):
            skin, joints = content.skin, len(content.skeleton)
            if config.influences:
                skin = skin.reduced(config.influences).anchored(content.skeleton.parents)
            if joints > context.max_size:
                raise ContextError(f"{joints} joints, but a texture of {context.driver} holds {context.max_size}")
        return ItemBuffers(context, self._programs, splats, skin, joints, config.rotation == "raw")

    def _arena_of(self, buffers: Sequence[ItemBuffers], posed: bool) -> Arena:
        config = self._config
        if config.cull_hidden and buffers and all(item.splats.cones is None for item in buffers):
            raise GlsplatError(
                "cull_hidden needs splats with visibility cones, this scene has none; "
                "make them (glsplat avatar cones, glsplat.making.cones.with_cones) or leave cull_hidden off"
            )
        degree = min(max((item.splats.sh_degree for item in buffers), default=0), config.sh_degree)
        mixed = config.antialias is None and len({item.splats.antialias for item in buffers}) > 1
        return Arena(self._context, buffers, posed=posed, degree=degree, signed=mixed, cones=config.cull_hidden)

    def _placement(self, item: Item, pose: Pose | None) -> Placement:
        linear = item.transform[:3, :3]
        size = float(np.cbrt(np.linalg.det(linear))) if _moved(item) else 1.0
        bones = None
        if not isinstance(item.content, Splats):
            skeleton = item.content.skeleton
            wanted = pose if pose is not None and is_figure(item.content) else item.pose
            bones = checked_pose(wanted, len(skeleton), "avatar").bones(skeleton)
        return Placement(linear / size, item.transform[:3, 3], size, bones)


def _moved(item: Item) -> bool:
    return not np.array_equal(item.transform, np.eye(4))
