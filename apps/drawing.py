"""The renderer as the server sees it. Imports little: the process that draws is to be ready soon."""

from __future__ import annotations

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.net.backend import Rendered
from glsplat.net.messages import RenderRequest
from glsplat.splats import Splats

__all__ = ["RendererBackend"]


class RendererBackend:
    """Draws one scene. Pictures of different sizes may follow each other."""

    def __init__(
        self,
        scene: Splats | Avatar,
        pixels: tuple[int, int],
        device: str | None = None,
        config: RenderConfig | None = None,
    ) -> None:
        self._scene, self._pixels, self._device = scene, pixels, device
        self._config = config or RenderConfig()

    def open(self) -> str:
        """Make the context, load the scene, and draw once so that no client waits for the shaders."""
        from glsplat.context import create_context  # here: the module can be imported without a driver
        from glsplat.renderer import Renderer

        self._context = create_context(self._device)
        self._mark = 0
        try:
            self._renderer = Renderer(
                self._scene, size=self._pixels, views=2, config=self._config, context=self._context
            )
            view = Camera(look_at((0, 1.2, 2.0), (0, 1, 0)), pinhole(*self._pixels), *self._pixels)
            self._renderer.render([view, view])
        except BaseException:
            self._context.release()
            del self._context
            raise
        return self._renderer.driver

    def render(self, request: RenderRequest) -> Rendered:
        """Draw all eyes of a request in one call. Raises ContextError when the context is lost."""
        renderer, first = self._renderer, request.cameras[0]
        try:
            renderer.resize(first.width, first.height)
            images = renderer.render(request.cameras, request.pose)
            if self._context.ctx.error != "GL_NO_ERROR":  # reading it clears it
                raise GlsplatError(f"{renderer.driver} reports an OpenGL error: the picture is not to be trusted")
        except PoseError:  # before anything was drawn
            raise
        except Exception:
            self._check_alive()
            renderer.load(self._scene)  # whatever was half done must not be taken for finished
            renderer.drop_targets()
            raise
        self._check_alive()
        return Rendered(images, dict(renderer.timings), renderer.driver, renderer.stats.covered)

    def _check_alive(self) -> None:
        """Write a number through the context and read it back.

        A lost context ignores calls and need not report it: what is "read" then is whatever lay in memory, such as
        somebody else's picture.
        """
        self._mark = (self._mark + 1) % 2**32
        expected = self._mark.to_bytes(4, "little")
        red, green, blue, alpha = (byte / 255 for byte in expected)
        self._context.scratch.clear(red, green, blue, alpha)
        if self._context.scratch.read(components=4) != expected:
            raise ContextError(f"{self._renderer.driver} does nothing any more") from None

    def close(self) -> None:
        """Release the renderer and its context."""
        if hasattr(self, "_context"):
            self._renderer.release()
            self._context.release()
            del self._context
