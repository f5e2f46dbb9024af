"""What test_preview.py runs under Xvfb: one window led through layouts, sizes and rest; findings as JSON.

A process of its own: a window's GLX context and the EGL context of the other tests do not share a thread.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import glfw
import numpy as np

from apps.preview.cameras import Options
from apps.preview.command import loop
from apps.preview.viewer import Viewer
from apps.preview.window import Window
from glsplat.formats import load


def main(scene_file: str, out: str) -> None:
    found: dict[str, Any] = {}
    with Window((200, 150), "session") as window:
        options = Options(eye=(0.4, 0.3, 3.0), target=(0.7, 0.0, 0.0), background=(0.1, 0.2, 0.3))
        viewer = Viewer(load(scene_file), window.context, window.size, options, "scene")
        window.attach(viewer)
        handle = window._window
        # a callback can be had by setting another one
        key = glfw.set_key_callback(handle, None)
        wheel = glfw.set_scroll_callback(handle, None)

        def show(frames: int = 1) -> None:
            loop(window, viewer, frames)

        def press(code: int, action: int = glfw.PRESS) -> None:
            key(handle, code, 0, action, 0)

        def screen() -> np.ndarray:
            # the picture that the next swap shows: drawn again, as the last swap left the buffer undefined
            viewer.draw(window.framebuffer)
            errors.append(window.context.ctx.error)
            data = window.framebuffer.read(viewport=(0, 0, *viewer.size), components=3, alignment=1)
            window.context.ctx.error  # noqa: B018  (moderngl names an attachment that a window has not, and reads all the same)
            return np.frombuffer(data, np.uint8).reshape(viewer.size[1], viewer.size[0], 3)[::-1]

        errors: list[str] = []
        show()
        images = {"mono": viewer.capture()}
        found["screen is capture"] = [bool(np.array_equal(screen(), images["mono"]))]
        for code, name in ((glfw.KEY_2, "side-by-side"), (glfw.KEY_3, "anaglyph")):
            press(code)
            show()
            images[name] = viewer.capture()
            found["screen is capture"].append(bool(np.array_equal(screen(), images[name])))
        press(glfw.KEY_1)

        distance = viewer.view.distance
        wheel(handle, 0.0, 2.0)
        found["zoom"] = viewer.view.distance / distance
        press(glfw.KEY_R)
        show()
        found["reset"] = bool(np.array_equal(viewer.capture(), images["mono"]))

        sizes = []
        for size in ((1, 1), (201, 151), (200, 150)):
            for code in (glfw.KEY_1, glfw.KEY_2, glfw.KEY_3):
                press(code)
                window.resize(*size)
                end = time.monotonic() + 30
                while viewer.size != size and time.monotonic() < end:
                    window.wait(0.01)
                show()
                sizes.append(list(viewer.capture().shape[1::-1]))
        press(glfw.KEY_1)
        show()
        found["sizes"] = sizes
        found["after resizing"] = bool(np.array_equal(viewer.capture(), images["mono"]))

        # nothing changes: nothing is drawn and no time is spent
        press(glfw.KEY_O)
        loop(window, viewer, 1)
        draws = []
        draw = viewer.draw
        viewer.draw = lambda *args, **kw: (draws.append(1), draw(*args, **kw))[1]  # type: ignore[method-assign]

        def stop() -> None:
            viewer.closing = True
            glfw.post_empty_event()

        while viewer.overlay.left > 0:
            viewer.advance(1.0)
        turns = []
        wait = window.wait
        window.wait = lambda seconds: (turns.append(seconds), wait(seconds))[1]  # type: ignore[method-assign]
        timer = threading.Timer(0.6, stop)
        timer.start()
        loop(window, viewer)
        found["rest"] = {"draws": len(draws), "turns": turns}
        viewer.closing = False
        press(glfw.KEY_ESCAPE)
        loop(window, viewer)  # returns at once
        viewer.closing = False
        glfw.set_window_should_close(handle, True)
        loop(window, viewer)
        errors.append(window.context.ctx.error)
        found["gl errors"] = errors
        viewer.release()
    np.savez(Path(out) / "images.npz", **images)
    (Path(out) / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
