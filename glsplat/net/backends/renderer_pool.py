"""RendererPool: a renderer for the scene, for each avatar and for each room, all on one context.

Each is made on first use. Clients who view different things do not reload each other's renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import RenderJob
from glsplat.net.backends.scene_renderer import SceneRenderer
from glsplat.renderer import Renderer
from glsplat.renderer.owned import LruCache
from glsplat.scene import Item, Rigged, Scene, SceneLike, is_rigged

MAX_RENDERERS = 4
"""Renderers of the scene and of avatars; those of rooms are added."""

_MAX_IDLE_BYTES = 2**29  # of GPU memory, by renderers that are not in use


class RendererPool:
    """The renderer of each job. The most recently used ones are kept. ``avatars`` and ``rooms`` are by name."""

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
        """Return the renderer of a job."""
        if job.room is None:
            return self.get(job.avatar)
        name = job.room.room
        return self._cache.get(("", name), lambda: SceneRenderer(self._rooms[name], self._make, self._figure))

    def get(self, name: str = "") -> SceneRenderer:
        """Return the renderer of an avatar by its name, or of the scene by any other name."""
        shown = name if name in self._avatars else ""
        return self._cache.get((shown, ""), lambda: SceneRenderer(self._shown(shown), self._make))

    @staticmethod
    def write(job: RenderJob, images: NDArray[np.uint8]) -> tuple[int, int, int, int]:
        """Write the notice of a job into its images [V, H, W, 4]; return the box that changed."""
        if not job.notice:
            return 0, 0, 0, 0
        from glsplat.net.backends.lettering import write_notice  # loaded late: few need OpenCV, and it loads slowly

        return write_notice(images, job.cameras, job.notice)

    def release(self) -> None:
        """Release all renderers."""
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
