"""The preview's window: GLFW's OpenGL context for the renderer, and its events for the viewer."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import moderngl

from glsplat.errors import ContextError
from glsplat.gl.context import Context, create_context

from .viewer import Viewer

NO_DISPLAY = "no display: glsplat preview needs a window; use `glsplat render` or run under xvfb-run"

# highest first: some drivers return exactly the requested version; macOS has at most 4.1
_VERSIONS = ((4, 6), (4, 3), (4, 1), (3, 3))
_REQUIRED = 330


class _Current:
    """moderngl's interface of a context object, on GLFW's current context."""

    def __init__(self, glfw: Any) -> None:
        self._glfw = glfw

    def load_opengl_function(self, name: str) -> int:
        """Return the address of a GL function, 0 if there is none."""
        return ctypes.cast(self._glfw.get_proc_address(name), ctypes.c_void_p).value or 0

    def __enter__(self) -> _Current:
        return self

    def __exit__(self, *_: object) -> None: ...

    def release(self) -> None:
        """Do nothing: the window owns the context."""


class Window:
    """A window and its context; release all its GL objects before the ``with`` block ends."""

    def __init__(self, size: tuple[int, int], title: str, vsync: bool = False, visible: bool = True) -> None:
        self._visible = visible  # False: only its context is used
        self._errors: list[str] = []
        try:
            import glfw  # here: importing it fails if its library is missing
        except (ImportError, OSError) as error:
            raise ContextError(f"the glfw package cannot load its library ({error}); install libglfw3") from None
        self._glfw: Any = glfw
        self._window: Any = None
        # without a callback the package turns every error into a Python warning
        glfw.set_error_callback(self._on_error)
        if not glfw.init():
            raise ContextError(f"{NO_DISPLAY}{self._reason()}")
        try:
            self._window = self._create(size, title)
            glfw.make_context_current(self._window)
            glfw.swap_interval(1 if vsync else 0)
            settings: dict[str, Any] = {"context": _Current(glfw)}
            self._ctx = moderngl.create_context(require=_REQUIRED, **settings)
            # nobody else draws in this window: no state has to be saved
            self.context: Context = replace(create_context(given=self._ctx), state=None)
            self._screen = self._ctx.screen
        except BaseException:
            glfw.terminate()
            raise

    @property
    def size(self) -> tuple[int, int]:
        """Size of the framebuffer in pixels; 0 if iconified. On some screens it exceeds the window's units."""
        width, height = self._glfw.get_framebuffer_size(self._window)
        return int(width), int(height)

    @property
    def text_scale(self) -> float:
        """Scale of text on this screen, at least 1."""
        return float(max(1.0, self._glfw.get_window_content_scale(self._window)[0]))

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """Framebuffer that the next swap() shows."""
        return self._screen

    @property
    def closing(self) -> bool:
        """Whether the user closed the window."""
        return bool(self._glfw.window_should_close(self._window))

    def resize(self, width: int, height: int) -> None:
        """Request another size, in the window's units."""
        self._glfw.set_window_size(self._window, width, height)

    def wait(self, seconds: float | None) -> None:
        """Handle queued events (0), or sleep until an event (None) or at most ``seconds``."""
        if seconds is None:
            self._glfw.wait_events()
        elif seconds > 0:
            self._glfw.wait_events_timeout(seconds)
        else:
            self._glfw.poll_events()

    def wake(self) -> None:
        """End a wait(). Other threads may call this."""
        self._glfw.post_empty_event()

    def swap(self) -> None:
        """Show the drawn framebuffer."""
        self._glfw.swap_buffers(self._window)

    def attach(self, viewer: Viewer) -> None:
        """Send this window's events to ``viewer``."""
        glfw, window = self._glfw, self._window
        keys = _key_names(glfw)
        buttons = {
            glfw.MOUSE_BUTTON_LEFT: "left",
            glfw.MOUSE_BUTTON_MIDDLE: "middle",
            glfw.MOUSE_BUTTON_RIGHT: "right",
        }

        def on_key(_: Any, code: int, scancode: int, action: int, mods: int) -> None:
            if code in (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT):
                viewer.shift = action != glfw.RELEASE
            elif code in keys and action == glfw.RELEASE:
                viewer.release_key(keys[code])
            elif code in keys:
                viewer.press(keys[code], bool(mods & glfw.MOD_SHIFT), action == glfw.REPEAT)

        def on_cursor(_: Any, x: float, y: float) -> None:
            units = glfw.get_window_size(window)[0]
            scale = self.size[0] / units if units else 1.0
            viewer.move(x * scale, y * scale)

        def on_button(_: Any, button: int, action: int, mods: int) -> None:
            down = action == glfw.PRESS and button in buttons
            viewer.drag(buttons[button] if down else "", bool(mods & glfw.MOD_SHIFT))

        def on_drop(_: Any, paths: list[str]) -> None:
            for path in paths:
                viewer.drop(path)

        def on_focus(_: Any, focused: int) -> None:
            if not focused:
                viewer.unfocus()

        on_cursor(window, *glfw.get_cursor_pos(window))  # a button may be pressed before the first move
        glfw.set_key_callback(window, on_key)
        glfw.set_mouse_button_callback(window, on_button)
        glfw.set_cursor_pos_callback(window, on_cursor)
        glfw.set_scroll_callback(window, lambda _, dx, dy: viewer.scroll(dy))
        glfw.set_drop_callback(window, on_drop)
        glfw.set_window_focus_callback(window, on_focus)
        glfw.set_framebuffer_size_callback(window, lambda _, width, height: viewer.resize(width, height))
        glfw.set_window_refresh_callback(window, lambda _: viewer.expose())

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.release()
        self._glfw.destroy_window(self._window)
        self._glfw.terminate()

    def _create(self, size: tuple[int, int], title: str) -> Any:
        glfw = self._glfw
        for major, minor in _VERSIONS:
            glfw.default_window_hints()
            glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, major)
            glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, minor)
            glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
            glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
            glfw.window_hint(glfw.DEPTH_BITS, 0)
            glfw.window_hint(glfw.STENCIL_BITS, 0)
            glfw.window_hint(glfw.VISIBLE, self._visible)
            window = glfw.create_window(*size, title, None, None)
            if window:
                return window
        raise ContextError(
            f"no window with OpenGL 3.3: update the graphics driver, or use `glsplat render`{self._reason()}"
        )

    def _on_error(self, code: int, description: str | bytes) -> None:
        # the package declares str, but passes bytes
        text = description.decode("utf-8", "replace") if isinstance(description, bytes) else description
        self._errors.append(text)

    def _reason(self) -> str:
        return f" ({self._errors[-1]})" if self._errors else ""


def _key_names(glfw: Any) -> dict[int, str]:
    """Return a map of GLFW's key code to the viewer's name of it. Keys are positions on a US keyboard."""
    named = {
        "SPACE": "space",
        "ESCAPE": "escape",
        "BACKSPACE": "backspace",
        "UP": "up",
        "DOWN": "down",
        "LEFT": "left",
        "RIGHT": "right",
        "PAGE_UP": "page up",
        "PAGE_DOWN": "page down",
        "PERIOD": ".",
        "COMMA": ",",
        "LEFT_BRACKET": "[",
        "RIGHT_BRACKET": "]",
    }
    named |= {key: key for key in "123MRPOHWASDEQ"}
    return {getattr(glfw, f"KEY_{constant}"): name for constant, name in named.items()}
