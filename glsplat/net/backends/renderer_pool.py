"""What clients may be shown: the scene, one of the avatars offered beside it, or a room.

Each has a renderer of its own on one context, made when it is first asked for, so that clients who look at different
ones do not undo each other's work, and a server of one thing makes one renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.net.backend import RenderJob
from glsplat.net.backends.scene_renderer import SceneRenderer
from glsplat.passes.lru_cache import LruCache
from glsplat.renderer import Renderer
from glsplat.scene import Item, Rigged, Scene, SceneLike, is_rigged
from glsplat.scenes.scene_file import SceneFile

__all__ = ["MAX_RENDERERS", "RendererPool"]

MAX_RENDERERS = 4
"""Renderers at most, beside those of rooms: of the scene and three avatars."""

_MAX_IDLE_BYTES = 2**29  # of the GPU's memory, by renderers that are not in use


class RendererPool:
    """The renderer of each request. Those used last are kept; the others are made anew when they are asked for.

    ``avatars`` and ``rooms`` are by name; what stands in a room is its background.
    """

    def __init__(
        self,
        scene: SceneLike | SceneFile,
        avatars: Mapping[str, Rigged],
        make: Callable[[Scene], Renderer],
        rooms: Mapping[str, SceneFile] | None = None,
    ) -> None:
        self._file = scene if isinstance(scene, SceneFile) else SceneFile.of(scene)
        self._avatars, self._make, self._rooms = avatars, make, rooms or {}
        # by the name of an avatar, "" for the scene, and the name of a room
        self._cache: LruCache[tuple[str, str], SceneRenderer] = LruCache(
            MAX_RENDERERS + len(self._rooms), _MAX_IDLE_BYTES
        )

    def __len__(self) -> int:
        return len(self._cache)

    def of(self, job: RenderJob) -> SceneRenderer:
        """Return what draws the job."""
        if job.room is None:
            return self.get(job.avatar)
        name = job.room.room
        return self._cache.get(("", name), lambda: SceneRenderer(self._rooms[name], self._make, self._figure))

    def get(self, name: str = "") -> SceneRenderer:
        """Return what draws one of the avatars by its name, the scene by any other."""
        shown = name if name in self._avatars else ""
        return self._cache.get((shown, ""), lambda: SceneRenderer(self._shown(shown), self._make))

    @staticmethod
    def write(one: SceneRenderer, job: RenderJob, images: NDArray[np.uint8]) -> tuple[int, int, int, int]:
        """Write the words of a job into its images [V, H, W, 4]; return the box of what changed, which may be empty."""
        labels = one.labels(job)
        if not labels and not job.notice:
            return 0, 0, 0, 0
        from glsplat.net.backends.lettering import draw_labels  # here: OpenCV is of use to few, and slow to load

        return draw_labels(images, job.cameras, labels, job.notice)

    def release(self) -> None:
        """Delete all."""
        self._cache.release()

    def _figure(self, name: str) -> Rigged:
        """Return an avatar by its name, or the scene's one."""
        if name in self._avatars:
            return self._avatars[name]
        item = self._file.avatar
        if item is None or not is_rigged(item.content):
            raise GlsplatError(f'there is no avatar "{name}" for the people of a room')
        return item.content

    def _shown(self, name: str) -> SceneFile:
        """Return the scene, or an avatar alone in its light."""
        if not name:
            return self._file
        return SceneFile.of(Scene([Item(self._avatars[name])], light=self._file.scene.light))
